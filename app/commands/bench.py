"""ffmap bench: what a run takes on this machine, stage by stage beside its floor, or beside another version's."""

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import numpy as np
import typer
from rich.table import Table

from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.analysis.bench_floors import (
    LabellingTimes,
    Line,
    cloud_bytes,
    time_labelling,
    time_odometry_floor_s,
    time_reading,
    time_writing_s,
)
from ffmap.app.analysis.bench_report import (
    Budget,
    Comparison,
    Repeated,
    budget_json,
    budget_lines,
    budget_tables,
    comparison_json,
    comparison_lines,
    comparison_tables,
)
from ffmap.app.analysis.bench_runs import STAGES, MeasuredRun, Program, measure_run, medians, revision, this_program
from ffmap.app.commands.simulate import simulate
from ffmap.app.folder.atomic import json_text, write_json
from ffmap.app.parameters import one_for_each_core
from ffmap.app.run.odometry_cache import CACHE_VARIABLE
from ffmap.app.run.poses import poses_of
from ffmap.app.setup.inputs import InputOptions, Inputs, Sensor, find_inputs
from ffmap.app.setup.settings import Settings
from ffmap.app.setup.versions import versions
from ffmap.app.tables import table_console
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.repeated_bag import plan_repetition, write_repeated_bag
from ffmap.loaders.trajectory_file import write_tum

_T = TypeVar("_T")


def bench(
    bag: BagPath | None,
    duration_s: float,
    runs: int = 1,
    repeat: int = 1,
    against: str | None = None,
    json: Path | None = None,
) -> None:
    """Measure, then print tables, and JSON where it is wanted; raises InputError for what the user can mend.

    bag: None for one that is simulated. json: a file, or - for standard output in place of tables.
    """
    _check_words(repeat, against, json)
    with tempfile.TemporaryDirectory(prefix="ffmap-bench-") as name:
        folder = Path(name)
        other = None if against is None else revision(against, folder / "other")
        if bag is None:
            simulated = folder / "office.bag"
            bag = BagPath((simulated,))
            _say(f"simulating {duration_s:.0f} s in building 'office' ...")
            simulate(simulated, {"building": "office", "seed": 1, "duration_s": duration_s})
        drive = _Drive.of(bag, folder)
        if other is None:
            budget = _measure_budget(drive, runs, repeat)
            _tell(budget_tables(budget), budget_lines(budget), budget_json(budget), json)
        else:
            comparison = _compare(drive, runs, other)
            _tell(comparison_tables(comparison), comparison_lines(comparison), comparison_json(comparison), json)


@dataclass(frozen=True)
class _Drive:
    """What is measured with, and where: the bag and two of its lidars, a folder for all that is written, the workers of a run."""

    inputs: Inputs
    horizontal: Sensor
    vertical: Sensor
    driving_s: float
    folder: Path
    workers: int

    @classmethod
    def of(cls, bag: BagPath, folder: Path) -> "_Drive":
        inputs = find_inputs(bag, InputOptions())
        if inputs.vertical is None or inputs.horizontal is None:
            raise InputError(f"{bag}: has no vertical lidar to label; give a bag of two lidars")
        return cls(inputs, inputs.horizontal, inputs.vertical, _duration_s(bag), folder, one_for_each_core(None))

    def run(
        self, program: Program, cache: Path, bag: BagPath | None = None, trajectory: Path | None = None
    ) -> MeasuredRun:
        """One run of the drive, or of another bag with its poses; nothing of it stays but the odometry in `cache`."""
        with tempfile.TemporaryDirectory(prefix="run-", dir=self.folder) as folder:
            return measure_run(program, bag or self.inputs.bag_path, Path(folder), self.workers, cache, trajectory)


def _check_words(repeat: int, against: str | None, json: Path | None) -> None:
    """Before anything is measured. Raises InputError."""
    if against is not None and repeat > 1:
        raise InputError("--repeat: measures one version; leave --against out, or --repeat")
    if json is not None and not _is_stdout(json):
        if json.is_dir():
            raise InputError(f"--json {json}: is a folder; name a file in it")
        if not json.parent.is_dir():
            raise InputError(f"--json {json}: there is no folder {json.parent}; make it, or name another file")


