"""From a placed scan to a label for every return, with all evidence (paper, III.C, Fig. 2)."""

from dataclasses import dataclass

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan, ScanSettings, UInt8Array
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.scan.ceiling import find_ceilings
from ffmap.algorithms.scan.doors import DoorLines, DoorsSettings, DoorState, Openings, find_door_lines, find_openings
from ffmap.algorithms.scan.floor import Floor, find_floor
from ffmap.algorithms.scan.point_lines import PointLines, make_point_lines
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, RearrangementSettings, Returns, plane_rows
from ffmap.algorithms.scan.smoothing import SmoothingSettings
from ffmap.algorithms.scan.vertical_structures import (
    VerticalStructures,
    VerticalStructuresSettings,
    find_vertical_structures,
)
from ffmap.algorithms.scan.wall_planes import WallPlanes, WallPlanesSettings, grow_wall_planes

_EDGE_M = 0.01
"""Along an edge a return goes to the wall unless floor or ceiling is nearer by more than this
(m)."""
_END_MARGIN_M = 0.15
"""How far (m) a wall plane reaches beyond its outermost lines. III.C."""
_CORNER_GAP_MAX_M = 0.6
"""Maximum gap (m) between the end of a plane and its corner with another, to which it is completed.
III.C."""
_LEAF_MARGIN_M = 0.03
"""How far (m) a closed leaf reaches beyond the outermost lines that showed it. III.C."""


class LabellingSettings(StepSettings):
    """From planes to labels (paper, III.C)."""

    wall_distance_m: float = Field(
        0.045, gt=0, le=0.5, description="Maximum distance (m) of a wall's return from a wall plane of the scan. III.C."
    )


@dataclass(frozen=True)
class MethodSettings:
    """The settings of every step that labels a scan."""

    scan: ScanSettings
    smoothing: SmoothingSettings
    rearrangement: RearrangementSettings
    vertical_structures: VerticalStructuresSettings
    wall_planes: WallPlanesSettings
    doors: DoorsSettings
    labelling: LabellingSettings


@dataclass(frozen=True)
class ScanLabelling:
    """The labels of one scan and everything that led to them.

    label: (n,) uint8, see `Label`, one for each return of the scan.
    plane: (n,) int16, the wall plane that a wall or door return lies on, -1 for others.
    height_m: (n,) float32, above the floor.
    floor: the floor below the robot; ceilings: the planes found above, largest first, none where no ceiling is in view.
    settings: what it was made with.
    """

    label: UInt8Array
    plane: IntArray
    height_m: FloatArray
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

    placed: the returns that are labelled, smoothed (`smooth_ranges`) or as measured. floor: below them, where levelling has found
    it; None where it is to be found. column_pairs: as of `make_point_lines`.

    seed: of the scan's random numbers; made from the run's seed and the scan's index, so that no label depends on
    which process labelled it.
    """
    # III.A: floor by height, ceiling by RANSAC, 2n point lines.
    floor = floor or find_floor(placed.points_level, settings.rearrangement)
    returns = Returns(placed.points_level, floor.heights_above(placed.points_level), placed.origin_level)
    ceilings = find_ceilings(returns.points_level, returns.height_m, floor, settings.rearrangement, seed)
    floor_m, ceiling_m = settings.rearrangement.floor_height_m, settings.rearrangement.ceiling_distance_m
    label = _label_horizontal(returns.points_level, returns.height_m, plane_rows(ceilings), floor_m, ceiling_m)
    is_horizontal = label != Label.CLUTTER
    lines = make_point_lines(
        scan,
        placed.down_sensor,
        is_horizontal,
        settings.rearrangement,
        column_pairs,
    )
    # III.B: vertical structures, wall candidates, wall planes.
    structures = find_vertical_structures(returns, lines.samples, settings.vertical_structures)
    meets_ceiling = _lines_with(label, int(Label.CEILING), lines.order, lines.starts)
    planes = grow_wall_planes(returns, lines.samples, structures, ceilings, floor, meets_ceiling, settings.wall_planes)
    # III.C: doors, then a label for every return.
    door_lines = find_door_lines(returns, lines, planes, structures.upmost, settings.doors)
    openings = find_openings(door_lines, planes, settings.doors)
    plane = _label_walls(
        returns.points_level,
        returns.height_m,
        label,
        plane_rows(ceilings),
        planes.normal,
        planes.offset_m,
        completed_ends(planes.normal, planes.offset_m, planes.ends),
        settings.labelling.wall_distance_m,
    )
    _label_leaves(returns, label, plane, planes, openings)
    return ScanLabelling(
        label, plane, returns.height_m, floor, ceilings, lines, structures, planes, door_lines, openings, settings
    )


@numba.njit(cache=True, nogil=True)
def _lines_with(label: UInt8Array, wanted: int, order: IntArray, starts: IntArray) -> BoolArray:  # pragma: no cover
    """(L,) whether each line has more than two returns of a label: what ends just below a ceiling scatters into it."""
    found = np.zeros(len(starts) - 1, np.bool_)
    for line in range(len(found)):
        count = 0
        for j in range(starts[line], starts[line + 1]):
            count += label[order[j]] == wanted
        found[line] = count > 2
    return found


def completed_ends(normal: FloatArray, offset_m: FloatArray, ends: FloatArray) -> FloatArray:
    """(K, 2) minimum and maximum place along each plane, widened by the margin and completed to corners with others."""
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    places = np.einsum("ked,kd->ke", ends, along)
    low, high = places.min(axis=1), places.max(axis=1)
    widened = np.stack([low - _END_MARGIN_M, high + _END_MARGIN_M], axis=1)
    for k in range(len(normal)):
        for other in range(len(normal)):
            turn = normal[k, 0] * normal[other, 1] - normal[k, 1] * normal[other, 0]
            if abs(turn) < 0.3:
                continue
            corner = np.linalg.solve(normal[[k, other]], offset_m[[k, other]])
            place_k, place_other = float(corner @ along[k]), float(corner @ along[other])
            if not low[other] - _CORNER_GAP_MAX_M < place_other < high[other] + _CORNER_GAP_MAX_M:
                continue
            if low[k] - _CORNER_GAP_MAX_M < place_k < low[k]:
                widened[k, 0] = min(widened[k, 0], place_k)
            elif high[k] < place_k < high[k] + _CORNER_GAP_MAX_M:
                widened[k, 1] = max(widened[k, 1], place_k)
    return widened


def _label_leaves(
    returns: Returns,
    label: UInt8Array,
    plane: IntArray,
    planes: WallPlanes,
    openings: Openings,
) -> None:
    """Returns within a closed opening, on its leaf, are door, though they lie near enough to the wall to be wall."""
    for o in np.flatnonzero(openings.state == DoorState.CLOSED):
        k, depth_m = openings.plane[o], openings.depth_m[o]
        nx, ny = planes.normal[k]
        low, high = np.sort(openings.ends[o] @ np.array([-ny, nx]))
        along_m = low - _LEAF_MARGIN_M, high + _LEAF_MARGIN_M
        within = along_m, (-depth_m - 0.05, -0.5 * depth_m), openings.head_m[o]
        _label_leaf(returns.points_level, returns.height_m, label, plane, (nx, ny, planes.offset_m[k]), within, k)


@numba.njit(cache=True, nogil=True)
def _label_leaf(
    points: FloatArray,
    height: FloatArray,
    label: UInt8Array,
    plane: IntArray,
    wall: tuple[float, float, float],
    within: tuple[tuple[float, float], tuple[float, float], float],
    number: int,
) -> None:  # pragma: no cover
    """wall: normal and offset. within: minimum and maximum along the wall and across it, and the opening's head."""
    nx, ny, offset = wall
    (low, high), (deepest, nearest), head = within
    for i in range(len(points)):
        if (label[i] == Label.CLUTTER or label[i] == Label.WALL) and height[i] < head:
            x, y = points[i, 0], points[i, 1]
            if low < -ny * x + nx * y < high and deepest < nx * x + ny * y - offset < nearest:
                label[i], plane[i] = Label.DOOR, number


