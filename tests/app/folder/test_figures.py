"""Names of figures, and the front of those runs that no other beats."""

import math

import numpy as np
import pytest

from ffmap.app.folder import figures
from ffmap.app.folder.figures import figures_of, less_is_better, pareto_front, short_names
from ffmap.loaders.errors import InputError


@pytest.mark.parametrize("seed", range(20))
def test_the_front_is_what_nobody_beats(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cost, quality = rng.integers(0, 6, 12).astype(float), rng.integers(0, 6, 12).astype(float)
    quality[rng.random(12) < 0.2] = np.nan

    def beaten(i: int) -> bool:
        as_good = (cost <= cost[i]) & (quality >= quality[i])
        return bool((as_good & ((cost < cost[i]) | (quality > quality[i]))).any())

    front = pareto_front(cost.tolist(), quality.tolist())
    unbeaten = {(cost[i], quality[i]) for i in range(12) if np.isfinite(quality[i]) and not beaten(i)}
    assert {(cost[i], quality[i]) for i in front} == unbeaten
    assert len(front) == len(unbeaten)
    assert [cost[i] for i in front] == sorted(cost[i] for i in front)
    order = rng.permutation(12)
    again = pareto_front(cost[order].tolist(), quality[order].tolist())
    assert {(cost[order][i], quality[order][i]) for i in again} == unbeaten


def test_nothing_has_no_front() -> None:
    assert pareto_front([], []) == []
    assert pareto_front([1.0, math.nan], [math.nan, 2.0]) == []


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
