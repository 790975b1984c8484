"""Each odometry once and first, never too much at once, and whatever fails fails alone."""

import json
import threading
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ffmap.app.run.start import Arguments
from ffmap.app.setup.inputs import InputOptions
from ffmap.app.sweeps import schedule as sweep_schedule
from ffmap.app.sweeps.one_run import Job, Outcome, is_finished
from ffmap.app.sweeps.plan import Choice, Listed
from ffmap.app.sweeps.results import Results
from ffmap.app.sweeps.schedule import Run, Schedule
from ffmap.loaders.bag_path import BagPath

BAGS = ("a", "b")


class Machine:
    """Stands in for the processes: writes a run's files, remembers what was done when."""

    def __init__(self, failing: Mapping[str, str] | None = None) -> None:
        self.done: list[str] = []
        self.at_once = self.most_at_once = 0
        self._failing = failing or {}
        self._lock = threading.Lock()

    def perform(self, job: Job) -> Outcome:
        name = job.odometry or job.name
        with self._lock:
            self.at_once += 1
            self.most_at_once = max(self.most_at_once, self.at_once)
            if job.odometry is None:
                assert (job.cache / "odometry" / f"poses-{job.arguments.bag}" / "complete").exists()
        time.sleep(0.01)
        with self._lock:
            self.at_once -= 1
            self.done.append(name)
        if name in self._failing:
            return Outcome(seconds=0.01, error=self._failing[name])
        if job.odometry is not None:
            folder = job.cache / "odometry" / job.odometry
            folder.mkdir(parents=True)
            (folder / "complete").touch()
        else:
            write_run(job)
        return Outcome(seconds=0.01)


def write_run(job: Job) -> None:
    from ffmap.app.run.start import stored

    job.out.mkdir(parents=True)
    record = {
        "outcome": "complete",
        "settings_hash": job.settings_hash,
        "bag": {"digest": job.bag_digest},
        "options": stored(job.arguments),
        "timings_s": {"total": 3.0},
        "counts": {"doors": 4 if job.arguments.bag.name == "a" else 6},
    }
    (job.out / "run.json").write_text(json.dumps(record))


def run_of(folder: Path, bag: str, value: int, given: bool = False) -> Run:
    job = Job(
        arguments=Arguments(
            bag=BagPath((Path(bag),)), out=folder / f"{bag}-{value}", overrides=(f"seed={value}",), evaluate=False
        ),
        bag_digest=f"digest of {bag}",
        settings_hash=str(value),
        cache=folder,
    )
    return Run(job, {"seed": value}, None if given else f"poses-{bag}")


def swept(
    folder: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch, values: list[int], slots: int = 3
) -> tuple[Schedule, list[tuple[Any, float | None]]]:
    told: list[tuple[Any, float | None]] = []

    class Search(Listed):
        def tell(self, combination: Any, value: float | None) -> None:
            told.append((combination["seed"], value))

    monkeypatch.setattr(sweep_schedule, "perform", machine.perform)
    schedule = Schedule(
        Search([{"seed": value} for value in values]),
        lambda combination: [run_of(folder, bag, combination["seed"]) for bag in BAGS],
        "doors",
        lambda run: None,
    )
    with ThreadPoolExecutor(8) as executor:
        schedule.perform(executor, lambda: slots)
    return schedule, told


def test_every_odometry_is_computed_once_and_before_its_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine()
    schedule, told = swept(tmp_path, machine, monkeypatch, list(range(6)))
    assert sorted(machine.done) == sorted(
        ["poses-a", "poses-b", *(f"{bag}-{value}" for bag in BAGS for value in range(6))]
    )
    assert 1 < machine.most_at_once <= 3
    assert list(schedule.odometries) == ["poses-a", "poses-b"]
    # The objective of a combination is its mean over the bags.
    assert sorted(told) == [(value, 5.0) for value in range(6)]


def test_what_is_there_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    swept(tmp_path, Machine(), monkeypatch, [0, 1])
    machine = Machine()
    schedule, _ = swept(tmp_path, machine, monkeypatch, [0, 1, 2])
    assert sorted(machine.done) == ["a-2", "b-2"]
    assert not schedule.odometries
    assert [run.reused for run in schedule.runs.values()] == [True] * 4 + [False] * 2
    assert all(run.figures["seconds"] == 3.0 for run in schedule.runs.values())


