"""Labels, doors, map and trajectory against the truth (paper, IV.B, eq. 3).

What is counted block by block (`Tally`) adds up to the same sum in any order and in any portions; figures are made
from the sum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN, Label, Truth, Verdict
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, columns_of, majority, pack_column
from ffmap.algorithms.maps.grid import Cell, GridMap

CUBE_M = 0.05
"""Edge of the cubes that area is counted in, and of the wall map's true cells."""

UNLABELLED = len(Label)
"""The last column of a confusion matrix: a return of a labelled scan that has no label."""

STRUCTURE = (Label.FLOOR, Label.CEILING, Label.WALL, Label.DOOR)

EITHER = {
    Truth.OPEN_LEAF: (Label.DOOR, Label.CLUTTER),
    Truth.FULL_HEIGHT_CABINET: (Label.WALL, Label.CLUTTER),
    Truth.BOARD_ON_WALL: (Label.WALL, Label.CLUTTER),
    Truth.PERSON: (Label.CLUTTER, Label.OUTSIDE),
}
"""Classes for which two labels are right; with either they count nowhere."""

DOOR_NEAR_M = 0.3
DOOR_RANGE_M = 6.0
DOOR_RETURNS = 200
MATCH_MIDPOINT_M = 0.3
MATCH_DIRECTION_DEG = 15.0
WALL_TOLERANCE_M = 0.10
WALL_RETURNS = 3
RELATIVE_M = 1.0
"""Length of true path over which the relative error of a trajectory is taken."""

_TRUTHS, _LABELS = len(Truth), len(Label) + 1


@dataclass(frozen=True)
class TrueDoors:
    """Doors as built, in the map.

    ends: (D, 2, 2) x and y of the two jambs, along the sill; between them lies the clear width.
    head_m: (D,) height of the frame's head above the floor.
    leaves: one array (k, 2, 2) for each door: x and y of the hinge's and of the free edge of its k leaves.
    state: (D,) uint8, see `algorithms.doors.DoorState`; open means ajar by more than 10 cm.
    """

    ends: FloatArray
    head_m: FloatArray
    leaves: tuple[FloatArray, ...]
    state: UInt8Array

    def __len__(self) -> int:
        return len(self.ends)


@dataclass(frozen=True)
class FoundDoors:
    """Doors that a run claims, in the map.

    ends: (E, 2, 2) x and y of the jambs along the sill. width_m: (E,). state: (E,) uint8, see `DoorState`.
    """

    ends: FloatArray
    width_m: FloatArray
    state: UInt8Array

    def __len__(self) -> int:
        return len(self.ends)


@dataclass(frozen=True)
class Tally:
    """What was counted over some scans.

    cubes: votes of every cube: first for each `Truth`, then for each column of `confusion_points`, then the same
        columns again for the labels of single scans.
    confusion_points, confusion_points_scan: (11, 7) int64, points by `Truth` and `Label` (last column: unlabelled),
        for the labels of the building and for those of single scans.
    door_returns: (D,) int64, returns near each true door's frame or leaf, taken from near enough.
    scans: how many scans were counted; skipped: how many had no label at all and were left out.
    """

    cubes: VoxelVotes
    confusion_points: IntArray
    confusion_points_scan: IntArray
    door_returns: IntArray
    scans: int
    skipped: int


