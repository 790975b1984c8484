"""Precision, recall and F1 of the labels against the truth (paper, IV.B, eq. 3), and the verdict on each point."""

from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.labels import Label, Truth, Verdict
from ffmap.algorithms.base.scan import IntArray, UInt8Array

UNLABELLED = len(Label)  # the last column of a confusion matrix: a return of a labelled scan that has no label

STRUCTURE = (Label.FLOOR, Label.CEILING, Label.WALL, Label.DOOR)

EITHER = {
    Truth.OPEN_LEAF: (Label.DOOR, Label.CLUTTER),
    Truth.FULL_HEIGHT_CABINET: (Label.WALL, Label.CLUTTER),
    Truth.BOARD_ON_WALL: (Label.WALL, Label.CLUTTER),
    Truth.PERSON: (Label.CLUTTER, Label.OUTSIDE),
}
"""Classes for which two labels are right; with either they count nowhere."""


@dataclass(frozen=True)
class ClassFigures:
    """Right, wrong and missed, of one label; eq. 3. NaN where there is nothing to divide by."""

    true_positives: int
    false_positives: int
    false_negatives: int

    @property
    def precision(self) -> float:
        return ratio(self.true_positives, self.true_positives + self.false_positives)

    @property
    def recall(self) -> float:
        return ratio(self.true_positives, self.true_positives + self.false_negatives)

    @property
    def f1(self) -> float:
        return ratio(2 * self.true_positives, 2 * self.true_positives + self.false_positives + self.false_negatives)


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
    return _VERDICT_OF[np.minimum(truth, len(Truth)), np.minimum(label, UNLABELLED)]


def _tabulate_verdicts() -> UInt8Array:
    """(12, 7) by `Truth` and label; the last row is for points whose truth is not known."""
    table: UInt8Array = np.full((len(Truth) + 1, UNLABELLED + 1), Verdict.RIGHT, np.uint8)
    for truth in Truth:
        for label in range(UNLABELLED + 1):
            alone = np.zeros((len(Truth), UNLABELLED + 1), np.int64)
            alone[truth, label] = 1
            # Wrong is what is a false positive of its label or a false negative of its truth.
            figures = class_figures(alone).values()
            if any(f.false_positives or f.false_negatives for f in figures):
                reasons = (
                    (label == Label.WALL, Verdict.FALSE_WALL),
                    (truth == Truth.WALL, Verdict.MISSED_WALL),
                    (label == Label.DOOR, Verdict.FALSE_DOOR),
                    (truth == Truth.DOOR, Verdict.MISSED_DOOR),
                )
                table[truth, label] = next((verdict for holds, verdict in reasons if holds), Verdict.OTHER)
    return table


_VERDICT_OF = _tabulate_verdicts()


def outside_kept(confusion: IntArray) -> float:
    """The share of what is outside that was labelled as structure; NaN where nothing is outside."""
    return ratio(int(confusion[Truth.OUTSIDE, list(STRUCTURE)].sum()), int(confusion[Truth.OUTSIDE].sum()))


def ratio(part: int, whole: int) -> float:
    """A share; NaN of nothing."""
    return part / whole if whole else float("nan")
