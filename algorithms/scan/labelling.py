"""From a placed scan to a label for every return, with all evidence (paper, III, Fig. 2)."""

from dataclasses import dataclass

import numba
import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, ScanSettings, UInt8Array
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.scan.ceiling import below_ceiling, find_ceilings
from ffmap.algorithms.scan.doors import (
    DoorLines,
    DoorsSettings,
    DoorState,
    Openings,
    find_door_lines,
    find_openings,
)
from ffmap.algorithms.scan.floor import Floor, find_floor
from ffmap.algorithms.scan.point_lines import PointLines, make_point_lines
from ffmap.algorithms.scan.rearrangement import (
    HorizontalPlane,
    RearrangementSettings,
    Returns,
    plane_rows,
)
from ffmap.algorithms.scan.smoothing import SmoothingSettings
from ffmap.algorithms.scan.vertical_structures import (
    VerticalStructures,
    VerticalStructuresSettings,
    find_vertical_structures,
)
from ffmap.algorithms.scan.wall_candidates import WallPlanesSettings
from ffmap.algorithms.scan.wall_planes import WallPlanes, grow_wall_planes

CEILING_LOWEST_M = 1.0  # minimum height (m) above the floor of a ceiling's return
_STRAY_MAX = 2  # returns of a ceiling in a line that ends just below it: they scatter into it
_EDGE_M = 0.01  # an edge's return is wall unless floor or ceiling is nearer by more than this (m)
_END_MARGIN_M = 0.15  # length (m) of a wall plane beyond its outermost lines
_CORNER_GAP_MAX_M = 0.6  # maximum gap (m) between the end of a plane and its corner with another
_CORNER_TURN_MIN = 0.3  # minimum sine of the angle between two planes with a corner
_LEAF_MARGIN_M = 0.03  # width (m) of a closed door beyond the outermost lines that showed it
_LEAF_DEPTH_M = 0.05  # depth (m) of a closed door's returns beyond their median


@dataclass(frozen=True)
class MethodSettings:
    """The settings of every step that labels a scan."""

    scan: ScanSettings
    smoothing: SmoothingSettings
    rearrangement: RearrangementSettings
    vertical_structures: VerticalStructuresSettings
    wall_planes: WallPlanesSettings
    doors: DoorsSettings


@dataclass(frozen=True)
class ScanLabelling:
    """The labels of one scan and all evidence that led to them.

    label: (n,) uint8, see `Label`, one for each return of the scan.
    plane: (n,) int16, the wall plane of a wall or door return, -1 for others.
    height_m: (n,) float32, above the floor. below_m: (n,) float32, see `below_ceiling`.
    ceilings: the planes found above, largest first; empty where none is in view.
    settings: of the steps that made it.
    """

    label: UInt8Array
    plane: IntArray
    height_m: FloatArray
    below_m: FloatArray
    floor: Floor
    ceilings: tuple[HorizontalPlane, ...]
    lines: PointLines
    structures: VerticalStructures
    planes: WallPlanes
    door_lines: DoorLines
    openings: Openings
    settings: MethodSettings

    @property
    def ceiling_planes(self) -> FloatArray:
        """(c, 3) height at the level frame's origin and slope along x and y of each ceiling."""
        return plane_rows(self.ceilings)


def label_scan(
    scan: Scan,
    placed: PlacedScan,
    settings: MethodSettings,
    seed: int,
    floor: Floor | None = None,
    column_pairs: int = 0,
) -> ScanLabelling:
    """The paper's method on one scan: III.A to III.C in order.

    placed: the returns to label, smoothed (`smooth_ranges`) or as measured.
    seed: of the scan's random numbers; from the run's seed and the scan's index, so that no label
        depends on the process that computed it.
    floor: the floor below them, where levelling has found it.
    column_pairs: as of `make_point_lines`.
    """
    # III.A: floor by height, ceiling by RANSAC, 2n point lines.
    rearrangement = settings.rearrangement
    floor = floor or find_floor(placed.points_level, rearrangement)
    height_m = floor.heights_above(placed.points_level)
    origin_level = np.ascontiguousarray(placed.origin_level, np.float64)
    returns = Returns(placed.points_level, height_m, origin_level)
    ceilings = find_ceilings(placed.points_level, height_m, floor, rearrangement, seed)
    below_m = below_ceiling(placed.points_level, plane_rows(ceilings))
    label = label_horizontal(height_m, below_m, rearrangement)
    lines = make_point_lines(scan, placed.down_sensor, label != Label.CLUTTER, column_pairs)
    # III.B: vertical structures, wall candidates, wall planes.
    structures = find_vertical_structures(returns, lines.samples, settings.vertical_structures)
    meets_ceiling = lines.count(label == Label.CEILING) > _STRAY_MAX
    planes = grow_wall_planes(
        returns, lines.samples, structures, ceilings, meets_ceiling, settings.wall_planes
    )
    # III.C: doors, then a label for every return.
    door_lines = find_door_lines(returns, lines, planes, structures.upmost, settings.doors)
    openings = find_openings(door_lines, planes, settings.doors)
    plane = _label_walls(
        returns,
        below_m,
        label,
        planes.normal,
        planes.offset_m,
        completed_ends(planes),
        settings.wall_planes.distance_m,
    )
    _label_closed_doors(returns, planes, openings, label, plane)
    return ScanLabelling(
        label,
        plane,
        height_m,
        below_m,
        floor,
        ceilings,
        lines,
        structures,
        planes,
        door_lines,
        openings,
        settings,
    )