class Counter:
    """Counts scans into a `Tally`; also takes in other tallies, so that processes can count side by side."""

    def __init__(self, doors: TrueDoors) -> None:
        self._doors = _door_edges(doors)
        self._cubes = VoxelTable(CUBE_M, _TRUTHS + 2 * _LABELS)
        self._confusion = np.zeros((2, _TRUTHS, _LABELS), np.int64)
        self._door_returns: IntArray = np.zeros(len(doors), np.int64)
        self._scans = 0
        self._skipped = 0

    def add(
        self,
        points_map: FloatArray,
        origin_map: FloatArray,
        truth: UInt8Array,
        label: UInt8Array,
        label_scan: UInt8Array,
    ) -> None:
        """Count one scan. A scan without any label was skipped by the run and is left out; a return without truth too.

        points_map: (n, 3) its returns, placed with the TRUE poses. origin_map: (3,) where the sensor stood.
        truth: (n,) see `Truth`; label, label_scan: (n,) see `Label`.
        """
        if not len(label) or label.min() == NO_RETURN:
            self.skip()
            return
        self._scans += 1
        points_map, codes = _count_points(points_map, truth, label, label_scan, self._confusion)
        self._cubes.add(points_map, *codes)
        _count_near(points_map, np.asarray(origin_map, np.float64), *self._doors, self._door_returns)

    def skip(self) -> None:
        """Count a scan that the run skipped."""
        self._skipped += 1

    def absorb(self, tally: Tally) -> None:
        """Add what another process counted against the same doors."""
        self._cubes.absorb(tally.cubes)
        self._confusion[0] += tally.confusion_points
        self._confusion[1] += tally.confusion_points_scan
        self._door_returns += tally.door_returns
        self._scans += tally.scans
        self._skipped += tally.skipped

    def tally(self) -> Tally:
        """What was counted so far."""
        return Tally(
            cubes=self._cubes.votes(),
            confusion_points=self._confusion[0].copy(),
            confusion_points_scan=self._confusion[1].copy(),
            door_returns=self._door_returns.copy(),
            scans=self._scans,
            skipped=self._skipped,
        )


def majorities(cubes: VoxelVotes, single_scans: bool = False) -> tuple[UInt8Array, UInt8Array]:
    """The `Truth` and the `Label` (m,) of each cube: its majority's (of equals the lower code)."""
    first = _TRUTHS + (_LABELS if single_scans else 0)
    return majority(cubes.counts[:, :_TRUTHS]), majority(cubes.counts[:, first : first + _LABELS])


def confusion_by_area(cubes: VoxelVotes, single_scans: bool = False) -> IntArray:
    """(11, 7) int64: cubes by their `majorities`."""
    truth, label = majorities(cubes, single_scans)
    joint = truth.astype(np.intp) * _LABELS + label
    return np.bincount(joint, minlength=_TRUTHS * _LABELS).reshape(_TRUTHS, _LABELS)


@dataclass(frozen=True)
class ClassFigures:
    """Right, wrong and missed, of one label; eq. 3. NaN where there is nothing to divide by."""

    true_positives: int
    false_positives: int
    false_negatives: int

    @property
    def precision(self) -> float:
        return _ratio(self.true_positives, self.true_positives + self.false_positives)

    @property
    def recall(self) -> float:
        return _ratio(self.true_positives, self.true_positives + self.false_negatives)

    @property
    def f1(self) -> float:
        return _ratio(2 * self.true_positives, 2 * self.true_positives + self.false_positives + self.false_negatives)


def class_figures(confusion: IntArray) -> dict[Label, ClassFigures]:
    """Every label's figures from a confusion matrix (11, 7).

    Glass panes are left out. Where two labels are right, either counts nowhere and any other is a false positive of
    its label. What is outside, and people, are right unless labelled as structure: "outside" is then a true positive
    of its own only on what is outside, and clutter counts nowhere.
    """
    counted = confusion.copy()
    counted[Truth.GLASS] = 0
    counted[Truth.OUTSIDE, Label.CLUTTER] = 0
    for truth, right in EITHER.items():
        counted[truth, list(right)] = 0
    return {
        label: ClassFigures(
            true_positives=int(counted[label, label]),
            false_positives=int(counted[:, label].sum() - counted[label, label]),
            false_negatives=int(counted[label].sum() - counted[label, label]),
        )
        for label in Label
    }


def verdicts(truth: UInt8Array, label: UInt8Array) -> UInt8Array:
    """`Verdict` (n,) of labels (n,) on what truly is `truth` (n,); what counts nowhere is right."""
    return _VERDICT_OF[np.minimum(truth, _TRUTHS), np.minimum(label, UNLABELLED)]


