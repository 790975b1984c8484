"""ffmap sweep: runs with many settings, each in a folder of its own; then a table of their figures."""

import csv
import hashlib
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import typer

from ffmap.app.compiled_code import compiled_code
from ffmap.app.folder import figures
from ffmap.app.folder.atomic import written_whole
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.names import METRICS, SWEEP_TABLE, RunFolder, require_writable
from ffmap.app.own_command import own_command
from ffmap.app.progress import Progress
from ffmap.app.run.workers import ENVIRONMENT
from ffmap.app.setup.inputs import Inputs, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Output
from ffmap.app.setup.settings import Settings
from ffmap.app.setup.versions import versions
from ffmap.app.sweeps.plan import (
    Combination,
    Parameter,
    Study,
    apply,
    grid_of,
    overrides_of,
    parse_grid,
    random_of,
)
from ffmap.app.tables import make_table, table_console
from ffmap.loaders.errors import InputError
from ffmap.loaders.fingerprint import fingerprint
from ffmap.loaders.text_files import read_object
from ffmap.loaders.truth import carries_truth

_WHOLE_SWEEP_S = 30 * 86_400.0
"""Time over which the speed of a sweep is averaged: all of it."""


@dataclass(eq=False)
class SweepRun:
    """One run of a sweep: what it is to do, and its figures or its error when it has ended."""

    out: Path
    bag: Path
    command: list[str]
    combination: Combination
    evaluated: bool
    """Whether it has figures when it is finished."""
    reused: bool = False
    error: str | None = None
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def finished(self) -> bool:
        """Whether the folder holds the complete run; its name stands for bag, settings and options."""
        try:
            complete = RunFolder(self.out).read_json().get("outcome") == "complete"
        except InputError:
            return False
        return complete and (not self.evaluated or (self.out / METRICS).exists())


@dataclass(frozen=True)
class Search:
    """Which combinations are tried: all of the grid, or a number that is drawn or proposed.

    objective: the figure by which runs are ranked.
    """

    grid: Sequence[str] = ()
    random: int | None = None
    optuna: int | None = None
    objective: str = "wall_f1"
    seed: int = 0


def sweep(
    paths: Sequence[Path],
    base: Settings,
    options: RunOptions,
    search: Search,
    out: Path | None = None,
) -> int:
    """Perform all runs that are not finished, print and write a table; returns how many failed.

    Args:
        paths: bags, each a drive.
        base: the settings that stay.
        options: of each run, but for workers: that many runs at once.
        out: folder of the sweep.

    Raises InputError before anything starts if a setting, a bag, the folder or the scheduler is
    wrong.
    """
    if search.random is not None and search.optuna is not None:
        raise InputError("--random and --optuna: choose one of them")
    searched = search.random is not None or search.optuna is not None
    parameters = parse_grid(search.grid, base, ranges=searched)
    bags = _bags(paths, options)
    truth = options.evaluate and all(carries_truth(inputs.bag_path) for inputs in bags)
    if truth and Output.LABELS not in options.outputs:
        raise InputError("--outputs: without labels no run can be evaluated; add labels")
    objective = search.objective
    figures.check_objective(objective, truth or search.optuna is None)
    out = (out or Path("runs") / f"sweep-{bags[0].bag_path.stem}").resolve()
    require_writable(out, "give another folder to --out")
    study = Study(parameters, search.seed, objective) if search.optuna is not None else None

    def runs_of(combination: Combination) -> list[SweepRun]:
        settings = apply(base, combination)
        return [_run_of(bag, settings, combination, options, out, truth) for bag in bags]

    runs: dict[Path, SweepRun] = {}
    try:
        with (
            _workers(options, out, bags) as (executor, slots),
            Progress(options.quiet, estimate_s=_WHOLE_SWEEP_S) as progress,
        ):
            for warning in dict.fromkeys(warning for inputs in bags for warning in inputs.warnings):
                progress.warn(warning)
            perform = _Performer(executor, progress, runs, objective)
            if study is None:
                listed = grid_of(parameters) if search.random is None else None
                drawn = listed or random_of(parameters, search.random or 0, search.seed)
                perform([run for combination in drawn for run in runs_of(combination)])
            else:
                assert search.optuna is not None
                for batch in study.batches(search.optuna, slots):
                    proposed = [(trial, runs_of(combination)) for trial, combination in batch]
                    perform([run for _, own in proposed for run in own])
                    for trial, own in proposed:
                        study.tell(trial, mean_of([runs[run.out] for run in own], objective))
    except KeyboardInterrupt:
        typer.echo("ffmap: interrupted; the same command goes on with the sweep", err=True)
        raise SystemExit(130) from None
    _write_table(out / SWEEP_TABLE, list(runs.values()), parameters)
    if not options.quiet:
        _report(out, list(runs.values()), parameters, objective)
    return sum(run.error is not None for run in runs.values())


