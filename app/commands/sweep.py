"""ffmap sweep: runs with many settings, each in a folder of its own; then a table of figures."""

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
from pathlib import Path
from typing import Any

import typer

from ffmap.app.analysis.figures import FIGURES, HEADLINES, WITHOUT_TRUTH, find_name, read_figures
from ffmap.app.commands.runs import runs as list_runs
from ffmap.app.compiled_code import compiled_code
from ffmap.app.folder.atomic import written_whole
from ffmap.app.folder.names import METRICS, SWEEP_TABLE, RunFolder, require_writable
from ffmap.app.own_command import own_command
from ffmap.app.progress import Progress
from ffmap.app.run.workers import ENVIRONMENT
from ffmap.app.setup.inputs import find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Output
from ffmap.app.setup.settings import Settings
from ffmap.app.setup.versions import versions
from ffmap.app.sweeps import plan
from ffmap.app.sweeps.plan import Combination
from ffmap.app.tables import format_value
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.fingerprint import fingerprint
from ffmap.loaders.truth import carries_truth


@dataclass(frozen=True)
class Search:
    """Combinations that are tried: all of the grid, or a number that is drawn or proposed.

    objective: the figure by which runs are ranked.
    """

    grid: Sequence[str] = ()
    random: int | None = None
    optuna: int | None = None
    objective: str = "wall.f1"
    seed: int = 0


@dataclass(eq=False)
class SweepRun:
    """A run of a sweep; figures or error are known once it has ended."""

    out: Path
    bag: Path
    command: list[str]
    combination: Combination
    reused: bool = False
    error: str | None = None
    figures: dict[str, float] = field(default_factory=dict)


def sweep(
    paths: Sequence[Path],
    base: Settings,
    options: RunOptions,
    search: Search,
    out: Path | None = None,
) -> int:
    """Perform all runs that are not finished, print and write a table; return how many failed.

    Args:
        paths: bags, each a drive.
        base: settings that are not searched.
        options: of each run, but for workers: the number of runs at once.
        out: folder of the sweep.

    Raises InputError before anything starts if a setting, a bag, the folder or the scheduler is
    wrong.
    """
    if search.random is not None and search.optuna is not None:
        raise InputError("--random and --optuna: choose one of them")
    searched = search.random is not None or search.optuna is not None
    parameters = plan.parse_grid(search.grid, ranges=searched)
    inputs = [find_inputs(path, options) for path in dict.fromkeys(p.resolve() for p in paths)]
    bags = [own.bag_path for own in inputs]
    truth = options.evaluate and all(map(carries_truth, bags))
    if truth and Output.LABELS not in options.outputs:
        raise InputError("--outputs: without labels no run can be evaluated; add labels")
    objective = _objective(search.objective, truth or search.optuna is None)
    out = (out or Path("runs") / f"sweep-{bags[0].stem}").resolve()
    require_writable(out, "give another folder to --out")
    study = None
    if search.optuna is not None:
        study = plan.Study(parameters, search.seed, objective)
    runs: dict[Path, SweepRun] = {}
    try:
        with (
            _workers(options, out, bags) as (executor, slots),
            Progress(options.quiet) as progress,
        ):
            for warning in dict.fromkeys(warning for own in inputs for warning in own.warnings):
                progress.warn(warning)
            fingerprints = {bag: fingerprint(bag) for bag in bags}
            if study is not None and search.optuna is not None:
                batches = study.batches(search.optuna, slots)
            elif search.random is not None:
                drawn = plan.random_of(parameters, search.random, search.seed)
                batches = iter([[(None, combination) for combination in drawn]])
            else:
                batches = iter([[(None, combination) for combination in plan.grid_of(parameters)]])
            for batch in batches:
                proposed = [
                    [_make_run(*bag, base, own, options, out) for bag in fingerprints.items()]
                    for _, own in batch
                ]
                new = {run.out: run for own in proposed for run in own if run.out not in runs}
                progress.stage("sweep", len(new))
                for run in _perform(list(new.values()), truth, executor):
                    runs[run.out] = run
                    progress.say(_summary(run, objective))
                    progress.advance()
                for (trial, _), own in zip(batch, proposed, strict=True):
                    if study is not None:
                        study.tell(trial, mean_of([runs[run.out] for run in own], objective))
    except KeyboardInterrupt:
        typer.echo("ffmap: interrupted; the same command continues the sweep", err=True)
        raise SystemExit(130) from None
    _write_table(out / SWEEP_TABLE, list(runs.values()))
    if not options.quiet:
        _report(out, list(runs.values()), objective)
    return sum(run.error is not None for run in runs.values())


def _objective(name: str, with_truth: bool) -> str:
    """Check the figure that runs are ranked by."""
    known = [name for name, figure in FIGURES.items() if figure.better != "neither"]
    listed = ", ".join(name for name in HEADLINES if name in known)
    objective = find_name(name, known, "--objective", f"choose among {listed}")
    if not with_truth and objective not in WITHOUT_TRUTH:
        raise InputError(
            f"--objective {name}: needs the ground truth, which a bag does not have; choose among "
            f"{', '.join(WITHOUT_TRUTH)}"
        )
    return objective


