"""ffmap run: from the options to a finished run folder, and five lines on what came of it."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.names import METRICS, RUN_JSON, RunFolder, point_latest_at
from ffmap.app.own_command import view_command
from ffmap.app.progress import Progress
from ffmap.app.run.start import Ready, carry_out, interruptible, make_ready, make_ready_again
from ffmap.app.setup.inputs import Inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Output
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag_path import BagPath

if TYPE_CHECKING:
    from ffmap.app.analysis.metrics_tables import Metrics


def run(
    bag: BagPath,
    settings: Settings,
    options: RunOptions,
    out: Path | None = None,
    overwrite: bool = False,
    latest: bool = False,
) -> None:
    """Run on a bag; see `make_ready`. latest: whether `latest` beside the folder is to point at it.

    Raises InputError for what the user can mend, as where another run is at the folder.
    """
    with ExitStack() as stack:
        ready = make_ready(stack, bag, settings, options, out, overwrite)
        _perform(ready, latest)


def resume(folder: Path, options: RunOptions) -> None:
    """Go on with a run that was killed, unless it is complete. options: see `make_ready_again`."""
    with ExitStack() as stack:
        ready = make_ready_again(stack, folder, options)
        if ready is not None:
            _perform(ready, latest=True)


def _perform(ready: Ready, latest: bool) -> None:
    options, inputs = ready.options, ready.inputs
    folder, record = ready.folder, carry_out(ready)
    if latest:
        point_latest_at(folder.path.resolve())
    quality = "unknown: the comparison with the truth came to no end, as is told below"
    try:
        metrics = None
        if options.evaluate and inputs.vertical is not None:
            how_to_go_on = f"'ffmap evaluate {folder.path}' compares it with the truth"
            with interruptible(f"the run is complete, {how_to_go_on}"):
                metrics = _evaluate(folder, options)
        quality = _quality(folder, inputs, options, metrics)
    finally:
        # The run is complete, whatever becomes of its comparison with the truth.
        if not options.quiet:
            recorded = Output.RECORDING in options.outputs
            lines = {
                "made": _made(inputs, record),
                "quality": quality,
                "results": str(folder.path),
                "look": view_command(folder.path) if recorded else "no recording was asked for",
                "warnings": _warnings(folder, record["warnings"]),
            }
            for name, text in lines.items():
                typer.echo(f"{name + ':':<10} {text}")


def _evaluate(folder: RunFolder, options: RunOptions) -> "Metrics | None":
    """The figures against the truth; None where the bag carries none."""
    from ffmap.app.analysis.evaluation import evaluate_run, has_truth
    from ffmap.app.analysis.metrics_tables import print_metrics

    finished = open_run(folder.path)
    if not has_truth(finished):
        return None
    with Progress(options.quiet) as progress:
        progress.stage("evaluation", None)
        metrics = evaluate_run(finished, None, options.workers)
    if options.verbose and not options.quiet:
        print_metrics(metrics)
    return metrics


def _made(inputs: Inputs, record: dict[str, Any]) -> str:
    counts, seconds = record["counts"], record["timings_s"]["total"]
    if inputs.vertical is None:
        return (
            f"{counts.get('registrations', 0)} scans registered in {seconds:.1f} s; there is "
            f"nothing to label: {inputs.bag_path.name} has no lidar that sweeps the walls (a "
            "vertical one, its spin axis level)"
        )
    return (
        f"{counts['scans']} of {counts['clouds']} scans labelled, {counts['walls']} wall faces, "
        f"{counts['doors']} doors, {counts['rooms']} rooms, in {seconds:.1f} s"
    )


def _quality(
    folder: RunFolder, inputs: Inputs, options: RunOptions, metrics: "Metrics | None"
) -> str:
    if metrics is not None:
        from ffmap.app.analysis.metrics_tables import in_one_line

        said = f"{in_one_line(metrics)}; all figures in {folder.path / METRICS}"
        return said if options.verbose else f"{said}, -v prints them"
    if inputs.vertical is None:
        return "unknown: only what is labelled is compared with the truth"
    if not options.evaluate:
        return "unknown: not compared with the truth, as --no-evaluate says"
    return (
        f"unknown: the bag carries no truth; 'ffmap evaluate {folder.path} --truth FILE' compares "
        "with another's"
    )


def _warnings(folder: RunFolder, warnings: Sequence[str]) -> str:
    if len(warnings) < 2:
        return f"1, {warnings[0]}" if warnings else "none"
    return f"{len(warnings)}, all in {folder.path / RUN_JSON}; the first: {warnings[0]}"
