"""ffmap sweep: many settings on one or several bags, every combination a run folder; then what came of them."""

import time
from collections.abc import Sequence

import typer

from ffmap.app.folder import figures
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.names import PROGRAM, SweepFile
from ffmap.app.parameters import SweepParameters
from ffmap.app.progress import Progress
from ffmap.app.setup.inputs import total_digest
from ffmap.app.setup.versions import versions
from ffmap.app.sweeps.plan import Search
from ffmap.app.sweeps.results import Results
from ffmap.app.sweeps.schedule import Run, Schedule
from ffmap.app.sweeps.start import Sweep, make_ready, workers_of
from ffmap.app.tables import table_console

_WHOLE_SWEEP_S = 30 * 86_400.0


def sweep(words: SweepParameters) -> int:
    """Do all runs that are not done yet, show and write what came of them; returns how many failed.

    Raises InputError before anything starts where a setting, a bag, the folder or the scheduler is wrong.
    """
    plan = make_ready(words)
    if not (plan.out / SweepFile.JSON).exists():
        _write_json(plan, [])
    search = plan.search()
    started = time.monotonic()
    try:
        schedule = _perform(plan, search)
    except KeyboardInterrupt:
        typer.echo("ffmap: interrupted; the same command goes on with the sweep", err=True)
        raise SystemExit(130) from None
    runs = list(schedule.runs.values())
    results = Results(runs, plan.parameters, words.objective)
    results.write(plan.out / SweepFile.TABLE)
    _write_json(plan, runs)
    if results.trials:
        from ffmap.app.record.sweep import write_recording

        write_recording(plan.out / SweepFile.RECORDING, results, results.failures, plan.bags[0].bag_path.name)
    if not words.quiet:
        _report(plan, results, len(schedule.odometries), time.monotonic() - started)
    return len(results.failures)


def _perform(plan: Sweep, search: Search) -> Schedule:
    objective, total = plan.words.objective, search.total * len(plan.bags)
    with (
        workers_of(plan) as (executor, slots, cache),
        Progress(plan.words.quiet, estimate_s=_WHOLE_SWEEP_S) as progress,
    ):
        for warning in dict.fromkeys(warning for inputs in plan.bags for warning in inputs.warnings):
            progress.warn(warning)
        teller = _Teller(progress, total, objective)
        schedule = Schedule(search, lambda combination: plan.runs_of(combination, cache), objective, teller.tell)
        progress.stage("sweep", total)
        schedule.perform(executor, slots)
    return schedule


class _Teller:
    """Says what became of each run, and how long the others will take where no bar does."""

    def __init__(self, progress: Progress, total: int, objective: str) -> None:
        self._progress, self._total, self._objective = progress, total, objective
        self._ended, self._worked, self._started = 0, 0, time.monotonic()

    def tell(self, run: Run) -> None:
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
    words = plan.words
    content = {
        "program": PROGRAM,
        "versions": versions(),
        "bags": [{"path": str(path), "digest": total_digest(clouds)} for path, clouds in plan.clouds.items()],
        "grid": list(words.grid or ()),
        **{name: getattr(words, name) for name in ("random", "optuna", "objective", "seed")},
        "settings": plan.base.model_dump(mode="json"),
        "runs": [{"run": run.job.name, "values": dict(run.combination), "error": run.error} for run in runs],
    }
    write_json(plan.out / SweepFile.JSON, content)


def _report(plan: Sweep, results: Results, odometries: int, seconds: float) -> None:
    console = table_console()
    if results.trials:
        console.print(results.table(console.width))
    runs = results.runs
    for failure in results.failures:
        typer.echo(f"failed: {failure}")
    typer.echo(
        f"{len(runs) - len(results.failures)} of {len(runs)} runs, {sum(run.reused for run in runs)} of them were there, "
        f"{odometries} odometries computed, in {seconds:.0f} s"
    )
    typer.echo(f"results:   {plan.out}  (query them: ffmap runs {plan.out})")
    typer.echo(f"table:     {plan.out / SweepFile.TABLE}")
    if results.trials:
        typer.echo(f"recording: {plan.out / SweepFile.RECORDING}  (open it: ffmap view {plan.out})")
    others = {str(run.record.get("versions", {}).get("git_revision")) for run in runs if run.reused}
    others -= {versions()["git_revision"]}
    if others:
        typer.echo(
            f"warning: runs that were there are of another version of the program ({', '.join(sorted(others))}); use another "
            "--out to make them again"
        )