def _make_run(
    bag: BagPath,
    digest: str,
    base: Settings,
    combination: Combination,
    options: RunOptions,
    out: Path,
) -> SweepRun:
    """Make the run of a bag with a combination; a hash of all it depends on names its folder."""
    kept = options.stored()
    digests, evaluate = kept.pop("digests"), kept.pop("evaluate")
    overrides = plan.overrides_of(base, combination)
    kept |= {"outputs": ",".join(kept["outputs"]), "set": overrides, "workers": 1}
    words = ["--overwrite", "--quiet", *([] if evaluate else ["--no-evaluate"])]
    for name, value in kept.items():
        values = value if isinstance(value, list) else [] if value is None else [value]
        words += [f"--{name.replace('_', '-')}={own}" for own in values]
    bag = bag.resolve()
    known_by = json.dumps([words, digests, digest, versions()], sort_keys=True)
    folder = out / f"{bag.stem}-{hashlib.sha256(known_by.encode()).hexdigest()[:8]}"
    command = ["run", *map(str, bag.parts), "--out", str(folder), *words]
    return SweepRun(folder, bag.parts[0], command, combination)


def _perform(
    runs: Sequence[SweepRun], evaluated: bool, executor: Executor
) -> Iterator[SweepRun]:
    """Perform the runs that are not finished; yield each as it ends."""
    for run in runs:
        run.reused = _is_finished(run.out, evaluated)
    waiting = [run for run in runs if not run.reused]
    # The first run of each bag leaves the odometry in the cache for the others.
    first = list({run.bag: run for run in reversed(waiting)}.values())
    yield from (_with_figures(run) for run in runs if run.reused)
    for batch in (first, [run for run in waiting if run not in first]):
        futures = {executor.submit(run_command, run.command): run for run in batch}
        for future in as_completed(futures):
            run, lost = futures[future], future.exception()
            run.error = future.result() if lost is None else f"lost by the cluster: {lost}"
            yield run if run.error else _with_figures(run)


def _is_finished(folder: Path, evaluated: bool) -> bool:
    """Return whether a folder holds the complete run."""
    try:
        complete = RunFolder(folder).read_json().get("outcome") == "complete"
    except InputError:
        return False
    return complete and (not evaluated or (folder / METRICS).exists())


def _with_figures(run: SweepRun) -> SweepRun:
    run.figures = read_figures(run.out, RunFolder(run.out).read_json())
    return run


def _summary(run: SweepRun, objective: str) -> str:
    values = ", ".join(f"{name} {value}" for name, value in run.combination.items())
    result = f"{objective} {format_value(run.figures.get(objective))}"
    result = f"failed: {run.error}" if run.error else result
    return f"{run.out.name}: {values}: {result}{' (was finished)' if run.reused else ''}"


_children: set[subprocess.Popen[bytes]] = set()


def run_command(words: Sequence[str]) -> str | None:
    """Run ffmap in a process; return the last line of its errors, None if it succeeds."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from ffmap.app.cli import main; main()", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**ENVIRONMENT, **os.environ, **compiled_code()},
    )
    _children.add(process)
    try:
        errors = process.communicate()[1].decode(errors="replace").strip().splitlines()
    finally:
        _children.discard(process)
    if process.returncode == 0:
        return None
    return errors[-1] if errors else f"ended with exit code {process.returncode}"


def stop_all() -> None:
    """End the processes of `run_command`."""
    for process in list(_children):
        process.terminate()


@contextmanager
def _workers(
    options: RunOptions, out: Path, bags: Sequence[BagPath]
) -> Iterator[tuple[Executor, int]]:
    """Yield an executor and the number of runs at once."""
    if options.scheduler is not None:
        from ffmap.app.run.cluster import connect

        needed = [out, *(part for bag in bags for part in bag.parts)]
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
    """Return the mean of a figure over the bags; None if a run lacks it."""
    values = [run.figures[name] for run in runs if name in run.figures]
    return statistics.fmean(values) if values and len(values) == len(runs) else None


def _write_table(path: Path, runs: Sequence[SweepRun]) -> None:
    """Write one row for each run: folder, bag, error, settings and all figures."""
    rows: list[dict[str, Any]] = [
        {"run": run.out.name, "bag": run.bag, "error": run.error, **run.combination, **run.figures}
        for run in runs
    ]
    with written_whole(path) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, dict.fromkeys(name for row in rows for name in row))
        writer.writeheader()
        writer.writerows(rows)


def _report(out: Path, runs: Sequence[SweepRun], objective: str) -> None:
    """Print the runs in the folder, best first, the failed ones, and what to do next."""
    done = [run for run in runs if run.error is None]
    if done:
        list_runs(out, where=[], sort=objective, reverse=False, columns=None)
    for run in runs:
        if run.error is not None:
            typer.echo(f"failed: {run.out.name}: {run.error}")
    reused = sum(run.reused for run in runs)
    typer.echo(f"{len(done)} of {len(runs)} runs, {reused} of them were finished")
    typer.echo(f"table:     {out / SWEEP_TABLE}")
    sign = -1.0 if FIGURES[objective].better == "higher" else 1.0
    ranked = sorted(
        (run for run in done if run.bag == runs[0].bag and objective in run.figures),
        key=lambda run: sign * run.figures[objective],
    )
    if len(ranked) > 1:
        typer.echo(f"compare:   {own_command()} compare {ranked[1].out} {ranked[0].out}")
