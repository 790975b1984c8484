"""Counts of labelled scans against the ground truth: points, areas, returns near doors."""

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN, Truth
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.votes import VoxelTable, VoxelVotes, majority
from ffmap.algorithms.truth.doors import TrueDoors, count_near
from ffmap.algorithms.truth.labels import UNLABELLED

VOXEL_M = 0.05
"""Edge of the voxels that areas are counted in, and of the cells of true walls."""
_TRUTHS, _LABELS = len(Truth), UNLABELLED + 1


class Tally:
    """Counts of scans; those of several processes add up to the same sum in any order.

    Attributes:
        confusion_points: (2, 11, 7) points by `Truth` and `Label` (last column: without a label),
            first of the final labels, then of the labels of single scans.
        door_returns: (D,) returns near each true door's frame or leaf.
        scans, skipped, without_truth: numbers of scans that were counted, that have no label, and
            that have no ground truth.
    """

    def __init__(self, doors: TrueDoors) -> None:
        self._doors = doors
        self._table = VoxelTable(VOXEL_M, _TRUTHS + 2 * _LABELS)
        self.confusion_points = np.zeros((2, _TRUTHS, _LABELS), np.int64)
        self.door_returns: IntArray = np.zeros(len(doors), np.int64)
        self.scans = self.skipped = self.without_truth = 0

    def add(
        self,
        points_map: FloatArray,
        origin_map: FloatArray,
        truth: UInt8Array,
        label: UInt8Array,
        label_scan: UInt8Array,
    ) -> None:
        """Count one scan; without any label it was skipped by the run.

        Args:
            points_map: (n, 3) its returns, placed with the true poses.
            origin_map: (3,) position of the sensor.
            truth: (n,) see `Truth`. label, label_scan: (n,) see `Label`.
        """
        if not len(label) or label.min() == NO_RETURN:
            self.skipped += 1
            return
        self.scans += 1
        known = np.isfinite(points_map).all(axis=1) & (truth < _TRUTHS)
        points, truth = points_map[known].astype(np.float64), truth[known]
        labels = [np.minimum(own[known], UNLABELLED) for own in (label, label_scan)]
        for confusion, own in zip(self.confusion_points, labels, strict=True):
            confusion += _confusion(truth, own)
        codes = (truth, _TRUTHS + labels[0], _TRUTHS + _LABELS + labels[1])
        self._table.add(points, *(code.astype(np.uint8) for code in codes))
        self.door_returns += count_near(points, np.asarray(origin_map, np.float64), self._doors)

    def absorb(self, other: "Tally") -> None:
        """Add the counts of other scans against the same doors."""
        self._table.absorb(other._table.votes())
        self.confusion_points += other.confusion_points
        self.door_returns += other.door_returns
        self.scans += other.scans
        self.skipped += other.skipped
        self.without_truth += other.without_truth

    def voxels(self) -> VoxelVotes:
        """Return the votes of all voxels, see `majorities`."""
        return self._table.votes()


def majorities(voxels: VoxelVotes, single_scans: bool = False) -> tuple[UInt8Array, UInt8Array]:
    """Return the `Truth` and `Label` (m,) with most votes in each voxel; of equals the lower."""
    first = _TRUTHS + (_LABELS if single_scans else 0)
    labels = voxels.counts[:, first : first + _LABELS]
    return majority(voxels.counts[:, :_TRUTHS]), majority(labels)


def confusion_by_area(voxels: VoxelVotes, single_scans: bool = False) -> IntArray:
    """Count voxels (11, 7) by their `majorities`."""
    return _confusion(*majorities(voxels, single_scans))


def _confusion(truth: UInt8Array, label: UInt8Array) -> IntArray:
    """(11, 7) numbers of pairs by `Truth` and `Label`."""
    joint = truth.astype(np.intp) * _LABELS + label
    return np.bincount(joint, minlength=_TRUTHS * _LABELS).reshape(_TRUTHS, _LABELS)
