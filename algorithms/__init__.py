"""The method of "Furniture Free Mapping using 3D Lidars": pure functions, one file per step.

Each folder uses only those before it: `base` (scans), `scan` (one scan, section III of the paper),
`poses` (IV.A), `building` (all scans together), `maps` (IV.C and D), `truth` (IV.B). No folder
depends on files or on Rerun. Each step returns a frozen dataclass: its answer and its evidence.
"""
