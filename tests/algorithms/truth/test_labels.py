"""Rules by which labels are counted, against counts by hand."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label, Truth, Verdict
from ffmap.algorithms.truth.labels import UNLABELLED, outside_kept, right_wrong_missed, verdicts


def one(truth: int, label: int, count: int = 1) -> np.ndarray:
    """A confusion matrix with a single entry."""
    confusion = np.zeros((len(Truth), UNLABELLED + 1), np.int64)
    confusion[truth, label] = count
    return confusion


def counts(confusion: np.ndarray) -> dict[Label, tuple[int, int, int]]:
    """Right, wrong and missed of the labels that count anything."""
    rows = zip(Label, right_wrong_missed(confusion).tolist(), strict=True)
    return {label: tuple(row) for label, row in rows if any(row)}


@pytest.mark.parametrize(
    ("truth", "right"),
    [
        (Truth.GLASS, {*Label, UNLABELLED}),
        (Truth.FULL_HEIGHT_CABINET, {Label.WALL, Label.CLUTTER}),
        (Truth.BOARD_ON_WALL, {Label.WALL, Label.CLUTTER}),
        (Truth.OPEN_LEAF, {Label.DOOR, Label.CLUTTER}),
        (Truth.PERSON, {Label.CLUTTER, Label.OUTSIDE}),
    ],
)
def test_what_counts_nowhere_and_where_two_labels_are_right(truth: Truth, right: set[int]) -> None:
    for label in Label:
        assert counts(one(truth, label)) == ({} if label in right else {label: (0, 1, 0)})
    assert counts(one(truth, UNLABELLED)) == {}


def test_a_wrong_label_is_missed_there_and_false_here() -> None:
    confusion = one(3, 3, 8) + one(3, 0, 2) + one(0, 3, 1) + one(3, UNLABELLED, 4)
    assert counts(confusion) == {Label.WALL: (8, 1, 6), Label.CLUTTER: (0, 2, 1)}
    assert counts(one(Truth.OUTSIDE, Label.CLUTTER)) == {}
    assert counts(one(Truth.OUTSIDE, Label.OUTSIDE)) == {Label.OUTSIDE: (1, 0, 0)}
    for label in (Label.FLOOR, Label.CEILING, Label.WALL, Label.DOOR):
        expected = {label: (0, 1, 0), Label.OUTSIDE: (0, 0, 1)}
        assert counts(one(Truth.OUTSIDE, label)) == expected


def test_outside_kept_as_structure() -> None:
    confusion = one(5, 5, 6) + one(5, 0, 2) + one(5, 3, 1) + one(5, 1, 1) + one(3, 3, 90)
    assert outside_kept(confusion) == (2, 10)


def test_verdicts_agree_with_the_counts() -> None:
    expected = {
        Truth.WALL: {Label.CLUTTER: Verdict.MISSED_WALL, Label.DOOR: Verdict.MISSED_WALL},
        Truth.DOOR: {Label.WALL: Verdict.FALSE_WALL, Label.CLUTTER: Verdict.MISSED_DOOR},
        Truth.FLOOR: {Label.DOOR: Verdict.FALSE_DOOR, Label.CEILING: Verdict.OTHER},
        Truth.OPEN_LEAF: {Label.WALL: Verdict.FALSE_WALL, Label.CLUTTER: Verdict.RIGHT},
        Truth.GLASS: dict.fromkeys(Label, Verdict.RIGHT),
        Truth.OUTSIDE: {Label.CLUTTER: Verdict.RIGHT, Label.WALL: Verdict.FALSE_WALL},
    }
    for truth, by_label in expected.items():
        for label, verdict in by_label.items():
            found = verdicts(np.array([truth], np.uint8), np.array([label], np.uint8))
            assert found[0] == verdict, (truth, label)
    own = np.arange(len(Label), dtype=np.uint8)
    assert not verdicts(own, own).any()
    # Without a label a wall is missed; without ground truth nothing is counted.
    found = verdicts(np.array([3, 255], np.uint8), np.array([255, 3], np.uint8))
    assert found.tolist() == [Verdict.MISSED_WALL, Verdict.RIGHT]
