"""ffmap sweep: runs with many settings, each in a folder of its own; then a table of figures."""

import csv
import hashlib
import itertools
import json
import statistics
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ffmap.app.analysis.figures import FIGURES, HEADLINES, WITHOUT_TRUTH, find_name, read_figures
from ffmap.app.commands.run import run as run_bag
from ffmap.app.commands.runs import runs as list_runs
from ffmap.app.folder.atomic import written_whole
from ffmap.app.folder.names import METRICS, SWEEP_TABLE, require_writable
from ffmap.app.folder.record import read_record
from ffmap.app.own_command import own_command, pip_command
from ffmap.app.progress import Progress
from ffmap.app.run.workers import make_pool
from ffmap.app.setup.inputs import find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Output
from ffmap.app.setup.settings import Settings, load_settings
from ffmap.app.setup.versions import versions
from ffmap.app.tables import format_value
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.fingerprint import fingerprint
from ffmap.loaders.truth import carries_truth

_EXAMPLE = "relabelling.range_noise_m=0.01,0.03"
Combination = Mapping[str, Any]
"""A value for each searched setting, by its dotted name."""


@dataclass(frozen=True)
class Parameter:
    """A setting and its `values`, or the ends of a range; in a range of integers, only integers."""

    name: str
    values: tuple[Any, ...]
    is_range: bool = False


