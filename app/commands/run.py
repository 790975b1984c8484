"""ffmap run: make a run folder from a bag and print a summary of five lines."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.names import METRICS, RUN_JSON
from ffmap.app.folder.record import RunRecord
from ffmap.app.folder.run_folder import point_latest_at
from ffmap.app.own_command import view_command
from ffmap.app.pipeline import carry_out, interruptible
from ffmap.app.progress import Progress
from ffmap.app.run.start import Run, new_run, resumed_run
from ffmap.app.setup.inputs import Inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Output
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag_path import BagPath

if TYPE_CHECKING:
    from ffmap.app.analysis.figures import Metrics


def run(
    bag: BagPath,
    settings: Settings,
    options: RunOptions,
    out: Path | None = None,
    overwrite: bool = False,
    latest: bool = False,
) -> Path:
    """Run on a bag; returns the run folder.

    latest: point the link `latest` beside the run folder at it.

    Raises InputError if the input is unusable or `out` holds another run.
    """
    with new_run(bag, settings, options, out, overwrite) as prepared:
        _perform(prepared, latest)
        return prepared.folder


def resume(folder: Path, options: RunOptions) -> None:
    """Continue a run that was killed, unless it is complete."""
    with resumed_run(folder, options) as prepared:
        if prepared is None:
            typer.echo(f"{folder} is complete already; nothing to resume")
        else:
            _perform(prepared, latest=True)


def _perform(prepared: Run, latest: bool) -> None:
    options, inputs = prepared.options, prepared.inputs
    folder, record = prepared.folder, carry_out(prepared)
    if latest:
        point_latest_at(folder.resolve())
    quality = "unknown: the evaluation failed, see the error below"
    try:
        metrics = None
        if options.evaluate and inputs.vertical is not None:
            how_to_go_on = f"'ffmap evaluate {folder}' evaluates it"
            with interruptible(f"the run is complete, {how_to_go_on}"):
                metrics = _evaluate(folder, options)
        quality = _quality(folder, inputs, options, metrics)
    finally:
        # The run is complete even if its evaluation failed.
        if not options.quiet:
            recorded = Output.RECORDING in options.outputs
            lines = {
                "made": _made(inputs, record),
                "quality": quality,
                "results": str(folder),
                "look": view_command(folder) if recorded else "no recording was written",
                "warnings": _warnings(folder, record.warnings),
            }
            for name, text in lines.items():
                typer.echo(f"{name + ':':<10} {text}")


def _evaluate(folder: Path, options: RunOptions) -> "Metrics | None":
    """Evaluate the run; None if the bag holds no ground truth."""
    from ffmap.app.analysis.evaluation import evaluate_run, has_truth
    from ffmap.app.analysis.metrics_tables import print_metrics

    finished = open_run(folder)
    if not has_truth(finished):
        return None
    with Progress(options.quiet) as progress:
        progress.stage("evaluation", None)
        metrics = evaluate_run(finished, None, options.workers)
    if options.verbose and not options.quiet:
        print_metrics(metrics)
    return metrics


def _made(inputs: Inputs, record: RunRecord) -> str:
    counts, seconds = record.counts, record.timings_s["total"]
    if inputs.vertical is None:
        return (
            f"{counts.get('registrations', 0)} scans registered in {seconds:.1f} s; nothing was "
            f"labelled: {inputs.bag_path.name} has no vertical lidar (with a level spin axis)"
        )
    return (
        f"{counts['scans']} of {counts['clouds']} scans labelled, {counts['walls']} wall faces, "
        f"{counts['doors']} doors, {counts['rooms']} rooms, in {seconds:.1f} s"
    )


def _quality(folder: Path, inputs: Inputs, options: RunOptions, metrics: "Metrics | None") -> str:
    if metrics is not None:
        from ffmap.app.analysis.metrics_tables import in_one_line

        summary = f"{in_one_line(metrics)}; all figures in {folder / METRICS}"
        return summary if options.verbose else f"{summary}, -v prints them"
    if inputs.vertical is None:
        return "unknown: without labels there is nothing to evaluate"
    if not options.evaluate:
        return "unknown: not evaluated (--no-evaluate)"
    return (
        "unknown: the bag holds no ground truth; "
        f"'ffmap evaluate {folder} --truth FILE' reads it from another file"
    )


def _warnings(folder: Path, warnings: Sequence[str]) -> str:
    if len(warnings) < 2:
        return f"1, {warnings[0]}" if warnings else "none"
    return f"{len(warnings)}, all in {folder / RUN_JSON}; the first: {warnings[0]}"