@numba.njit(cache=True, nogil=True)
def _label_horizontal(
    points: FloatArray, height: FloatArray, ceilings: FloatArray, floor_height_m: float, ceiling_distance_m: float
) -> UInt8Array:  # pragma: no cover
    label = np.zeros(len(points), np.uint8)
    for i in range(len(points)):
        if abs(height[i]) < floor_height_m:
            label[i] = Label.FLOOR
        elif height[i] > 1.0:
            for c in range(len(ceilings)):
                ceiling = ceilings[c, 0] + ceilings[c, 1] * points[i, 0] + ceilings[c, 2] * points[i, 1]
                if abs(points[i, 2] - ceiling) < ceiling_distance_m:
                    label[i] = Label.CEILING
                    break
    return label


@numba.njit(cache=True, nogil=True)
def _label_walls(
    points: FloatArray,
    height: FloatArray,
    label: UInt8Array,
    ceilings: FloatArray,
    normal: FloatArray,
    offset: FloatArray,
    ends: FloatArray,
    distance_m: float,
) -> IntArray:  # pragma: no cover
    """Every return against every plane of the scan; along an edge the nearer of wall and floor or ceiling decides."""
    plane = np.full(len(points), -1, np.int16)
    for i in range(len(points)):
        nearest = distance_m
        best = -1
        x, y = points[i, 0], points[i, 1]
        for k in range(len(normal)):
            s = abs(normal[k, 0] * x + normal[k, 1] * y - offset[k])
            if s < nearest:
                u = -normal[k, 1] * x + normal[k, 0] * y
                if ends[k, 0] < u < ends[k, 1]:
                    nearest, best = s, k
        if best < 0:
            continue
        inside = np.inf  # how far the return lies within the room from the floor or ceiling that claims it
        if label[i] == Label.FLOOR:
            inside = height[i]
        elif label[i] == Label.CEILING:
            for c in range(len(ceilings)):
                below = ceilings[c, 0] + ceilings[c, 1] * x + ceilings[c, 2] * y - points[i, 2]
                inside = below if abs(below) < abs(inside) else inside
        if inside > nearest - _EDGE_M:
            label[i] = Label.WALL
            plane[i] = best
    return plane