@dataclass(frozen=True)
class Search:
    """Combinations to try: all of the grid, N random ones, or N that Optuna proposes.

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
    bag: BagPath
    settings: Settings
    combination: Combination
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
    ranges = search.random is not None or search.optuna is not None
    parameters = parse_grid(search.grid, ranges)
    inputs = [find_inputs(path, options) for path in dict.fromkeys(p.resolve() for p in paths)]
    bags = [own.bag_path for own in inputs]
    truth = options.evaluate and all(map(carries_truth, bags))
    if truth and Output.LABELS not in options.outputs:
        raise InputError("--outputs: without labels no run can be evaluated; add labels")
    objective = _objective(search.objective, truth or search.optuna is None)
    out = (out or Path("runs") / f"sweep-{bags[0].stem}").resolve()
    require_writable(out, "give another folder to --out")
    if options.scheduler is not None:
        from ffmap.app.run.cluster import connect

        # Each run connects by itself; a mistake is reported before.
        with connect(options.scheduler, [out, *(part for bag in bags for part in bag.parts)]):
            pass
    runs: dict[Path, SweepRun] = {}
    try:
        with Progress(options.quiet) as progress:
            for warning in dict.fromkeys(warning for own in inputs for warning in own.warnings):
                progress.warn(warning)
            digests = {bag: fingerprint(bag) for bag in bags}
            perform = _Performer(base, options, out, truth, objective, digests, progress, runs)
            if search.optuna is not None:
                optimize(
                    parameters, search.optuna, options.workers, search.seed, objective, perform
                )
            elif search.random is not None:
                perform(random_of(parameters, search.random, search.seed))
            else:
                perform(grid_of(parameters))
    except (KeyboardInterrupt, SystemExit):
        typer.echo("ffmap: interrupted; the same command continues the sweep", err=True)
        raise SystemExit(130) from None
    _write_table(out / SWEEP_TABLE, list(runs.values()))
    if not options.quiet:
        _report(out, list(runs.values()), objective)
    return sum(run.error is not None for run in runs.values())


def parse_grid(texts: Sequence[str], ranges: bool) -> tuple[Parameter, ...]:
    """Parse texts like building.scans_min=2,3 or relabelling.range_noise_m=0.01..0.04.

    ranges: whether a range may be given. Raises InputError that names the wrong text.
    """
    if not texts:
        raise InputError(f"--grid: nothing to sweep; give values, as in --grid {_EXAMPLE}")
    parameters = tuple(_parse(text, ranges) for text in texts)
    names = [parameter.name for parameter in parameters]
    if len(set(names)) < len(names):
        twice = max(names, key=names.count)
        raise InputError(f"--grid {twice}: is given twice; write all values in one --grid")
    return parameters


def _parse(text: str, ranges: bool) -> Parameter:
    name, equals, listed = (part.strip() for part in text.partition("="))
    is_range = ".." in listed and "," not in listed
    parts = [part.strip() for part in listed.split(".." if is_range else ",")]
    if not equals or not name or not all(parts):
        raise InputError(
            f"--grid {text}: write it as step.name=value,value, as in {_EXAMPLE}"
        )
    # Values as the settings hold them: 1 for a length in metres is 1.0.
    values: list[Any] = [load_settings(None, [f"{name}={p}"]).flat().get(name) for p in parts]
    if None in values:
        raise InputError(f"--grid {text}: {name!r} is a step; 'ffmap settings --all' lists them")
    if not is_range:
        return Parameter(name, tuple(dict.fromkeys(values)))
    numbers = all(isinstance(value, int | float) for value in values)
    if len(values) != 2 or not numbers or values[0] >= values[1]:
        raise InputError(f"--grid {text}: write a range as lower..higher, as in 0.02..0.08")
    if not ranges:
        raise InputError(f"--grid {text}: a range needs --random N or --optuna N; or list values")
    return Parameter(name, tuple(values), is_range=True)


def grid_of(parameters: Sequence[Parameter]) -> list[Combination]:
    """Return every combination; the last parameter changes fastest."""
    names = [parameter.name for parameter in parameters]
    combinations = itertools.product(*(parameter.values for parameter in parameters))
    return [dict(zip(names, values, strict=True)) for values in combinations]


def random_of(parameters: Sequence[Parameter], count: int, seed: int) -> list[Combination]:
    """Draw `count` different combinations; all of them if there are fewer."""
    generator, different = np.random.default_rng(seed), dict[tuple[Any, ...], Combination]()
    for _ in range(100 * count):  # values and integers may run out of combinations
        combination = {own.name: _draw(own, generator) for own in parameters}
        different.setdefault(tuple(combination.values()), combination)
        if len(different) == count:
            break
    return list(different.values())


def _draw(parameter: Parameter, generator: np.random.Generator) -> Any:  # noqa: ANN401 - as Settings
    values = parameter.values
    if not parameter.is_range:
        return values[generator.integers(len(values))]
    low, high = values
    if isinstance(low, int):
        return int(generator.integers(low, high, endpoint=True))
    return float(f"{generator.uniform(low, high):.4g}")


def optimize(
    parameters: Sequence[Parameter],
    count: int,
    at_once: int,
    seed: int,
    objective: str,
    perform: Callable[[Sequence[Combination]], list[float | None]],
) -> None:
    """Perform combinations that Optuna's TPE sampler proposes, some at once.

    The combinations are the same for the same seed and results.
    perform: returns the objective of each combination; None if its runs failed.
    Raises InputError if Optuna is not installed.
    """
    try:
        import optuna  # noqa: TID251 - its one place
    except ImportError:
        raise InputError(
            f"--optuna: Optuna is not installed; '{pip_command('optuna')}' installs it (in a "
            "checkout, pip install '.[optuna]'), or use --random N"
        ) from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        # The constant liar keeps the trials of one batch apart.
        sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
    maximized = FIGURES[objective].better == "higher"
    study = optuna.create_study(sampler=sampler, direction="maximize" if maximized else "minimize")
    for first in range(0, count, at_once):
        trials = [study.ask() for _ in range(min(at_once, count - first))]
        for trial, own in itertools.product(trials, parameters):
            if not own.is_range:
                trial.suggest_categorical(own.name, own.values)
            elif isinstance(own.values[0], int):
                trial.suggest_int(own.name, *own.values)
            else:
                trial.suggest_float(own.name, *own.values)
        values = perform([trial.params for trial in trials])
        for trial, value in zip(trials, values, strict=True):
            failed = optuna.trial.TrialState.FAIL if value is None else None
            study.tell(trial, value, state=failed)


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


@dataclass(frozen=True)
class _Performer:
    """Performs the runs of combinations on every bag. runs: those that have ended."""

    base: Settings
    options: RunOptions
    out: Path
    evaluated: bool
    objective: str
    digests: Mapping[BagPath, str]
    progress: Progress
    runs: dict[Path, SweepRun]

    def __call__(self, combinations: Sequence[Combination]) -> list[float | None]:
        """Perform the runs that are not finished; return the mean objective of each combination."""
        wanted = [[self._make(bag, own) for bag in self.digests] for own in combinations]
        new = {run.out: run for own in wanted for run in own if run.out not in self.runs}
        self.progress.stage("sweep", len(new))
        waiting = []
        for run in new.values():
            if _is_finished(run.out, self.evaluated):
                self._end(run, " (was finished)")
            else:
                waiting.append(run)
        # The first run of each bag leaves the odometry in the cache for the others.
        first = list({run.bag: run for run in reversed(waiting)}.values())
        perform = partial(_perform, self.options.model_copy(update={"workers": 1, "quiet": True}))
        with make_pool(self.options.workers) as pool:
            for batch in (first, [run for run in waiting if run not in first]):
                for run, error in zip(batch, pool.map(perform, batch), strict=True):
                    run.error = error
                    self._end(run)
        return [self._mean_objective(own) for own in wanted]

    def _mean_objective(self, wanted: Sequence[SweepRun]) -> float | None:
        """Return the mean over the bags; None if a run has failed or has no such figure."""
        figures = [self.runs[run.out].figures for run in wanted]
        if not all(self.objective in own for own in figures):
            return None
        return statistics.fmean(own[self.objective] for own in figures)

    def _make(self, bag: BagPath, combination: Combination) -> SweepRun:
        """Make the run of a bag; a hash of all that it depends on names its folder."""
        values = {**self.base.flat(), **combination}
        settings = load_settings(
            None, [f"{name}={json.dumps(own)}" for name, own in values.items() if own is not None]
        )
        options = self.options.with_digests().model_dump(mode="json")
        known_by = [options, settings.flat(), self.digests[bag], versions()]
        text = json.dumps(known_by, sort_keys=True)
        name = f"{bag.stem}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        return SweepRun(self.out / name, bag, settings, combination)

    def _end(self, run: SweepRun, note: str = "") -> None:
        """Keep and print a run that has ended."""
        if run.error is None:
            run.figures = read_figures(run.out, read_record(run.out))
        self.runs[run.out] = run
        values = ", ".join(f"{name} {value}" for name, value in run.combination.items())
        result = f"{self.objective} {format_value(run.figures.get(self.objective))}"
        result = f"failed: {run.error}" if run.error else result
        self.progress.say(f"{run.out.name}: {values}: {result}{note}")
        self.progress.advance()


def _perform(options: RunOptions, run: SweepRun) -> str | None:
    """Perform a run; return its error, None if it succeeds."""
    try:
        run_bag(run.bag, run.settings, options, run.out, overwrite=True)
    except InputError as error:
        return str(error)
    except Exception as error:
        traceback.print_exc()
        return f"{type(error).__name__}: {error}"
    return None


def _is_finished(folder: Path, evaluated: bool) -> bool:
    """Return whether a folder holds the complete run."""
    try:
        complete = read_record(folder).outcome == "complete"
    except InputError:
        return False
    return complete and (not evaluated or (folder / METRICS).exists())


def _write_table(path: Path, runs: Sequence[SweepRun]) -> None:
    """Write one row for each run: folder, bag, error, settings and all figures."""
    rows: list[dict[str, Any]] = [
        {
            "run": run.out.name,
            "bag": run.bag.parts[0],
            "error": run.error,
            **run.combination,
            **run.figures,
        }
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
    typer.echo(f"{len(done)} of {len(runs)} runs succeeded")
    typer.echo(f"table:     {out / SWEEP_TABLE}")
    ranked = sorted(
        (run for run in done if run.bag == runs[0].bag and objective in run.figures),
        key=lambda run: run.figures[objective],
        reverse=FIGURES[objective].better == "higher",
    )
    if len(ranked) > 1:
        typer.echo(f"compare:   {own_command()} compare {ranked[1].out} {ranked[0].out}")
