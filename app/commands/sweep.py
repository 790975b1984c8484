"""ffmap sweep: many settings on one or several bags, every combination a run folder; then what came of them."""

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import typer

from ffmap.app.folder import figures
from ffmap.app.folder.names import PROGRAM, RunFolder, make_writable
from ffmap.app.folder.sweep_files import RECORDING, STUDY, SWEEP_JSON, TABLE
from ffmap.app.progress import Progress, table_console
from ffmap.app.run.odometry import name_of
from ffmap.app.run.odometry_cache import cache_folder
from ffmap.app.setup.inputs import InputOptions, Inputs, digest_clouds, find_inputs, total_digest
from ffmap.app.setup.outputs import Output
from ffmap.app.setup.settings import Settings, load_settings
from ffmap.app.setup.versions import versions
from ffmap.app.sweeps import plan as sweep_plan
from ffmap.app.sweeps.one_run import Job, overrides_of, stop_all
from ffmap.app.sweeps.plan import Combination, Parameter, Search, Study
from ffmap.app.sweeps.results import Results
from ffmap.app.sweeps.schedule import Run, Schedule
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.pointcloud2 import TimeFrom
from ffmap.loaders.text_files import read_json
from ffmap.loaders.truth import POSE_TOPIC


@dataclass(frozen=True)
class Arguments:
    """The command line's words; see `ffmap.app.cli.sweep`."""

    bags: tuple[Path, ...]
    grid: tuple[str, ...]
    outputs: tuple[Output, ...]
    random: int | None = None
    optuna: int | None = None
    objective: str = figures.QUALITY
    seed: int = 0
    out: Path | None = None
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    rig: Path | None = None
    horizontal: str | None = None
    vertical: str | None = None
    time_from: TimeFrom = "auto"
    trajectory: str | None = None
    detail: str = "map"
    evaluate: bool = True
    scheduler: str | None = None
    workers: int = 2
    quiet: bool = False


@dataclass(frozen=True)
class Sweep:
    """What a sweep is made from, all of it checked."""

    arguments: Arguments
    base: Settings
    parameters: tuple[Parameter, ...]
    bags: tuple[Inputs, ...]
    truth: bool
    """Whether every bag carries it, so that runs have metrics."""
    clouds: Mapping[Path, Mapping[str, str]]
    """For each bag, the digest of all clouds of each topic that runs read."""
    out: Path


def sweep(arguments: Arguments) -> int:
    """Do all runs that are not done yet, show and write what came of them; returns how many failed.

    Raises InputError before anything starts where a setting, a bag, the folder or the scheduler is wrong.
    """
    plan = _plan(arguments)
    _create(plan.out)
    if not (plan.out / SWEEP_JSON).exists():
        _write_json(plan, [])
    search = _search(plan)
    started = time.monotonic()
    try:
        schedule = _perform(plan, search)
    except KeyboardInterrupt:
        typer.echo("ffmap: interrupted; the same command goes on with the sweep", err=True)
        raise SystemExit(130) from None
    runs = list(schedule.runs.values())
    results = Results(runs, plan.parameters, arguments.objective)
    results.write(plan.out / TABLE)
    _write_json(plan, runs)
    if results.trials:
        from ffmap.app.record.sweep import write_recording

        write_recording(plan.out / RECORDING, results, results.failures, plan.bags[0].bag_path.name)
    if not arguments.quiet:
        _report(plan, results, len(schedule.odometries), time.monotonic() - started)
    return sum(run.failed for run in runs)


def _perform(plan: Sweep, search: Search) -> Schedule:
    """All runs, with what the user sees meanwhile."""
    objective, total = plan.arguments.objective, search.total * len(plan.bags)
    with (
        _workers(plan) as (executor, slots, cache),
        Progress(plan.arguments.quiet, estimate_s=_WHOLE_SWEEP_S) as progress,
    ):
        for warning in dict.fromkeys(warning for inputs in plan.bags for warning in inputs.warnings):
            progress.warn(warning)
        teller = _Teller(progress, total, objective)
        schedule = Schedule(search, lambda combination: _runs_of(plan, combination, cache), objective, teller.tell)
        progress.stage("sweep", total)
        schedule.perform(executor, slots)
    return schedule


_WHOLE_SWEEP_S = 30 * 86_400.0