def _measure_budget(drive: _Drive, runs: int, repeat: int) -> Budget:
    done = _run_in_turn(drive, [this_program()], runs)[0]
    settings, run = Settings(), medians(done)
    with _odometries_kept_in(_cache(drive, this_program(), runs)):
        trajectory = poses_of(drive.inputs, None, settings).trajectory
    _say("floors ...")
    reading = _each(runs, lambda: time_reading(drive.vertical, drive.inputs.bag_path))
    labelling = _each(runs, lambda: time_labelling(drive.vertical, drive.inputs.bag_path, trajectory, settings))
    odometry_s = _each(runs, lambda: time_odometry_floor_s(drive.horizontal, drive.inputs.bag_path, settings))
    floors_s: dict[str, float | None] = {
        "odometry": median(odometry_s),
        "scans": median(_each(runs, lambda: time_writing_s(drive.folder, run.recording_bytes))),
        "final": median(_each(runs, lambda: time_writing_s(drive.folder, run.labelled_bytes))),
    }
    return Budget(
        runs=runs,
        workers=drive.workers,
        driving_s=drive.driving_s,
        clouds=sum(len(sensor.index) for sensor in drive.inputs.used(given_poses=False)),
        cloud_bytes=cloud_bytes(drive.inputs),
        reading=Line(median(one.floor or 0.0 for one in reading), median(one.takes for one in reading)),
        labelling=_joined(labelling),
        stages={name: Line(floors_s.get(name), run.timings_s[name]) for name in STAGES},
        run=run,
        repeated=_repeat(drive, trajectory, repeat, settings) if repeat > 1 else None,
    )


def _repeat(drive: _Drive, trajectory: Trajectory, times: int, settings: Settings) -> Repeated:
    """A run of the drive several times over. trajectory: T_map_base of the drive."""
    inputs = drive.inputs
    indices = [sensor.index for sensor in inputs.used(given_poses=False)]
    repetition = plan_repetition(indices, trajectory, times, settings.trajectory.extrapolate_s)
    bag, poses = (
        drive.folder / ("repeated.bag" if inputs.container == "ros1" else "repeated"),
        drive.folder / "poses.tum",
    )
    _say(f"the drive {times} times ...")
    with open_bag(inputs.bag_path) as opened:
        write_repeated_bag(bag, opened, inputs.rig, repetition)
    write_tum(poses, repetition.poses(trajectory))
    repeated = BagPath((bag,))
    run = drive.run(this_program(), drive.folder / "unused", repeated, poses)
    return Repeated(times, _duration_s(repeated), run)


def _compare(drive: _Drive, runs: int, other: Program) -> Comparison:
    this_runs, other_runs = _run_in_turn(drive, [this_program(), other], runs)
    return Comparison(runs, drive.workers, drive.driving_s, other.name, medians(this_runs), medians(other_runs))


def _run_in_turn(drive: _Drive, programs: Sequence[Program], runs: int) -> list[list[MeasuredRun]]:
    """The runs of each version, A, B, A, B; each version's first, in which its code is compiled, is not among them."""
    measured: list[list[MeasuredRun]] = [[] for _ in programs]
    for number in range(runs + 1):
        for program, done in zip(programs, measured, strict=True):
            _say(f"{program.name}: " + (f"run {number} of {runs} ..." if number else "run to compile its code ..."))
            run = drive.run(program, _cache(drive, program, number))
            if number:
                done.append(run)
    return measured


def _cache(drive: _Drive, program: Program, number: int) -> Path:
    """Where a run keeps its odometry: none finds that of another run."""
    return drive.folder / f"cache-{'other' if program.import_path else 'this'}-{number}"


@contextmanager
def _odometries_kept_in(folder: Path) -> Iterator[None]:
    """Meanwhile another cache than the user's, in this process."""
    before = {name: value for name, value in os.environ.items() if name == CACHE_VARIABLE}
    os.environ[CACHE_VARIABLE] = str(folder)
    try:
        yield
    finally:
        del os.environ[CACHE_VARIABLE]
        os.environ.update(before)


def _each(times: int, measure: Callable[[], _T]) -> list[_T]:
    return [measure() for _ in range(times)]


def _joined(times: Sequence[LabellingTimes]) -> LabellingTimes:
    """The same scans, measured several times."""
    floor_ms, takes_ms = (np.concatenate([getattr(one, name) for one in times]) for name in ("floor_ms", "takes_ms"))
    return LabellingTimes(floor_ms, takes_ms, times[0].points)


def _duration_s(bag: BagPath) -> float:
    with open_bag(bag) as opened:
        return opened.duration_s


def _say(text: str) -> None:
    """What it is at; standard output holds figures alone."""
    typer.echo(text, err=True)


def _tell(tables: Iterable[Table], lines: Iterable[str], content: dict[str, Any], json: Path | None) -> None:
    content = {"versions": versions(), **content}
    if json is not None and _is_stdout(json):
        typer.echo(json_text(content), nl=False)
        return
    console = table_console()
    for table in tables:
        console.print(table)
    for line in lines:
        typer.echo(line)
    if json is not None:
        write_json(json, content)


def _is_stdout(json: Path) -> bool:
    return str(json) == "-"