def _tabulate_verdicts() -> UInt8Array:
    """(12, 7) by `Truth` and label; the last row is for points whose truth is not known."""
    table: UInt8Array = np.full((_TRUTHS + 1, _LABELS), Verdict.RIGHT, np.uint8)
    for truth in Truth:
        for label in range(_LABELS):
            alone = np.zeros((_TRUTHS, _LABELS), np.int64)
            alone[truth, label] = 1
            # Wrong is what is a false positive of its label or a false negative of its truth.
            figures = class_figures(alone).values()
            if not any(f.false_positives or f.false_negatives for f in figures):
                continue
            table[truth, label] = (
                Verdict.FALSE_WALL
                if label == Label.WALL
                else Verdict.MISSED_WALL
                if truth == Truth.WALL
                else Verdict.FALSE_DOOR
                if label == Label.DOOR
                else Verdict.MISSED_DOOR
                if truth == Truth.DOOR
                else Verdict.OTHER
            )
    return table


_VERDICT_OF = _tabulate_verdicts()


def outside_kept(confusion: IntArray) -> float:
    """The share of what is outside that was labelled as structure; NaN where nothing is outside."""
    return _ratio(int(confusion[Truth.OUTSIDE, list(STRUCTURE)].sum()), int(confusion[Truth.OUTSIDE].sum()))


@dataclass(frozen=True)
class DoorFigures:
    """Doors found, missed and invented.

    passed: (D,) bool, whether the true door was passed. match: (D,) the detection that matches each, -1 for none.
    detections: how many doors the run claims.
    width_error_m: (k,) found minus true clear width, of the matched doors that were passed.
    state_right: (k,) bool, of the same.
    """

    passed: BoolArray
    match: IntArray
    detections: int
    width_error_m: FloatArray
    state_right: BoolArray

    @property
    def found_count(self) -> int:
        return int(np.count_nonzero(self.passed & (self.match >= 0)))

    @property
    def invented_count(self) -> int:
        """Detections that match no true door, passed or not."""
        return self.detections - int(np.count_nonzero(self.match >= 0))

    @property
    def found(self) -> float:
        return _ratio(self.found_count, int(np.count_nonzero(self.passed)))

    @property
    def invented(self) -> float:
        return _ratio(self.invented_count, self.detections)


def compare_doors(true: TrueDoors, door_returns: IntArray, found: FoundDoors) -> DoorFigures:
    """Match detections to true doors one to one, nearest sill midpoints first, and count."""
    passed = np.asarray(door_returns) >= DOOR_RETURNS
    match = match_doors(true.ends, found.ends)
    both = passed & (match >= 0)
    true_width = lengths_m(true.ends)
    return DoorFigures(
        passed=passed,
        match=match,
        detections=len(found),
        width_error_m=found.width_m[match[both]] - true_width[both],
        state_right=found.state[match[both]] == true.state[both],
    )


def match_doors(ends: FloatArray, others: FloatArray) -> IntArray:
    """(n,) the one of the others that each door is, -1 for none: one to one, nearest midpoints of the sills first.

    ends, others: (n, 2, 2), (m, 2, 2) sills. Midpoints within 0.3 m, directions within 15°.
    """
    match = np.full(len(ends), -1)
    if len(ends) and len(others):
        distance = np.linalg.norm(ends.mean(axis=1)[:, None] - others.mean(axis=1), axis=2)
        cosine = np.abs(np.sum(_direction(ends)[:, None] * _direction(others), axis=2))
        possible = (distance <= MATCH_MIDPOINT_M) & (cosine >= np.cos(np.radians(MATCH_DIRECTION_DEG)))
        taken = np.zeros(len(others), bool)
        for i, j in _nearest_first(distance, possible):
            if match[i] < 0 and not taken[j]:
                match[i], taken[j] = j, True
    return match


