"""What is counted of each labelled scan against the truth: points, the area of each class, returns at doors.

What is counted block by block adds up to the same sum in any order and in any portions; figures are made from the sum.
"""

from dataclasses import dataclass

import numba
import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN, Truth
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, majority
from ffmap.algorithms.truth.doors import TrueDoors, count_near, door_edges
from ffmap.algorithms.truth.labels import UNLABELLED

CUBE_M = 0.05  # edge of the cubes that area is counted in, and of the wall map's true cells

_TRUTHS, _LABELS = len(Truth), UNLABELLED + 1


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
        self._doors = door_edges(doors)
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
        count_near(points_map, np.asarray(origin_map, np.float64), *self._doors, self._door_returns)

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