def _bags(paths: Sequence[Path], options: RunOptions) -> list[Inputs]:
    different = dict.fromkeys(path.resolve() for path in paths)
    bags = [find_inputs(path, options) for path in different]
    for inputs in bags:
        if inputs.vertical is None:
            raise InputError(
                f"{inputs.bag_path}: no lidar sweeps the walls; there is nothing to label"
            )
        if inputs.horizontal is None and options.trajectory is None:
            raise InputError(
                f"{inputs.bag_path}: no horizontal lidar; give --horizontal or --trajectory"
            )
    return bags


def _run_of(
    inputs: Inputs,
    settings: Settings,
    combination: Combination,
    options: RunOptions,
    out: Path,
    evaluated: bool,
) -> SweepRun:
    """The run of one bag with one combination; a hash of all it depends on names its folder."""
    bag = inputs.bag_path.resolve()
    kept = options.stored()
    digests = kept.pop("digests")
    words = ["--overwrite", "--quiet", *([] if kept.pop("evaluate") else ["--no-evaluate"])]
    kept |= {"outputs": ",".join(kept["outputs"]), "set": overrides_of(settings), "workers": 1}
    for name, value in kept.items():
        values = value if isinstance(value, list) else [] if value is None else [value]
        words += [f"--{name.replace('_', '-')}={own}" for own in values]
    known_by = [words, digests, _fingerprint(bag), str(bag), versions()]
    digest = hashlib.sha256(json.dumps(known_by, sort_keys=True).encode()).hexdigest()[:8]
    folder = out / f"{inputs.bag_path.stem}-{digest}"
    command = ["run", *map(str, bag.parts), "--out", str(folder), *words]
    return SweepRun(folder, bag.parts[0], command, combination, evaluated)


_fingerprint = cache(fingerprint)


class _Performer:
    """Performs runs that are not finished, and reports each as it ends."""

    def __init__(
        self, executor: Executor, progress: Progress, runs: dict[Path, SweepRun], objective: str
    ) -> None:
        self._executor, self._progress, self._objective = executor, progress, objective
        self._runs = runs
        self._bags: set[Path] = set()

    def __call__(self, proposed: Sequence[SweepRun]) -> None:
        new = [run for run in dict.fromkeys(proposed) if self._runs.setdefault(run.out, run) is run]
        self._progress.stage("sweep", len(new))
        waiting = []
        for run in new:
            if run.finished:
                run.reused = True
                self._end(run, None)
            else:
                waiting.append(run)
        # One run of each bag goes ahead and leaves the odometry in the cache for the others.
        ahead = {run.bag: run for run in reversed(waiting) if run.bag not in self._bags}
        self._bags |= ahead.keys()
        first = list(ahead.values())
        self._perform(first)
        self._perform([run for run in waiting if run not in first])

    def _perform(self, runs: Sequence[SweepRun]) -> None:
        futures = {self._executor.submit(run_command, run.command): run for run in runs}
        for future in as_completed(futures):
            lost = future.exception()
            error = future.result() if lost is None else f"lost by the cluster: {lost}"
            self._end(futures[future], error)

    def _end(self, run: SweepRun, error: str | None) -> None:
        run.error = error
        if error is None:
            metrics = run.out / METRICS
            known = read_object(metrics, "run the sweep again") if metrics.exists() else None
            run.figures = figures.figures_of(open_run(run.out).record, known)
        self._progress.advance()
        value = run.figures.get(self._objective)
        came = f"failed: {error}" if error else f"{self._objective} {figures.format_value(value)}"
        values = ", ".join(f"{name} {value}" for name, value in run.combination.items())
        was_there = " (was finished)" if run.reused else ""
        self._progress.say(f"{run.out.name}: {values}: {came}{was_there}")