def _runs_of(plan: Sweep, combination: Combination, cache: Path) -> list[Run]:
    """One run for each bag."""
    settings = sweep_plan.apply(plan.base, combination)
    arguments = plan.arguments
    stems = [inputs.bag_path.stem for inputs in plan.bags]
    runs = []
    for inputs in plan.bags:
        stem = inputs.bag_path.stem
        clouds = plan.clouds[inputs.bag_path]
        digest = total_digest(clouds)
        name = stem if stems.count(stem) == 1 else f"{stem}-{digest[:6]}"
        job = Job(
            bag=inputs.bag_path,
            bag_digest=digest,
            out=plan.out / f"{name}-{settings.short_hash()}",
            overrides=overrides_of(settings),
            settings_hash=settings.short_hash(),
            rig=arguments.rig.resolve() if arguments.rig else None,
            horizontal=arguments.horizontal,
            vertical=arguments.vertical,
            time_from=arguments.time_from,
            trajectory=_absolute(arguments.trajectory),
            detail=arguments.detail,
            outputs=arguments.outputs,
            evaluate=plan.truth,
            cache=cache,
        )
        given = arguments.trajectory is not None or inputs.horizontal is None
        runs.append(
            Run(
                job,
                combination,
                None if given or not inputs.horizontal else name_of(inputs, inputs.horizontal, settings, clouds),
            )
        )
    return runs


def _absolute(trajectory: str | None) -> str | None:
    """A file by its whole path, for the processes of a cluster work elsewhere; a topic as it is."""
    return str(Path(trajectory).resolve()) if trajectory is not None and Path(trajectory).exists() else trajectory


class _Teller:
    """Says what became of each run, and how long the others will take where no bar does."""

    def __init__(self, progress: Progress, total: int, objective: str) -> None:
        self._progress, self._total, self._objective = progress, total, objective
        self._ended, self._worked, self._started = 0, 0, time.monotonic()

    def tell(self, run: Run) -> None:
        """A run has ended."""
        assert run.outcome is not None
        self._ended += 1
        if run.reused:
            self._progress.left_out()
        else:
            self._worked += 1
            self._progress.advance()
        if run.outcome.error is not None:
            came = f"failed: {run.outcome.error}"
        else:
            value = run.figures.get(self._objective)
            shown = f"{self._objective} {figures.format_value(value)}" if value is not None else "done"
            came = f"{shown}, was there" if run.reused else f"{shown}, {run.outcome.seconds:.0f} s"
        names = figures.short_names(run.combination)
        combination = ", ".join(f"{names[name]} {value}" for name, value in run.combination.items())
        self._progress.say(f"[{self._ended}/{self._total}] {run.job.name} ({combination}): {came}{self._left()}")

    def _left(self) -> str:
        left = self._total - self._ended
        if self._progress.has_bar or not self._worked or not left:
            return ""
        seconds = (time.monotonic() - self._started) / self._worked * left
        return f"; about {seconds:.0f} s left" if seconds < 120 else f"; about {seconds / 60:.0f} min left"


def _write_json(plan: Sweep, runs: Sequence[Run]) -> None:
    """What was asked for, and what became of every run."""
    arguments = plan.arguments
    content = {
        "program": PROGRAM,
        "versions": versions(),
        "bags": [
            {"path": str(inputs.bag_path), "digest": total_digest(plan.clouds[inputs.bag_path])} for inputs in plan.bags
        ],
        "grid": list(arguments.grid),
        "random": arguments.random,
        "optuna": arguments.optuna,
        "objective": arguments.objective,
        "seed": arguments.seed,
        "settings": plan.base.model_dump(mode="json"),
        "runs": [
            {
                "run": run.job.name,
                "values": dict(run.combination),
                "error": run.outcome.error if run.outcome else None,
            }
            for run in runs
        ],
    }
    RunFolder(plan.out).write_json(content, SWEEP_JSON)


def _report(plan: Sweep, results: Results, odometries: int, seconds: float) -> None:
    console = table_console()
    if results.trials:
        console.print(results.table(console.width))
    runs = results.runs
    failed = [run for run in runs if run.failed]
    for run in failed:
        assert run.outcome is not None
        typer.echo(f"failed: {run.job.name}: {run.outcome.error}")
    typer.echo(
        f"{len(runs) - len(failed)} of {len(runs)} runs, {sum(run.reused for run in runs)} of them were there, "
        f"{odometries} odometries computed, in {seconds:.0f} s"
    )
    typer.echo(f"results:   {plan.out}  (query them: ffmap runs {plan.out})")
    typer.echo(f"table:     {plan.out / TABLE}")
    if results.trials:
        typer.echo(f"recording: {plan.out / RECORDING}  (open it: ffmap view {plan.out})")
    others = {str(run.record.get("versions", {}).get("git_revision")) for run in runs if run.reused}
    others -= {versions()["git_revision"]}
    if others:
        typer.echo(
            f"warning: runs that were there are of another version of the program ({', '.join(sorted(others))}); use another "
            "--out to make them again"
        )


