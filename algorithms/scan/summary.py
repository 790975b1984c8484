"""What the fusion of all scans needs of one scan: its wall planes and a share of its rays."""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base import transforms
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

    def moved(self, T: FloatArray) -> "Features":
        """Each scan moved by its own T (s, 4, 4), a turn about z and a shift.

        The rays are kept unmoved, for `with_rays` to replace.
        """
        ends = np.pad(self.plane_ends_map, ((0, 0), (0, 0), (0, 1)))  # z = 0
        planes = self.plane_starts
        columns = {name: getattr(self, name).copy() for name in _MOVED}
        for s in range(len(self.scan)):
            plane = slice(planes[s], planes[s + 1])
            columns["origin_map"][s] = transforms.apply(T[s], self.origin_map[s, None])[0]
            columns["floor_map"][s] = _move_pieces(self.floor_map[s], T[s])
            moved = transforms.apply(T[s], ends[plane].reshape(-1, 3))
            columns["plane_ends_map"][plane] = moved[:, :2].reshape(-1, 2, 2)
            columns["plane_normal"][plane] = self.plane_normal[plane] @ T[s, :2, :2].T
            columns["plane_moments"][plane] = move_moments(self.plane_moments[plane], T[s])
        return replace(self, **columns)

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


def extract(index: int, placed: PlacedScan, labelling: ScanLabelling) -> Features:
    """The features of one scan in the map frame."""
    chosen = ray_rows(index, labelling)
    ends_map = placed.to_map(placed.points_level[chosen]).astype(np.float32)
    moved = extract_planes(index, placed, labelling).moved(placed.T_map_level[None])
    return with_rays(moved, [ends_map], [labelling.label[chosen]])


def extract_planes(index: int, placed: PlacedScan, labelling: ScanLabelling) -> Features:
    """The same without rays, in the scan's level frame: independent of where the scan is placed."""
    planes = labelling.planes
    return Features(
        scan=np.array([index]),
        origin_map=placed.origin_level[None],
        floor_map=labelling.floor.both_pieces[None],
        floor_is_foot=np.array([labelling.floor.is_foot]),
        floor_reach_m=np.array([FLOOR_RANGE_M]),
        ray_count=np.zeros(1, np.int64),
        plane_count=np.array([len(planes)]),
        ray_end_map=np.zeros((0, 3), np.float32),
        ray_label=np.zeros(0, np.uint8),
        plane_ends_map=planes.ends,
        plane_normal=planes.normal,
        plane_bottom_m=planes.bottom_m,
        plane_top_m=planes.top_m,
        plane_lines=planes.line_count,
        plane_moments=planes.moments,
    )


def ray_rows(index: int, labelling: ScanLabelling) -> IntArray:
    """The returns of a scan whose rays are kept: every n-th, line by line, in all directions."""
    stride = max(1, -(-len(labelling.label) // RAYS_PER_SCAN))
    return labelling.lines.order[index % stride :: stride]


_MOVED = ("origin_map", "floor_map", "plane_ends_map", "plane_normal", "plane_moments")
"""The features, except rays, that depend on where their scan is placed."""


def _move_pieces(pieces: FloatArray, T: FloatArray) -> FloatArray:
    """The pieces (2, 3) of a floor in another frame, which differs by yaw and shift."""
    slope = pieces[:, 1:] @ T[:2, :2].T
    return np.column_stack([pieces[:, 0] + T[2, 3] - slope @ T[:2, 3], slope])


def select_scans(features: Features, chosen: BoolArray) -> Features:
    """Some of the scans, with all their rows; chosen: (s,)."""
    rows = _rows(features, "ray_", chosen[features.ray_scan])
    rows |= _rows(features, "plane_", chosen[features.plane_scan])
    own = {
        f.name: getattr(features, f.name)[chosen] for f in fields(Features) if f.name not in rows
    }
    return Features(**own, **rows)


def select_planes(features: Features, chosen: BoolArray) -> Features:
    """The same scans with some of their planes; chosen: (p,)."""
    count = np.bincount(features.plane_scan[chosen], minlength=len(features.scan))
    return replace(features, plane_count=count, **_rows(features, "plane_", chosen))


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


def with_rays(
    features: Features,
    ends_map: list[FloatArray],
    labels: list[UInt8Array],
    intensities: list[FloatArray] | None = None,
) -> Features:
    """The same scans with rays by scan: ends (r, 3), labels (r,), intensities (r,) or (0,)."""
    counts = [len(end) for end in ends_map]
    return replace(
        features,
        ray_count=np.array(counts, np.int64),
        ray_end_map=np.concatenate(ends_map),
        ray_label=np.concatenate(labels),
        ray_intensity=_filled(intensities or [NO_INTENSITY] * len(counts), counts),
    )


def concatenate(parts: list[Features]) -> Features:
    """The features of at least one scan or block of scans as one."""
    columns = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Features)
    }
    counts = [len(part.ray_end_map) for part in parts]
    columns["ray_intensity"] = _filled([part.ray_intensity for part in parts], counts)
    return Features(**columns)


def _filled(columns: list[FloatArray], counts: list[int]) -> FloatArray:
    """One column of several, with NaN in place of the empty ones; empty where all are."""
    if any(map(len, columns)):
        rows = zip(columns, counts, strict=True)
        columns = [c if len(c) else np.full(n, np.nan, c.dtype) for c, n in rows]
    return np.concatenate(columns)


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
