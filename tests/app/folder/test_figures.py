"""Names of figures."""

import pytest

from ffmap.app.folder import figures
from ffmap.app.folder.figures import figures_of, less_is_better, short_names
from ffmap.loaders.errors import InputError


def test_figures_have_short_names() -> None:
    record = {"timings_s": {"total": 12.5, "labelling_per_scan": 0.01}, "counts": {"doors": 4, "returns": {"wall": 7}}}
    metrics = {"area": {"wall": {"f1": 0.97, "precision": None}}, "doors": {"found": 1.0}, "truth": "a.bag"}
    found = figures_of(record, metrics)
    assert found == {
        "seconds": 12.5,
        "labelling_s_per_scan": 0.01,
        "doors": 4.0,
        "returns_wall": 7.0,
        "wall_f1": 0.97,
        "doors_found": 1.0,
    }


def test_errors_and_times_are_better_when_less() -> None:
    for name in ("seconds", "doors_invented", "trajectory_ate_rmse_m", "wall_map_error_m", "outside_kept_as_structure"):
        assert less_is_better(name), name
    for name in ("wall_f1", "doors_found", "wall_map_recall", "doors_state_right", "doors"):
        assert not less_is_better(name), name


def test_objectives_are_checked() -> None:
    figures.check_objective("door_f1", with_truth=True)
    figures.check_objective("seconds", with_truth=False)
    with pytest.raises(InputError, match="'wall_f1'"):
        figures.check_objective("wal_f1", with_truth=True)
    with pytest.raises(InputError, match="truth"):
        figures.check_objective("wall_f1", with_truth=False)


def test_headings_are_as_short_as_they_can_be() -> None:
    names = ["building.gap_m", "wall_planes.gap_m", "doors.lines_min", "seed"]
    assert list(short_names(names).values()) == ["building.gap_m", "wall_planes.gap_m", "lines_min", "seed"]


def test_runs_are_asked_for_by_figures_not_by_what_these_are_made_from() -> None:
    wall = {"f1": 0.97, "right_m2": 70.0}
    metrics = {"area": {"wall": wall, "confusion": {"truth": []}}, "maps": {"middle": {"recall": 0.9}}}
    assert figures.queried({**metrics, "rooms": {"recall": 1.0, "by_room": {"lab 1": 1.0}}}) == {
        "area": {"wall": {"f1": 0.97}},
        "rooms": {"recall": 1.0},
    }
