"""Every rule of how labels are counted, each against an answer worked out by hand."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label, Truth, Verdict
from ffmap.algorithms.truth.labels import UNLABELLED, class_figures, outside_kept, verdicts


def one(truth: int, label: int, count: int = 1) -> np.ndarray:
    confusion = np.zeros((len(Truth), UNLABELLED + 1), np.int64)
    confusion[truth, label] = count
    return confusion


def counts(confusion: np.ndarray) -> dict[Label, tuple[int, int, int]]:
    """(true positives, false positives, false negatives) of the labels that count anything."""
    figures = {
        label: (f.true_positives, f.false_positives, f.false_negatives) for label, f in class_figures(confusion).items()
    }
    return {label: figure for label, figure in figures.items() if any(figure)}


class TestClasses:
    def test_precision_recall_and_f1_by_hand(self):
        confusion = one(3, 3, 8) + one(3, 0, 2) + one(0, 3, 1) + one(0, 0, 5)
        wall = class_figures(confusion)[Label.WALL]
        assert wall.precision == pytest.approx(8 / 9)
        assert wall.recall == pytest.approx(8 / 10)
        assert wall.f1 == pytest.approx(2 * (8 / 9) * 0.8 / (8 / 9 + 0.8))

    def test_the_papers_table_follows_from_its_areas(self):
        # Table II: wall 703.24 m² right, 2.80 wrong, 34.99 missed, in hundredths of a square metre.
        wall = class_figures(one(3, 3, 70324) + one(0, 3, 280) + one(3, 0, 3499))[Label.WALL]
        assert (round(100 * wall.precision, 2), round(100 * wall.recall, 2)) == (99.60, 95.26)
        assert 100 * wall.f1 == pytest.approx(97.37, abs=0.02)

    def test_nothing_to_divide_by(self):
        wall = class_figures(one(0, 0))[Label.WALL]
        assert np.isnan([wall.precision, wall.recall, wall.f1]).all()

    @pytest.mark.parametrize("label", range(7))
    def test_glass_is_left_out(self, label: int):
        assert counts(one(Truth.GLASS, label)) == {}

    @pytest.mark.parametrize(
        ("truth", "right"),
        [
            (Truth.FULL_HEIGHT_CABINET, {Label.WALL, Label.CLUTTER}),
            (Truth.BOARD_ON_WALL, {Label.WALL, Label.CLUTTER}),
            (Truth.OPEN_LEAF, {Label.DOOR, Label.CLUTTER}),
            (Truth.PERSON, {Label.CLUTTER, Label.OUTSIDE}),
        ],
    )
    def test_where_two_labels_are_right(self, truth: Truth, right: set[Label]):
        for label in Label:
            assert counts(one(truth, label)) == ({} if label in right else {label: (0, 1, 0)})

    def test_outside_is_right_unless_structure(self):
        assert counts(one(Truth.OUTSIDE, Label.CLUTTER)) == {}
        assert counts(one(Truth.OUTSIDE, Label.OUTSIDE)) == {Label.OUTSIDE: (1, 0, 0)}
        for label in (Label.FLOOR, Label.CEILING, Label.WALL, Label.DOOR):
            assert counts(one(Truth.OUTSIDE, label)) == {label: (0, 1, 0), Label.OUTSIDE: (0, 0, 1)}

    def test_a_wrong_label_is_missed_there_and_false_here(self):
        assert counts(one(Truth.WALL, Label.DOOR)) == {Label.WALL: (0, 0, 1), Label.DOOR: (0, 1, 0)}
        assert counts(one(Truth.CLUTTER, Label.OUTSIDE)) == {Label.CLUTTER: (0, 0, 1), Label.OUTSIDE: (0, 1, 0)}

    def test_outside_kept_as_structure(self):
        confusion = one(5, 5, 6) + one(5, 0, 2) + one(5, 3, 1) + one(5, 1, 1) + one(3, 3, 90)
        assert outside_kept(confusion) == pytest.approx(0.2)
        assert np.isnan(outside_kept(one(3, 3)))


def test_verdicts_agree_with_the_figures() -> None:
    wrong_by_truth = {
        Truth.WALL: {Label.CLUTTER: Verdict.MISSED_WALL, Label.DOOR: Verdict.MISSED_WALL},
        Truth.DOOR: {Label.WALL: Verdict.FALSE_WALL, Label.CLUTTER: Verdict.MISSED_DOOR},
        Truth.FLOOR: {Label.DOOR: Verdict.FALSE_DOOR, Label.CEILING: Verdict.OTHER},
        Truth.OPEN_LEAF: {Label.WALL: Verdict.FALSE_WALL, Label.CLUTTER: Verdict.RIGHT, Label.DOOR: Verdict.RIGHT},
        Truth.GLASS: dict.fromkeys(Label, Verdict.RIGHT),
        Truth.OUTSIDE: {Label.CLUTTER: Verdict.RIGHT, Label.WALL: Verdict.FALSE_WALL},
        Truth.PERSON: {Label.OUTSIDE: Verdict.RIGHT, Label.WALL: Verdict.FALSE_WALL},
    }
    for truth, expected in wrong_by_truth.items():
        for label, verdict in expected.items():
            assert verdicts(np.array([truth], np.uint8), np.array([label], np.uint8))[0] == verdict, (truth, label)
    own = np.arange(len(Label), dtype=np.uint8)
    assert not verdicts(own, own).any()
    # A return without a label is missed; one whose truth is unknown counts nowhere.
    assert verdicts(np.array([3, 255], np.uint8), np.array([255, 3], np.uint8)).tolist() == [Verdict.MISSED_WALL, 0]