@dataclass(frozen=True)
class WallMapFigures:
    """The map's occupied cells against the true wall faces.

    occupied: (m, 2) centres of the occupied cells. distance_m: (m,) to the nearest true face (infinite without any).
    true_cells: (k, 2) centres of the true cells. covered: (k,) bool, whether an occupied cell lies near each.
    """

    occupied: FloatArray
    distance_m: FloatArray
    true_cells: FloatArray
    covered: BoolArray

    @property
    def right(self) -> BoolArray:
        """(m,) whether each occupied cell lies near a true face."""
        return self.distance_m <= WALL_TOLERANCE_M + 1e-9

    @property
    def precision(self) -> float:
        return _ratio(int(np.count_nonzero(self.right)), len(self.right))

    @property
    def recall(self) -> float:
        return _ratio(int(np.count_nonzero(self.covered)), len(self.covered))

    @property
    def error_m(self) -> float:
        """Mean distance of the right cells; NaN without any."""
        return float(self.distance_m[self.right].mean()) if self.right.any() else float("nan")


def compare_wall_map(faces: FloatArray, cubes: VoxelVotes, grid: GridMap) -> WallMapFigures:
    """Occupied cells against true wall faces (F, 2, 2), both in the map's frame.

    A true cell is a 5 cm cell that a face runs through and that holds at least 3 returns of walls.
    """
    rows, columns = np.nonzero(grid.cells == Cell.OCCUPIED)
    occupied = grid.origin + (np.stack([columns, rows], axis=1) + 0.5) * grid.cell_m
    cells = _seen_cells(faces, cubes)
    true_cells = (cells + 0.5) * CUBE_M
    if len(occupied) and len(true_cells):
        nearest = cKDTree(occupied).query(true_cells)[0]
        covered = nearest <= WALL_TOLERANCE_M + 1e-9
    else:
        covered = np.zeros(len(true_cells), bool)
    distance = _distance_to_segments(occupied, np.ascontiguousarray(faces, np.float64))
    return WallMapFigures(occupied, distance, true_cells, covered)


@dataclass(frozen=True)
class TrajectoryFigures:
    """A trajectory against the truth.

    error_m: (n,) distance of each position after the rotation and shift that fit best (Umeyama, without scale).
    error_unaligned_m: (n,) distance of each position as it stands in the map's frame.
    rotation_error_deg: (n,) angle of each orientation after the turn that fits the orientations best.
    relative_translation_m, relative_rotation_deg: (k,) error of each motion over `RELATIVE_M` of true path.
    """

    error_m: FloatArray
    error_unaligned_m: FloatArray
    rotation_error_deg: FloatArray
    relative_translation_m: FloatArray
    relative_rotation_deg: FloatArray

    @property
    def poses(self) -> int:
        return len(self.error_m)

    @property
    def ate_rmse_m(self) -> float:
        return rms(self.error_m)


def compare_trajectories(found: Trajectory, true: Trajectory) -> TrajectoryFigures:
    """Errors at the stamps of `found` that `true` covers; empty arrays where there are none."""
    stamp_ns = found.stamp_ns[true.covers(found.stamp_ns)]
    if not len(stamp_ns):
        none = np.zeros(0)
        return TrajectoryFigures(none, none, none, none, none)
    T_map_found, T_map_true = found.at(stamp_ns), true.at(stamp_ns)
    moved = transforms.apply(align(T_map_found[:, :3, 3], T_map_true[:, :3, 3]), T_map_found[:, :3, 3])
    difference = Rotation.from_matrix(T_map_true[:, :3, :3] @ np.swapaxes(T_map_found[:, :3, :3], 1, 2))
    start, end = _motions(T_map_true[:, :3, 3])
    motion_found = transforms.invert(T_map_found[start]) @ T_map_found[end]
    motion_true = transforms.invert(T_map_true[start]) @ T_map_true[end]
    error = transforms.invert(motion_true) @ motion_found
    return TrajectoryFigures(
        error_m=np.linalg.norm(moved - T_map_true[:, :3, 3], axis=1),
        error_unaligned_m=np.linalg.norm(T_map_found[:, :3, 3] - T_map_true[:, :3, 3], axis=1),
        rotation_error_deg=np.degrees((difference * difference.mean().inv()).magnitude()),
        relative_translation_m=np.linalg.norm(error[:, :3, 3], axis=1),
        relative_rotation_deg=(
            np.degrees(Rotation.from_matrix(error[:, :3, :3]).magnitude()) if len(error) else np.zeros(0)
        ),
    )


