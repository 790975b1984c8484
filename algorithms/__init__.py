"""The method of "Furniture Free Mapping using 3D Lidars" as pure functions on arrays, one file for each step.

Rooms, each of which uses only those before it: `base` (what a scan is), `scan` (one scan, section III of the paper), `poses`
(IV.A), `building` (all scans together), `maps` (IV.C and D), `truth` (IV.B). They know neither files nor Rerun: each step
returns a frozen dataclass with its answer and its evidence.
"""
