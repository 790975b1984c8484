"""An analytic corridor with a door in one wall: scans with known labels, under noise."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory, place_scan
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from tests import synthetic

METHOD = synthetic.settings()
HEIGHT_M = 2.8
# The lidar is on its side: its spin axis z points along the base's x, its x axis down.
T_BASE_SENSOR = transforms.make_transform(
    Rotation.from_matrix([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), [0.0, 0.0, 0.8]
)


@dataclass(frozen=True)
class Hole:
    """A hole in the wall y = 2, from x0 to x1 and from foot to head.

    depth: of the closed door behind the wall; None for an open door.
    pane: the share of the rays that a pane 10 cm behind the wall returns.
    """

    x0: float = -0.5
    x1: float = 0.4
    foot: float = 0.0
    head: float = 2.1
    depth: float | None = 0.05
    pane: float = 0.0


EMITTERS_DEG = np.linspace(-30, 10, 32)


def cast(
    T_map_sensor: np.ndarray,
    hole: Hole | None,
    noise_m: float,
    seed: int,
    ceiling: bool = True,
    emitters_deg: np.ndarray = EMITTERS_DEG,
    firings: int = 1800,
) -> tuple[Scan, np.ndarray]:
    """One sweep in a corridor -4 < x < 6, -1.5 < y < 2, and the true label of each return."""
    generator = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(
        np.linspace(0, 2 * np.pi, firings, endpoint=False), np.radians(emitters_deg), indexing="ij"
    )
    ring = np.tile(np.arange(len(emitters_deg), dtype=np.uint16), firings)
    flat, up = np.cos(elevation), np.sin(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1)
    direction_sensor = rays.reshape(-1, 3)
    origin = T_map_sensor[:3, 3]
    d = direction_sensor @ T_map_sensor[:3, :3].T
    best = np.full(len(d), np.inf)
    label = np.zeros(len(d), np.uint8)
    planes = [
        (2, 0.0, Label.FLOOR),
        (0, -4.0, Label.WALL),
        (0, 6.0, Label.WALL),
        (1, -1.5, Label.WALL),
        (1, 2.0, Label.WALL),
    ]
    if ceiling:
        planes.append((2, HEIGHT_M, Label.CEILING))
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis, at, code in planes:
            t = (at - origin[axis]) / d[:, axis]
            hit = (t > 1e-6) & (t < best)
            if axis == 1 and at == 2.0 and hole is not None:
                p = origin + t[:, None] * d
                in_hole = (p[:, 0] > hole.x0) & (p[:, 0] < hole.x1) & (p[:, 2] < hole.head)
                in_hole &= p[:, 2] > hole.foot
                hit &= ~in_hole
                t_pane = (at + 0.1 - origin[axis]) / d[:, axis]
                reflects = generator.random(len(d)) < hole.pane
                returned = in_hole & (t_pane < best) & (t > 0) & reflects
                best[returned], label[returned] = t_pane[returned], Label.OUTSIDE
            best[hit], label[hit] = t[hit], code
        if hole is not None:
            t = (2.0 + (4.0 if hole.depth is None else hole.depth) - origin[1]) / d[:, 1]
            p = origin + t[:, None] * d
            behind = (t > 0) & (t < best) & (p[:, 2] > 0) & (p[:, 2] < HEIGHT_M)
            best[behind] = t[behind]
            label[behind] = Label.CLUTTER if hole.depth is None else Label.DOOR
    keep = np.isfinite(best) & (best < 30)
    range_m = best[keep] + generator.normal(0, noise_m, keep.sum())
    scan = Scan(
        points_sensor=(direction_sensor[keep] * range_m[:, None]).astype(np.float32),
        ring=ring[keep],
        ring_count=len(emitters_deg),
        time_ns=None,
        start_ns=0,
        stamp_ns=0,
        cloud_index=np.flatnonzero(keep).astype(np.int32),
        cloud_size=len(keep),
    )
    return scan, label[keep]


def pose(x: float = 0.0, yaw_rad: float = 0.0) -> np.ndarray:
    return transforms.from_yaw(yaw_rad, [x, 0.0, 0.0])


def place(scan: Scan, T_map_base: np.ndarray) -> PlacedScan:
    return place_scan(scan, Trajectory(np.array([0]), T_map_base[None]), T_BASE_SENSOR)


def labelled(
    hole: Hole | None = None,
    noise_m: float = 0.015,
    seed: int = 1,
    x: float = 0.0,
    ceiling: bool = True,
) -> tuple[Scan, PlacedScan, np.ndarray, ScanLabelling]:
    scan, truth = cast(pose(x) @ T_BASE_SENSOR, hole, noise_m, seed, ceiling)
    placed = place(scan, pose(x))
    return scan, placed, truth, label_scan(scan, placed, METHOD, seed)


def share(label: np.ndarray, truth: np.ndarray, code: int) -> tuple[float, float]:
    """Precision and recall by points."""
    right = np.count_nonzero((label == code) & (truth == code))
    found, wanted = np.count_nonzero(label == code), np.count_nonzero(truth == code)
    return right / max(found, 1), right / max(wanted, 1)
