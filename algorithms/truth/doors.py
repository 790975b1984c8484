"""Doors against the truth: which were passed, found, missed and invented (paper, IV.B)."""

from dataclasses import dataclass

import numba
import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.truth.labels import ratio

DOOR_NEAR_M = 0.3
DOOR_RANGE_M = 6.0
DOOR_RETURNS = 200
"""A door was passed if this many returns lie this near to its frame or leaf (m), taken from within the range (m)."""


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
        return ratio(self.found_count, int(np.count_nonzero(self.passed)))

    @property
    def invented(self) -> float:
        return ratio(self.invented_count, self.detections)


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
    if not len(ends) or not len(others):
        return np.full(len(ends), -1)
    distance_m = np.linalg.norm(ends.mean(axis=1)[:, None] - others.mean(axis=1), axis=2)
    cosine = np.abs(np.sum(_direction(ends)[:, None] * _direction(others), axis=2))
    return match_nearest(distance_m, (distance_m <= 0.3) & (cosine >= np.cos(np.radians(15.0))))


def match_nearest(distance: FloatArray, possible: BoolArray) -> IntArray:
    """(n,) the column that each row of a matrix (n, m) is matched with, -1 for none: one to one, nearest first."""
    match, taken = np.full(len(distance), -1), np.zeros(distance.shape[1], bool)
    pairs = np.argwhere(possible)
    for i, j in pairs[np.argsort(distance[possible], kind="stable")]:
        if match[i] < 0 and not taken[j]:
            match[i], taken[j] = j, True
    return match


def _direction(ends: FloatArray) -> FloatArray:
    along = ends[:, 1] - ends[:, 0]
    return np.asarray(along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9))


def door_edges(doors: TrueDoors) -> tuple[FloatArray, FloatArray, IntArray]:
    """Frames and leaves as upright rectangles and edges that returns can be near to.

    Returns panels (p, 2, 2), their height range (p, 2) and their door (p,): two jambs (panels without width), the
    head (a panel without height) and the leaves.
    """
    panels, heights, owner = [], [], []
    for door, (ends, head_m, leaves) in enumerate(zip(doors.ends, doors.head_m, doors.leaves, strict=True)):
        jambs = ends[:, None].repeat(2, axis=1)  # without width
        for panel, bottom_m in ((jambs[0], 0.0), (jambs[1], 0.0), (ends, head_m), *((leaf, 0.0) for leaf in leaves)):
            panels.append(panel)
            heights.append((bottom_m, head_m))
            owner.append(door)
    return (
        np.array(panels, np.float64).reshape(-1, 2, 2),
        np.array(heights, np.float64).reshape(-1, 2),
        np.array(owner, np.int64),
    )


@numba.njit(cache=True, nogil=True)
def count_near(
    points: FloatArray, origin: FloatArray, panels: FloatArray, heights: FloatArray, owner: IntArray, returns: IntArray
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
                    if squared_distance(x, y, panels[k]) + above**2 <= DOOR_NEAR_M**2:
                        returns[owner[k]] += 1
                        break
        first = last


@numba.njit(cache=True, nogil=True)
def squared_distance(x: float, y: float, segment: FloatArray) -> float:  # pragma: no cover
    along_x, along_y = segment[1, 0] - segment[0, 0], segment[1, 1] - segment[0, 1]
    to_x, to_y = x - segment[0, 0], y - segment[0, 1]
    length = along_x**2 + along_y**2
    t = min(max((to_x * along_x + to_y * along_y) / length, 0.0), 1.0) if length > 0 else 0.0
    return float((to_x - t * along_x) ** 2 + (to_y - t * along_y) ** 2)
