"""Doors against the ground truth: which were passed, found, missed and invented (paper, IV.B)."""

from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m

RETURNS_MIN = 200
"""Minimum number of returns near the frame or leaf of a door that was passed."""
NEAR_M = 0.3
"""Maximum distance (m) of these returns from frame or leaf."""
RANGE_M = 6.0
"""Maximum range (m) of these returns."""
MATCH_M = 0.3
"""Maximum distance (m) of the midpoints of matching doors."""
MATCH_DEG = 15.0
"""Maximum angle (°) between matching doors."""


@dataclass(frozen=True)
class TrueDoors:
    """Doors of the ground truth, in the map.

    ends: (D, 2, 2) the two jambs, along the sill; the clear width is between them.
    head_m: (D,) height of the lintel's underside above the floor.
    leaves: for each door (k, 2, 2), the hinge and the free edge of its k leaves.
    state: (D,) `DoorState`; open means ajar by more than 10 cm.
    """

    ends: FloatArray
    head_m: FloatArray
    leaves: tuple[FloatArray, ...]
    state: UInt8Array

    def __len__(self) -> int:
        return len(self.ends)


@dataclass(frozen=True)
class FoundDoors:
    """Doors that a run detected, in the map.

    ends: (E, 2, 2) the jambs along the sill. width_m: (E,). state: (E,) `DoorState`.
    """

    ends: FloatArray
    width_m: FloatArray
    state: UInt8Array

    def __len__(self) -> int:
        return len(self.ends)


@dataclass(frozen=True)
class DoorComparison:
    """Detections matched with true doors.

    passed: (D,) whether the true door was passed. match: (D,) its detection, -1 for none.
    detections: number of detections.
    width_error_m, state_right: (k,) of the matched doors that were passed: detected minus true
        clear width, and whether the state is right.
    """

    passed: BoolArray
    match: IntArray
    detections: int
    width_error_m: FloatArray
    state_right: BoolArray


def compare_doors(true: TrueDoors, door_returns: IntArray, found: FoundDoors) -> DoorComparison:
    """Match detections with true doors; `door_returns` (D,) are those near each true door."""
    passed = np.asarray(door_returns) >= RETURNS_MIN
    match = match_doors(true.ends, found.ends)
    both = passed & (match >= 0)
    return DoorComparison(
        passed=passed,
        match=match,
        detections=len(found),
        width_error_m=found.width_m[match[both]] - lengths_m(true.ends)[both],
        state_right=found.state[match[both]] == true.state[both],
    )


def match_doors(ends: FloatArray, others: FloatArray) -> IntArray:
    """Match doors (n, 2, 2) one to one with others (m, 2, 2), nearest midpoints first.

    Returns (n,) the index of each door's partner, -1 for none.
    """
    if not len(ends) or not len(others):
        return np.full(len(ends), -1)
    distance_m = np.linalg.norm(ends.mean(axis=1)[:, None] - others.mean(axis=1), axis=2)
    cosine = np.abs(np.sum(_direction(ends)[:, None] * _direction(others), axis=2))
    possible = (distance_m <= MATCH_M) & (cosine >= np.cos(np.radians(MATCH_DEG)))
    match, taken = np.full(len(ends), -1), np.zeros(len(others), bool)
    pairs = np.argwhere(possible)
    for i, j in pairs[np.argsort(distance_m[possible], kind="stable")]:
        if match[i] < 0 and not taken[j]:
            match[i], taken[j] = j, True
    return match


def _direction(ends: FloatArray) -> FloatArray:
    along = ends[:, 1] - ends[:, 0]
    return np.asarray(along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9))


def count_near(points: FloatArray, origin: FloatArray, doors: TrueDoors) -> IntArray:
    """Count the points (n, 3) near jambs, lintel and leaves of each door. origin: (3,) sensor."""
    counts: IntArray = np.zeros(len(doors), np.int64)
    for door, (ends, head_m) in enumerate(zip(doors.ends, doors.head_m, strict=True)):
        # Upright rectangles: a jamb has no width, the lintel, the third, no height.
        jambs = ends[:, None].repeat(2, axis=1)
        panels = np.array([*jambs, ends, *doors.leaves[door]], np.float64)
        low, high = panels.min(axis=(0, 1)) - NEAR_M, panels.max(axis=(0, 1)) + NEAR_M
        away = np.maximum(np.maximum(low - origin[:2], origin[:2] - high), 0.0)
        if (away**2).sum() > RANGE_M**2:
            continue
        inside = ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)
        x, y, z = (points[inside] - origin).T
        places = points[inside][x**2 + y**2 + z**2 <= RANGE_M**2]
        near = np.zeros(len(places), bool)
        for k, panel in enumerate(panels):
            bottom_m = head_m if k == 2 else 0.0
            above_m = np.maximum(np.maximum(bottom_m - places[:, 2], places[:, 2] - head_m), 0.0)
            near |= squared_distances(places[:, :2], panel) + above_m**2 <= NEAR_M**2
        counts[door] = np.count_nonzero(near)
    return counts


def squared_distances(points: FloatArray, segment: FloatArray) -> FloatArray:
    """Return the squared distances (n,) of points (n, 2) from a segment (2, 2)."""
    (x, y), (along_x, along_y) = (points - segment[0]).T, segment[1] - segment[0]
    length = along_x**2 + along_y**2
    t = np.clip((x * along_x + y * along_y) / length, 0.0, 1.0) if length > 0 else 0.0
    return np.asarray((x - t * along_x) ** 2 + (y - t * along_y) ** 2)
