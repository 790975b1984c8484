"""Rules by which labels count against the ground truth (paper, IV.B, eq. 3)."""

import numpy as np

from ffmap.algorithms.base.labels import Label, Truth, Verdict
from ffmap.algorithms.base.scan import IntArray, UInt8Array

UNLABELLED = len(Label)
"""The last column of a confusion matrix: returns of a labelled scan without a label."""
STRUCTURE = (Label.FLOOR, Label.CEILING, Label.WALL, Label.DOOR)
EITHER = {
    Truth.OPEN_LEAF: (Label.DOOR, Label.CLUTTER),
    Truth.FULL_HEIGHT_CABINET: (Label.WALL, Label.CLUTTER),
    Truth.BOARD_ON_WALL: (Label.WALL, Label.CLUTTER),
    Truth.PERSON: (Label.CLUTTER, Label.OUTSIDE),
}
"""Classes for which two labels are right; neither of the two is counted."""


def right_wrong_missed(confusion: IntArray) -> IntArray:
    """Count true positives, false positives and false negatives (6, 3) of every label.

    Glass panes are not counted. If two labels are right, neither is counted; any other label is a
    false positive. Outside the building, the label outside is a true positive, and clutter is not
    counted.

    Args:
        confusion: (11, 7) by `Truth` and `Label`, the last column without a label.
    """
    counted = confusion.copy()
    counted[Truth.GLASS] = 0
    counted[Truth.OUTSIDE, Label.CLUTTER] = 0
    for truth, either in EITHER.items():
        counted[truth, list(either)] = 0
    labels = list(Label)
    right = counted[labels, labels]
    wrong, missed = counted[:, labels].sum(axis=0) - right, counted[labels].sum(axis=1) - right
    return np.stack([right, wrong, missed], axis=1)


def outside_kept(confusion: IntArray) -> tuple[int, int]:
    """Count returns from outside with a label of structure, and all returns from outside."""
    outside = confusion[Truth.OUTSIDE]
    return int(outside[list(STRUCTURE)].sum()), int(outside.sum())


def verdicts(truth: UInt8Array, label: UInt8Array) -> UInt8Array:
    """Return the `Verdict` (n,) of each label; labels that are not counted are right."""
    return _VERDICT_OF[np.minimum(truth, len(Truth)), np.minimum(label, UNLABELLED)]


def _tabulate_verdicts() -> UInt8Array:
    """(12, 7) by `Truth` and label; the last row is for points without ground truth."""
    table: UInt8Array = np.full((len(Truth) + 1, UNLABELLED + 1), Verdict.RIGHT, np.uint8)
    for truth in Truth:
        for label in range(UNLABELLED + 1):
            alone = np.zeros((len(Truth), UNLABELLED + 1), np.int64)
            alone[truth, label] = 1
            if not right_wrong_missed(alone)[:, 1:].any():
                continue
            reasons = (
                (label == Label.WALL, Verdict.FALSE_WALL),
                (truth == Truth.WALL, Verdict.MISSED_WALL),
                (label == Label.DOOR, Verdict.FALSE_DOOR),
                (truth == Truth.DOOR, Verdict.MISSED_DOOR),
            )
            found = (verdict for holds, verdict in reasons if holds)
            table[truth, label] = next(found, Verdict.OTHER)
    return table


_VERDICT_OF = _tabulate_verdicts()
