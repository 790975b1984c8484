"""One scan, from its returns to their labels (paper, section III): one file for each step.

In order: smoothing; floor, ceiling (III.A); point_lines (III.A, eq. 1); vertical_structures (III.B,
eq. 2); wall_candidates, wall_planes (III.B, Algorithm 1); doors (III.C); labelling, which composes
all of them; summary (what the fusion of all scans needs of one scan).
"""
