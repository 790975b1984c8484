"""Localization: odometry (paper, IV.A), its refinement, loop closure, levelling, extrinsics."""
