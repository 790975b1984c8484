"""Sentences of a comparison: which run is better, and which settings changed nothing."""

from pathlib import Path
from typing import Any

import numpy as np

from ffmap.algorithms.base.votes import VoxelTable
from ffmap.algorithms.truth.changes import LabelChange, Spot
from ffmap.app.analysis.comparison import Change, Comparison, RunToCompare
from ffmap.app.analysis.verdict import best_runs, describe
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.record import RunRecord

RECORD = {"bag": {"digest": "x"}, "rig": {"vertical": {"topic": "/side"}}}
SPOT = Spot(3.0, -2.04, 0.64, 120, 180)
NOTHING = VoxelTable(0.1, 2).votes()


def compare(
    *figures: dict[str, float], changed: int = 500, right: int = 400, **settings: Any
) -> Comparison:
    """Runs with these figures, each of which changed labels of the first one."""
    record = RunRecord.model_validate(RECORD)
    runs = [
        RunToCompare(letter, FinishedRun(Path("runs") / letter.lower(), record), None)
        for letter in "ABCDE"[: len(figures)]
    ]
    none = np.zeros(0, np.int64)
    labels = LabelChange(none, none, none, none, NOTHING, none, NOTHING, (SPOT, SPOT, SPOT))
    counts = {
        "labels.changed": changed,
        "labels.changed_share": changed / 100_000,
        "labels.changed_scan": 700,
        "labels.became_right": right,
        "labels.became_wrong": changed - right,
    }
    changes = [Change(a=runs[0], b=run, labels=labels, figures=counts) for run in runs[1:]]
    names = dict.fromkeys(name for own in figures for name in own)
    table = {name: [own.get(name) for own in figures] for name in names}
    return Comparison(tuple(runs), tuple(changes), settings, table, ())


def test_the_most_important_figure_that_differs_decides() -> None:
    a = {"wall.f1": 0.9, "doors.found_count": 3, "floor.f1": 0.9, "seconds": 9.0}
    b = {"wall.f1": 0.9042, "doors.found_count": 4, "floor.f1": 0.899, "seconds": 99.0}
    assert describe(compare(a, b)) == [
        "B (runs/b) is better than A (runs/a): wall F1 +0.42, doors found +1. "
        "500 final labels (0.50 %) changed: 400 became right, 100 wrong. "
        "64 % of the labels that became right lie within 1.5 m of (3.0, -2.0), "
        "in scans 120 to 180."
    ]
    (worse,) = describe(compare(b | {"floor.f1": 0.8}, a))
    assert worse.startswith(
        "B (runs/b) is worse than A (runs/a): wall F1 -0.42, doors found -1; better: floor F1 +"
    )
    assert "the labels that became wrong lie" in worse


def test_runs_within_the_tolerance_are_equally_good() -> None:
    first, alike, better = ({"wall.f1": f1, "door.f1": 0.5} for f1 in (0.9, 0.9005, 0.92))
    comparison = compare(first, alike, better, better | {"door.f1": 0.7})
    assert [run.letter for run in best_runs(comparison)] == ["D"]
    assert describe(comparison)[0] == "Best: D (runs/d)."
    comparison = compare(first, alike)
    assert [run.letter for run in best_runs(comparison)] == ["A", "B"]
    assert describe(comparison)[0].startswith("B (runs/b) is as good as A (runs/a): no figure")
    assert "'ffmap evaluate RUN' computes them." in describe(compare({}, {}))[0]


def test_settings_without_effect_are_named_with_those_that_decide() -> None:
    same = {"wall.f1": 0.9}
    settings = {"doors.recess_min_m": [0.022, 0.07], "bag": ["a", "b"]}
    (nothing,) = describe(compare(same, same, changed=0, right=0, **settings))
    assert nothing == (
        "B (runs/b) is as good as A (runs/a): doors.recess_min_m (0.022 → 0.07) changed no final "
        "label. doors.recess_min_m acts on scan labels (700 labels of single scans changed); "
        "building.recess_min_m decides on final labels."
    )
    (some,) = describe(compare(same, same, **settings))
    assert "changed no final label" not in some
    assert some.endswith("building.recess_min_m decides on final labels.")
    (better,) = describe(compare(same, {"wall.f1": 0.95}, **settings))
    assert "decides" not in better
    (final,) = describe(compare(same, same, changed=0, **{"relabelling.passed_share": [0.02, 0.05]}))
    assert final.endswith("relabelling.passed_share (0.02 → 0.05) changed no final label.")
