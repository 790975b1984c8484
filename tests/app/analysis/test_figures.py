"""Figures by name: their values, their description, and the names that users give."""

import json
from pathlib import Path

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label, Truth
from ffmap.app.analysis.figures import (
    FIGURES,
    Figure,
    comparable,
    find_name,
    label_figures,
    read_figures,
)
from ffmap.app.folder.record import RunRecord
from ffmap.loaders.errors import InputError


def test_precision_recall_and_f1_follow_from_the_papers_areas() -> None:
    confusion = np.zeros((11, 7), np.int64)
    # Table II: wall 703.24 m² right, 2.80 wrong, 34.99 missed, in hundredths of a square metre.
    confusion[Truth.WALL, [Label.WALL, Label.CLUTTER]] = 70324, 3499
    confusion[Truth.CLUTTER, Label.WALL] = 280
    metrics = label_figures("", confusion, 0.01)
    assert metrics["wall.precision"] == pytest.approx(FIGURES["wall.precision"].paper, abs=5e-5)
    assert metrics["wall.recall"] == pytest.approx(FIGURES["wall.recall"].paper, abs=5e-5)
    assert metrics["wall.f1"] == pytest.approx(FIGURES["wall.f1"].paper, abs=2e-4)
    assert metrics["wall.right_m2"] == 703.24
    assert np.isnan([metrics[f"floor.{name}"] for name in ("precision", "recall", "f1")]).all()


def test_numbers_of_run_json_and_metrics_json_have_one_name(tmp_path: Path) -> None:
    times = {"total": 12.5, "labelling_per_scan": 0.01, "odometry": 2.0}
    record = RunRecord(timings_s=times, counts={"doors": 4, "returns": {"wall": 7}})
    details = {"truth": "a.bag", "doors.by_design": {}, "floor.f1": None}
    (tmp_path / "metrics.json").write_text(json.dumps({"wall.f1": 0.97, **details}))
    assert read_figures(tmp_path, record) == {
        "seconds": 12.5,
        "labelling_s_per_scan": 0.01,
        "seconds.odometry": 2.0,
        "doors": 4.0,
        "returns.wall": 7.0,
        "wall.f1": 0.97,
    }
    metrics = {"wall.f1": 0.97, "wall.right_m2": 3.0, "floor.f1": None}
    assert comparable(metrics) == {"wall.f1": 0.97}


def test_errors_and_times_are_better_when_lower() -> None:
    for name in ("seconds", "doors.invented", "trajectory.ate_rmse_m", "outside_kept"):
        assert FIGURES[name].better == "lower"
    for name in ("wall.f1", "doors.recall", "maps.middle.recall", "rooms.normal.precision"):
        assert FIGURES[name].better == "higher"


@pytest.mark.parametrize(
    ("unit", "first", "second", "expected"),
    [
        ("", 3.0, 5.0, "+2"),
        ("%", 0.1 + 0.2, 0.3, "="),
        ("%", 0.5, 0.4, "-10.00"),
        ("%", 0.5, 0.50004, "+4e-03"),
        ("cm", None, 1.0, "–"),
    ],
)
def test_differences(unit: str, first: float | None, second: float, expected: str) -> None:
    assert Figure("", unit).difference(first, second) == expected


@pytest.mark.parametrize(
    ("name", "first", "second", "expected"),
    [
        ("wall.f1", 0.970, 0.975, 0.005),
        ("wall.f1", 0.970, 0.971, 0.0),
        ("trajectory.ate_rmse_m", 0.030, 0.028, 0.002),
        ("doors.invented_count", 1.0, 2.0, -1.0),
        ("doors.found_count", 1.0, 1.0, 0.0),
        ("seconds", 10.0, 20.0, None),
        ("walls", 10.0, 20.0, None),
        ("wall.f1", None, 0.9, None),
    ],
)
def test_a_difference_within_the_tolerance_is_no_gain(
    name: str, first: float | None, second: float, expected: float | None
) -> None:
    assert FIGURES[name].gain(first, second) == pytest.approx(expected)


def test_names_are_found_with_underscores_and_mistakes_corrected() -> None:
    assert find_name("wall_f1", FIGURES, "--sort", "") == "wall.f1"
    assert find_name("maps.middle.recall", FIGURES, "--sort", "") == "maps.middle.recall"
    with pytest.raises(InputError, match=r"--sort: .*'wal\.f1'; did you mean 'wall\.f1'\? see x"):
        find_name("wal.f1", FIGURES, "--sort", "see x")