def _plan(arguments: Arguments) -> Sweep:
    base = load_settings(arguments.config, arguments.overrides)
    searched = arguments.random is not None or arguments.optuna is not None
    if arguments.random is not None and arguments.optuna is not None:
        raise InputError("--random and --optuna: choose one of them")
    parameters = sweep_plan.parse_grid(arguments.grid, base, ranges=searched)
    if not arguments.bags:
        raise InputError("give a bag; 'ffmap sweep --help' has examples")
    options = InputOptions(arguments.rig, arguments.horizontal, arguments.vertical, arguments.time_from)
    bags = tuple(find_inputs(bag, options) for bag in dict.fromkeys(path.resolve() for path in arguments.bags))
    for inputs in bags:
        if inputs.vertical is None:
            raise InputError(f"{inputs.bag_path}: has no lidar that sweeps the walls; there is nothing to label")
        if inputs.horizontal is None and arguments.trajectory is None:
            raise InputError(f"{inputs.bag_path}: no horizontal lidar gives poses; give --horizontal or --trajectory")
    truth = arguments.evaluate and all(_has_truth(inputs) for inputs in bags)
    if truth and not {Output.LABELS, Output.LABELLED} & set(arguments.outputs):
        raise InputError("--outputs: without labels or labelled no run can be compared with the truth; add labels")
    figures.check_objective(arguments.objective, truth or arguments.optuna is None)
    given = arguments.trajectory is not None
    clouds = {inputs.bag_path: digest_clouds(inputs.bag_path, inputs.used(given)) for inputs in bags}
    out = arguments.out or _default_out(arguments, clouds, base)
    return Sweep(arguments, base, parameters, bags, truth, clouds, out.resolve())


def _has_truth(inputs: Inputs) -> bool:
    with open_bag(inputs.bag_path) as bag:
        return POSE_TOPIC in bag.topics and bag.topics[POSE_TOPIC].count > 0


def _default_out(arguments: Arguments, clouds: Mapping[Path, Mapping[str, str]], base: Settings) -> Path:
    """The same for the same command and program, so that a sweep that was killed goes on."""
    said: list[object] = [arguments.grid, arguments.random, arguments.optuna, arguments.objective, arguments.seed]
    said += [arguments.outputs, arguments.detail, arguments.trajectory, arguments.time_from]
    said += [[total_digest(read) for read in clouds.values()], base.short_hash(), versions()]
    digest = hashlib.sha256(json.dumps(said).encode()).hexdigest()[:8]
    return Path("runs") / f"sweep-{next(iter(clouds)).stem}-{digest}"


def _create(out: Path) -> None:
    """Raises InputError where the folder cannot be written or holds something else."""
    try:
        if out.is_dir() and any(out.iterdir()) and not _is_sweep(out):
            raise InputError(f"{out}: holds files that are no sweep; give an empty or a new folder to --out")
        make_writable(out)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror}); give another folder to --out") from error


def _is_sweep(folder: Path) -> bool:
    try:
        return bool(read_json(folder / SWEEP_JSON, "")["program"] == PROGRAM)
    except (InputError, LookupError, TypeError):
        return False


def _search(plan: Sweep) -> Search:
    arguments = plan.arguments
    if arguments.optuna is not None:
        return Study(plan.parameters, arguments.optuna, arguments.seed, arguments.objective, plan.out / STUDY)
    if arguments.random is not None:
        return sweep_plan.random_of(plan.parameters, arguments.random, arguments.seed)
    return sweep_plan.grid_of(plan.parameters)


@contextmanager
def _workers(plan: Sweep) -> Iterator[tuple[Executor, Callable[[], int], Path]]:
    """Who does the runs, how many at once, and where the odometries are kept that they share."""
    own = cache_folder().parent
    if plan.arguments.scheduler is None:
        with _local(plan) as executor:
            yield executor, lambda: plan.arguments.workers, own if _can_write(own) else plan.out
        return
    from ffmap.app.sweeps.cluster import connect

    # A worker sees the folder if it sees what lies in it.
    needed = [plan.out / SWEEP_JSON, *(inputs.bag_path for inputs in plan.bags)]
    with connect(plan.arguments.scheduler, needed, plan.out) as cluster:
        shared = _can_write(own) and cluster.all_see(own / _MARK)
        yield cluster.executor, lambda: cluster.slots, own if shared else plan.out


_MARK = ".shared"


def _can_write(folder: Path) -> bool:
    """Whether a cache can be kept there; leaves a mark that others can look for."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / _MARK).touch()
    except OSError:
        return False
    return True


@contextmanager
def _local(plan: Sweep) -> Iterator[Executor]:
    """Threads, each of which waits for a process."""
    executor = ThreadPoolExecutor(plan.arguments.workers)
    try:
        yield executor
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        stop_all(plan.out)
