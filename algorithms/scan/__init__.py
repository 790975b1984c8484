"""One scan, from its returns to their labels (paper, section III), a file for each step.

In order: smoothing, floor and ceiling (III.A), point_lines (III.A, eq. 1), vertical_structures (III.B, eq. 2), wall_planes
(III.B, Algorithm 1), doors (III.C), labelling (all of them composed), summary (what the building keeps of a scan).
"""