def align(positions_source: FloatArray, positions_target: FloatArray) -> FloatArray:
    """T_target_source (4, 4) that brings positions (n, 3) nearest to their partners (Umeyama 1991, without scale)."""
    centre_source, centre_target = positions_source.mean(axis=0), positions_target.mean(axis=0)
    U, _, Vt = np.linalg.svd((positions_target - centre_target).T @ (positions_source - centre_source))
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    T = np.eye(4)
    T[:3, :3] = U @ sign @ Vt
    T[:3, 3] = centre_target - T[:3, :3] @ centre_source
    return T


def rms(values: FloatArray) -> float:
    """Root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def _direction(ends: FloatArray) -> FloatArray:
    along = ends[:, 1] - ends[:, 0]
    unit: FloatArray = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return unit


def _nearest_first(distance: FloatArray, possible: BoolArray) -> Sequence[tuple[int, int]]:
    pairs = np.argwhere(possible)
    order = np.argsort(distance[possible], kind="stable")
    return [(int(t), int(f)) for t, f in pairs[order]]


def _door_edges(doors: TrueDoors) -> tuple[FloatArray, FloatArray, IntArray]:
    """Frames and leaves as upright rectangles and edges that returns can be near to.

    Returns panels (p, 2, 2), their height range (p, 2) and their door (p,): two jambs (panels without width), the
    head (a panel without height) and the leaves.
    """
    panels, heights, owner = [], [], []
    for door, (ends, head_m, leaves) in enumerate(zip(doors.ends, doors.head_m, doors.leaves, strict=True)):
        for panel, bottom_m in (
            (np.stack([ends[0], ends[0]]), 0.0),
            (np.stack([ends[1], ends[1]]), 0.0),
            (ends, head_m),
            *((leaf, 0.0) for leaf in leaves),
        ):
            panels.append(panel)
            heights.append((bottom_m, head_m))
            owner.append(door)
    return (
        np.array(panels, np.float64).reshape(-1, 2, 2),
        np.array(heights, np.float64).reshape(-1, 2),
        np.array(owner, np.int64),
    )


@numba.njit(cache=True, nogil=True)
def _count_points(
    points: FloatArray, truth: UInt8Array, label: UInt8Array, label_scan: UInt8Array, confusion: IntArray
) -> tuple[FloatArray, UInt8Array]:  # pragma: no cover
    """Count the points whose truth is known; return them, and the votes (3, m) that each has for its cube."""
    kept: FloatArray = np.empty((len(points), 3), np.float64)
    codes: UInt8Array = np.empty((3, len(points)), np.uint8)
    n = 0
    for i in range(len(points)):
        finite = np.isfinite(points[i, 0]) and np.isfinite(points[i, 1]) and np.isfinite(points[i, 2])
        if not finite or truth[i] >= _TRUTHS:
            continue
        column, column_scan = min(label[i], UNLABELLED), min(label_scan[i], UNLABELLED)
        confusion[0, truth[i], column] += 1
        confusion[1, truth[i], column_scan] += 1
        kept[n] = points[i]
        codes[0, n] = truth[i]
        codes[1, n] = _TRUTHS + column
        codes[2, n] = _TRUTHS + _LABELS + column_scan
        n += 1
    return kept[:n], codes[:, :n]


@numba.njit(cache=True, nogil=True)
def _count_near(
    points: FloatArray,
    origin: FloatArray,
    panels: FloatArray,
    heights: FloatArray,
    owner: IntArray,
    returns: IntArray,
) -> None:  # pragma: no cover
    """Count each return once for each door that has a panel within `DOOR_NEAR_M` of it."""
    first = 0
    while first < len(owner):
        last = first
        low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
        while last < len(owner) and owner[last] == owner[first]:
            for end in range(2):
                low_x, high_x = min(low_x, panels[last, end, 0]), max(high_x, panels[last, end, 0])
                low_y, high_y = min(low_y, panels[last, end, 1]), max(high_y, panels[last, end, 1])
            last += 1
        low_x, low_y = low_x - DOOR_NEAR_M, low_y - DOOR_NEAR_M
        high_x, high_y = high_x + DOOR_NEAR_M, high_y + DOOR_NEAR_M
        # A door whose nearest place is out of reach has no return that was taken from near enough.
        away_x = max(low_x - origin[0], 0.0, origin[0] - high_x)
        away_y = max(low_y - origin[1], 0.0, origin[1] - high_y)
        if away_x**2 + away_y**2 <= DOOR_RANGE_M**2:
            for i in range(len(points)):
                x, y, z = points[i, 0], points[i, 1], points[i, 2]
                if x < low_x or x > high_x or y < low_y or y > high_y:
                    continue
                reach = (x - origin[0]) ** 2 + (y - origin[1]) ** 2 + (z - origin[2]) ** 2
                if reach > DOOR_RANGE_M**2:
                    continue
                for k in range(first, last):
                    above = max(heights[k, 0] - z, 0.0, z - heights[k, 1])
                    if _squared_distance(x, y, panels[k]) + above**2 <= DOOR_NEAR_M**2:
                        returns[owner[k]] += 1
                        break
        first = last


@numba.njit(cache=True, nogil=True)
def _squared_distance(x: float, y: float, segment: FloatArray) -> float:  # pragma: no cover
    along_x, along_y = segment[1, 0] - segment[0, 0], segment[1, 1] - segment[0, 1]
    to_x, to_y = x - segment[0, 0], y - segment[0, 1]
    length = along_x**2 + along_y**2
    t = min(max((to_x * along_x + to_y * along_y) / length, 0.0), 1.0) if length > 0 else 0.0
    return float((to_x - t * along_x) ** 2 + (to_y - t * along_y) ** 2)


@numba.njit(cache=True, nogil=True)
def _distance_to_segments(points: FloatArray, segments: FloatArray) -> FloatArray:  # pragma: no cover
    distance = np.full(len(points), np.inf)
    for i in range(len(points)):
        for k in range(len(segments)):
            distance[i] = min(distance[i], _squared_distance(points[i, 0], points[i, 1], segments[k]))
    root: FloatArray = np.sqrt(distance)
    return root


def _seen_cells(faces: FloatArray, cubes: VoxelVotes) -> IntArray:
    """(k, 2) int64: the cells that faces run through and that hold enough returns of walls."""
    column, first = np.unique(columns_of(cubes.keys), return_index=True)
    if not len(column) or not len(faces):
        return np.zeros((0, 2), np.int64)
    returns = np.add.reduceat(cubes.counts[:, Truth.WALL], first, dtype=np.int64)
    cells = np.unique(np.concatenate([cells_along(face, CUBE_M) for face in faces]), axis=0)
    seen: IntArray = cells[np.isin(pack_column(cells), column[returns >= WALL_RETURNS])]
    return seen


def cells_along(segment: FloatArray, cell_m: float) -> IntArray:
    """(k, 2) int64: the cells of a grid that a segment (2, 2) runs through."""
    start, along = segment[0] * (1.0 / cell_m), (segment[1] - segment[0]) * (1.0 / cell_m)
    crossings = [np.array([0.0, 1.0])]
    for axis in range(2):
        if along[axis] != 0:
            low, high = sorted((start[axis], start[axis] + along[axis]))
            crossings.append((np.arange(np.ceil(low), np.floor(high) + 1) - start[axis]) / along[axis])
    t = np.unique(np.clip(np.concatenate(crossings), 0.0, 1.0))
    middle = (t[:-1] + t[1:]) / 2
    cells: IntArray = np.unique(np.floor(start + middle[:, None] * along).astype(np.int64), axis=0)
    return cells


def _motions(positions: FloatArray) -> tuple[IntArray, IntArray]:
    """Each pose, and the first later one at least `RELATIVE_M` of path further."""
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    end = np.searchsorted(path, path + RELATIVE_M - 1e-9)
    start = np.flatnonzero(end < len(path))
    return start, end[start]