def label_horizontal(
    height_m: FloatArray, below_m: FloatArray, settings: RearrangementSettings
) -> UInt8Array:
    """Label floor and ceiling (n,), all else clutter; parameters as of `ScanLabelling`."""
    is_ceiling = np.abs(below_m) < settings.ceiling_distance_m
    is_ceiling &= height_m > CEILING_LOWEST_M
    label = np.where(is_ceiling, np.uint8(Label.CEILING), np.uint8(Label.CLUTTER))
    label[np.abs(height_m) < settings.floor_height_m] = Label.FLOOR
    return label


def completed_ends(planes: WallPlanes) -> FloatArray:
    """(K, 2) both ends along each plane, with a margin, and completed to corners with others."""
    normal, offset_m = planes.normal, planes.offset_m
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    ends = np.sort(np.einsum("ked,kd->ke", planes.ends, along), axis=1)
    low, high = ends.T[:, :, None]
    # (K, K): where along each plane its corner with each other one is.
    turn = along @ normal.T
    crosses = np.abs(turn) >= _CORNER_TURN_MIN
    place = (offset_m - offset_m[:, None] * (normal @ normal.T)) / np.where(crosses, turn, 1.0)
    near = (place > low - _CORNER_GAP_MAX_M) & (place < high + _CORNER_GAP_MAX_M)
    corner = crosses & near & near.T
    before = np.where(corner & (place < low), place, np.inf).min(axis=1, initial=np.inf)
    after = np.where(corner & (place > high), place, -np.inf).max(axis=1, initial=-np.inf)
    return np.column_stack(
        [
            np.minimum(ends[:, 0] - _END_MARGIN_M, before),
            np.maximum(ends[:, 1] + _END_MARGIN_M, after),
        ]
    )


@numba.njit(cache=True, nogil=True)
def _label_walls(
    returns: Returns,
    below: FloatArray,
    label: UInt8Array,
    normal: FloatArray,
    offset: FloatArray,
    ends: FloatArray,
    distance_m: float,
) -> IntArray:
    """Label returns near a plane as wall; the plane (n,) int16 of each, -1 for none.

    Every return is tested against every plane of the scan, not that of its own line alone. Along an
    edge, the nearer of wall and floor or ceiling decides.
    """
    points, height, _ = returns
    plane = np.full(len(points), -1, np.int16)
    for i in range(len(points)):
        nearest, best = distance_m, -1
        x, y = points[i, 0], points[i, 1]
        for k in range(len(normal)):
            s = abs(normal[k, 0] * x + normal[k, 1] * y - offset[k])
            if s < nearest:
                u = -normal[k, 1] * x + normal[k, 0] * y
                if ends[k, 0] < u < ends[k, 1]:
                    nearest, best = s, k
        if best < 0:
            continue
        inside = np.inf  # how far it is inside the room from the floor or ceiling that claims it
        if label[i] == Label.FLOOR:
            inside = height[i]
        elif label[i] == Label.CEILING:
            inside = below[i]
        if inside > nearest - _EDGE_M:
            label[i], plane[i] = Label.WALL, best
    return plane


def _label_closed_doors(
    returns: Returns, planes: WallPlanes, openings: Openings, label: UInt8Array, plane: IntArray
) -> None:
    """Label returns on the leaf of a closed door, though many are near enough to be wall.

    Changes `label` and `plane`, both (n,).
    """
    x, y = returns.points_level[:, 0], returns.points_level[:, 1]
    for o in np.flatnonzero(openings.state == DoorState.CLOSED):
        k, depth_m = openings.plane[o], openings.depth_m[o]
        nx, ny = planes.normal[k]
        low, high = np.sort(openings.ends[o] @ np.array([-ny, nx]))
        behind_m = planes.offset_m[k] - nx * x - ny * y
        on_leaf = (behind_m > 0.5 * depth_m) & (behind_m < depth_m + _LEAF_DEPTH_M)
        on_leaf &= returns.height_m < openings.head_m[o]
        rows = np.flatnonzero(on_leaf & ((label == Label.CLUTTER) | (label == Label.WALL)))
        u = nx * y[rows] - ny * x[rows]
        rows = rows[(u > low - _LEAF_MARGIN_M) & (u < high + _LEAF_MARGIN_M)]
        label[rows], plane[rows] = Label.DOOR, k
