"""Scans of rays alone, and counting these against faces as the run does."""

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.building.evidence import Evidence, trace
from ffmap.algorithms.building.model import BuildingSettings, Walls
from ffmap.algorithms.building.rays import OwnPlane
from ffmap.algorithms.scan.summary import Features


def rays_alone(
    origin_map: FloatArray, ends_map: FloatArray, label: UInt8Array, scan: int = 0
) -> Features:
    """One scan from a place (3,), of rays to ends (r, 3) with labels (r,), without wall planes."""
    return Features(
        scan=np.array([scan]),
        origin_map=origin_map[None],
        floor_map=np.zeros((1, 2, 3)),
        floor_is_foot=np.zeros(1, bool),
        floor_reach_m=np.full(1, 6.0),
        ray_count=np.array([len(ends_map)]),
        plane_count=np.zeros(1, np.int64),
        ray_end_map=ends_map.astype(np.float32),
        ray_label=label,
        plane_ends_map=np.zeros((0, 2, 2)),
        plane_normal=np.zeros((0, 2)),
        plane_bottom_m=np.zeros(0),
        plane_top_m=np.zeros(0),
        plane_lines=np.zeros(0, np.int64),
        plane_moments=np.zeros((0, 6)),
    )


def traced_by(faces: Walls, *scans: Features, at_ends: bool = False) -> Evidence:
    settings = BuildingSettings()
    return trace(faces, scans, settings.range_m, OwnPlane.of(settings), at_ends)
