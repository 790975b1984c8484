"""What the fusion of all scans needs of one scan: its wall planes and a share of its rays."""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.scan.floor import FLOOR_RANGE_M
from ffmap.algorithms.scan.labelling import ScanLabelling

RAYS_PER_SCAN = 16_000  # maximum number of rays that are kept of a scan
NO_INTENSITY = np.zeros(0, np.float32)


@dataclass(frozen=True)
class Features:
    """Features of some scans (s) in the map frame.

    scan: int64, index of each scan. origin_map: (s, 3) the sensor.
    floor_map: (s, 2, 3), floor_is_foot: as `both_pieces` and `is_foot` of `Floor`.
    floor_reach_m: distance from the sensor up to which the floor's pieces were searched for.
    ray_count, plane_count: rows below of each scan, in order.
    ray_end_map: (r, 3) float32. ray_label: (r,) uint8, the scan's label of the return.
    ray_intensity: (r,) float32, NaN where unknown; (0,) where no scan has any.
    plane_ends_map: (p, 2, 2). plane_normal: (p, 2) towards the sensor.
    plane_bottom_m, plane_top_m, plane_lines: (p,) as in `WallPlanes`.
    plane_moments: (p, 6) n, Σx, Σy, Σxx, Σxy, Σyy of its samples.
    """

    scan: IntArray
    origin_map: FloatArray
    floor_map: FloatArray
    floor_is_foot: BoolArray
    floor_reach_m: FloatArray
    ray_count: IntArray
    plane_count: IntArray
    ray_end_map: FloatArray
    ray_label: UInt8Array
    plane_ends_map: FloatArray
    plane_normal: FloatArray
    plane_bottom_m: FloatArray
    plane_top_m: FloatArray
    plane_lines: IntArray
    plane_moments: FloatArray
    ray_intensity: FloatArray = field(default_factory=lambda: NO_INTENSITY)

    @property
    def ray_starts(self) -> IntArray:
        """(s + 1,) int64: the rays of scan k are rows ray_starts[k] to ray_starts[k + 1]."""
        return np.concatenate([[0], np.cumsum(self.ray_count)]).astype(np.int64)

    @property
    def plane_starts(self) -> IntArray:
        """(s + 1,) int64, the same for the wall planes."""
        return np.concatenate([[0], np.cumsum(self.plane_count)]).astype(np.int64)

    @property
    def ray_scan(self) -> IntArray:
        """(r,) int64, the row in `scan` that each ray belongs to."""
        return np.repeat(np.arange(len(self.scan)), self.ray_count.astype(np.int64))

    @property
    def plane_scan(self) -> IntArray:
        """(p,) int64, the same of each wall plane."""
        return np.repeat(np.arange(len(self.scan)), self.plane_count.astype(np.int64))


def extract(
    index: int,
    placed: PlacedScan,
    labelling: ScanLabelling,
    points_map: FloatArray | None = None,
    intensity: FloatArray = NO_INTENSITY,
) -> Features:
    """The features of one scan in the map frame.

    points_map: (n, 3) its returns, where they are known already. intensity: (n,), or (0,).
    """
    planes, floor, T = labelling.planes, labelling.floor, placed.T_map_level
    # Every n-th return, line by line: in all directions.
    stride = max(1, -(-len(labelling.label) // RAYS_PER_SCAN))
    rays = labelling.lines.order[index % stride :: stride]
    ends_map = placed.to_map(placed.points_level[rays]) if points_map is None else points_map[rays]
    slope = floor.both_pieces[:, 1:] @ T[:2, :2].T
    height_m = floor.both_pieces[:, 0] + T[2, 3] - slope @ T[:2, 3]
    plane_ends = np.pad(planes.ends, ((0, 0), (0, 0), (0, 1)))  # z = 0
    return Features(
        scan=np.array([index]),
        origin_map=placed.to_map(placed.origin_level[None]),
        floor_map=np.column_stack([height_m, slope])[None],
        floor_is_foot=np.array([floor.is_foot]),
        floor_reach_m=np.array([FLOOR_RANGE_M]),
        ray_count=np.array([len(rays)]),
        plane_count=np.array([len(planes)]),
        ray_end_map=ends_map.astype(np.float32),
        ray_label=labelling.label[rays],
        plane_ends_map=placed.to_map(plane_ends.reshape(-1, 3))[:, :2].reshape(-1, 2, 2),
        plane_normal=planes.normal @ T[:2, :2].T,
        plane_bottom_m=planes.bottom_m,
        plane_top_m=planes.top_m,
        plane_lines=planes.line_count,
        plane_moments=move_moments(planes.moments, T),
        ray_intensity=intensity[rays] if len(intensity) else intensity,
    )


def select_scans(features: Features, chosen: BoolArray) -> Features:
    """Some of the scans, with all their rows; chosen: (s,)."""
    rows = _rows(features, "ray_", chosen[features.ray_scan])
    rows |= _rows(features, "plane_", chosen[features.plane_scan])
    own = {
        f.name: getattr(features, f.name)[chosen] for f in fields(Features) if f.name not in rows
    }
    return Features(**own, **rows)


def select_rays(features: Features, chosen: BoolArray) -> Features:
    """The same scans with some of their rays; chosen: (r,)."""
    count = np.bincount(features.ray_scan[chosen], minlength=len(features.scan))
    return replace(features, ray_count=count, **_rows(features, "ray_", chosen))


def _rows(features: Features, prefix: str, chosen: BoolArray) -> dict[str, npt.NDArray[Any]]:
    """The chosen rows of the columns of all rays, or of all planes; an empty column is kept."""
    names = [f.name for f in fields(Features) if f.name.startswith(prefix)]
    names.remove(f"{prefix}count")
    columns = {name: getattr(features, name) for name in names}
    return {name: column[chosen] if len(column) else column for name, column in columns.items()}


def without_rays(features: Features) -> Features:
    """The same scans with their wall planes alone, which take little memory beside the rays."""
    return select_rays(features, np.zeros(len(features.ray_label), bool))


def concatenate(parts: list[Features]) -> Features:
    """The features of at least one scan or block of scans as one."""
    columns = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Features)
    }
    if len(columns["ray_intensity"]):
        known = [
            part.ray_intensity
            if len(part.ray_intensity)
            else np.full(len(part.ray_end_map), np.nan, np.float32)
            for part in parts
        ]
        columns["ray_intensity"] = np.concatenate(known)
    return Features(**columns)


def move_moments(moments: FloatArray, T_target_source: FloatArray) -> FloatArray:
    """The moments (p, 6) of the same points in another frame, which differs by yaw and shift."""
    R, t = T_target_source[:2, :2], T_target_source[:2, 3]
    n, first = moments[:, 0], moments[:, 1:3]
    second = moments[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    turned = first @ R.T
    moved_second = (
        R @ second @ R.T
        + turned[:, :, None] * t[None, None, :]
        + t[None, :, None] * turned[:, None, :]
        + n[:, None, None] * np.outer(t, t)
    )
    second_rows = moved_second.reshape(-1, 4)[:, [0, 1, 3]]
    return np.concatenate([n[:, None], turned + n[:, None] * t, second_rows], axis=1)