@pytest.mark.parametrize(
    "change",
    [
        {"outcome": "running"},
        {"settings_hash": "other"},
        {"bag": {"digest": "other"}},
        {"options": {"detail": "map"}},
    ],
)
def test_only_the_very_run_counts_as_finished(change: dict[str, Any], tmp_path: Path) -> None:
    job = run_of(tmp_path, "a", 1).job
    write_run(job)
    assert is_finished(job)
    evaluated = replace(job.arguments, evaluate=True)
    assert not is_finished(job.model_copy(update={"arguments": evaluated}))
    record = json.loads((job.out / "run.json").read_text())
    (job.out / "run.json").write_text(json.dumps({**record, **change}))
    assert not is_finished(job)


@pytest.mark.parametrize("name", ["rig", "trajectory"])
def test_run_that_was_made_with_another_file_is_not_finished(name: str, tmp_path: Path) -> None:
    file = tmp_path / "file.txt"
    file.write_text("earlier")
    job = run_of(tmp_path, "a", 1).job
    changed = {"bag_options": InputOptions(rig=file)} if name == "rig" else {"trajectory": str(file)}
    job = job.model_copy(update={"arguments": replace(job.arguments, **changed)})
    write_run(job)
    assert is_finished(job)
    file.write_text("changed")
    assert not is_finished(job)


def test_one_failed_run_does_not_stop_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine({"a-1": "no memory"})
    schedule, told = swept(tmp_path, machine, monkeypatch, [0, 1, 2])
    assert {name: run.outcome.error for name, run in schedule.runs.items() if run.outcome.error} == {"a-1": "no memory"}
    assert sorted(told, key=str) == [(0, 5.0), (1, None), (2, 5.0)]
    # The failed one is tried again, and only that.
    again = Machine()
    schedule, _ = swept(tmp_path, again, monkeypatch, [0, 1, 2])
    assert again.done == ["a-1"]
    assert not any(run.error for run in schedule.runs.values())


def test_without_its_odometry_no_run_is_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine({"poses-a": "no horizontal cloud"})
    schedule, _ = swept(tmp_path, machine, monkeypatch, list(range(5)), slots=1)
    assert sorted(machine.done) == ["b-0", "b-1", "b-2", "b-3", "b-4", "poses-a", "poses-b"]
    failed = [run for run in schedule.runs.values() if run.error]
    assert [run.job.name for run in failed] == [f"a-{value}" for value in range(5)]
    assert "no horizontal cloud" in failed[0].outcome.error


def test_of_runs_that_are_as_good_the_fastest_comes_first(tmp_path: Path) -> None:
    runs = []
    for value, (f1, seconds) in enumerate([(0.9, 5.0), (0.95, 7.0), (0.95, 6.0), (None, 1.0)]):
        runs.append(run_of(tmp_path, "a", value))
        runs[-1].figures = {"seconds": seconds, **({} if f1 is None else {"wall_f1": f1})}
    results = Results(runs, [Choice("seed", (0, 1, 2, 3))], "wall_f1")
    assert results.ranked == [2, 1, 0, 3]
    assert results.front == (0, 2)


def test_a_combination_that_is_proposed_twice_is_run_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine()
    _, told = swept(tmp_path, machine, monkeypatch, [3, 3, 4, 3])
    assert sorted(machine.done) == ["a-3", "a-4", "b-3", "b-4", "poses-a", "poses-b"]
    assert sorted(told) == [(3, 5.0), (3, 5.0), (3, 5.0), (4, 5.0)]


def test_what_a_cluster_loses_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Losing(Machine):
        def perform(self, job: Job) -> Outcome:
            if job.name == "b-1" and job.odometry is None:
                raise OSError("the worker is gone")
            return super().perform(job)

    schedule, _ = swept(tmp_path, Losing(), monkeypatch, [0, 1])
    assert "the worker is gone" in schedule.runs["b-1"].outcome.error
    assert sum(run.error is not None for run in schedule.runs.values()) == 1
