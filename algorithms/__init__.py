"""The method of "Furniture Free Mapping using 3D Lidars" as pure functions on arrays, one module for each step.

Reads in the order of the paper: odometry and trajectory (IV.A), rearrangement (III.A), vertical_structures and
wall_planes (III.B), doors and labelling (III.C), then what is made of all scans: building, semantic_map, grid_map,
evaluation (IV). Knows neither files nor Rerun: every step returns a frozen dataclass with its answer and its evidence.
"""