_children: set[subprocess.Popen[bytes]] = set()


def run_command(words: Sequence[str]) -> str | None:
    """Run ffmap in a process of its own; returns the last line of its errors, None if it succeeds."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from ffmap.app.cli import main; main()", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**ENVIRONMENT, **os.environ, **compiled_code()},
    )
    _children.add(process)
    try:
        said = process.communicate()[1].decode(errors="replace").strip().splitlines()
    finally:
        _children.discard(process)
    if process.returncode == 0:
        return None
    return said[-1] if said else f"ended with exit code {process.returncode}"


def stop_all() -> None:
    """End the processes that `run_command` has started here."""
    for process in list(_children):
        process.terminate()


@contextmanager
def _workers(
    options: RunOptions, out: Path, bags: Sequence[Inputs]
) -> Iterator[tuple[Executor, int]]:
    """Who performs the runs, and how many at once."""
    if options.scheduler is not None:
        from ffmap.app.run.cluster import connect

        needed = [out, *(part for inputs in bags for part in inputs.bag_path.parts)]
        with connect(options.scheduler, needed, stop_all) as cluster:
            yield cluster.executor, max(cluster.slots, 1)
        return
    executor = ThreadPoolExecutor(options.workers)  # each thread waits for a process
    try:
        yield executor, options.workers
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        stop_all()


def mean_of(runs: Sequence[SweepRun], name: str) -> float | None:
    """The mean of a figure over the bags; None if a run lacks it."""
    values = [run.figures.get(name) for run in runs]
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known and len(known) == len(values) else None


def _write_table(path: Path, runs: Sequence[SweepRun], parameters: Sequence[Parameter]) -> None:
    """One row for each run: its folder, bag, settings, error and every figure."""
    names = list(dict.fromkeys(name for run in runs for name in run.figures))
    with written_whole(path) as part, part.open("w", newline="") as file:
        writer = csv.writer(file)
        settings = [parameter.name for parameter in parameters]
        writer.writerow(["run", "bag", "error", *settings, *names])
        for run in runs:
            values = [run.combination[name] for name in settings]
            own = [run.figures.get(name, "") for name in names]
            writer.writerow([run.out.name, run.bag, run.error or "", *values, *own])


def _report(
    out: Path, runs: Sequence[SweepRun], parameters: Sequence[Parameter], objective: str
) -> None:
    by_combination: dict[tuple[Any, ...], list[SweepRun]] = {}
    for run in runs:
        by_combination.setdefault(tuple(map(str, run.combination.values())), []).append(run)
    sign = 1.0 if figures.less_is_better(objective) else -1.0

    def rank(own: Sequence[SweepRun]) -> tuple[bool, float]:
        value = mean_of(own, objective)
        return value is None, sign * (value or 0.0)

    ranked = sorted(by_combination.values(), key=rank)
    names = figures.short_names(parameter.name for parameter in parameters)
    usual = dict.fromkeys([objective, *figures.HEADLINES])
    there = [name for name in usual if any(name in run.figures for run in runs)]
    console = table_console()
    room = console.width - sum(len(name) + 3 for name in names.values()) - 40
    shown = figures.fit({name: len(name) for name in there}, room, least=3)
    rows = (
        [
            *(figures.format_value(own[0].combination[name]) for name in names),
            *(figures.format_value(mean_of(own, name)) for name in shown),
            own[0].out.name + (f" +{len(own) - 1}" if len(own) > 1 else ""),
        ]
        for own in ranked
    )
    title = f"{len(ranked)} settings, best by {objective} first"
    headings = (*names.values(), *shown, "run")
    console.print(make_table(title, headings, rows, left=(len(headings) - 1,)))
    failed = [run for run in runs if run.error is not None]
    for run in failed:
        typer.echo(f"failed: {run.out.name}: {run.error}")
    reused = sum(run.reused for run in runs)
    typer.echo(f"{len(runs) - len(failed)} of {len(runs)} runs, {reused} of them were finished")
    typer.echo(f"table:     {out / SWEEP_TABLE}")
    best = [own[0].out for own in ranked[:2] if own[0].error is None]
    if len(best) == 2:
        typer.echo(f"compare:   {own_command()} compare {best[1]} {best[0]}")
