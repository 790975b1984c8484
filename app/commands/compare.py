"""ffmap compare: runs side by side in one recording, and what differs between them."""

import string
import tempfile
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.app.analysis.comparison import Comparison, RunToCompare, compare_runs
from ffmap.app.analysis.comparison_tables import (
    as_json,
    change_document,
    print_tables,
    runs_document,
)
from ffmap.app.analysis.verdict import describe
from ffmap.app.commands.inspect import open_viewer
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.labels_file import ScanLabels
from ffmap.app.folder.names import check_no_run_loses, require_writable
from ffmap.app.progress import Progress
from ffmap.app.record import comparison as recorder
from ffmap.app.record.log import open_log
from ffmap.app.record.read_back import chunk_stream, rows
from ffmap.app.record.stream import join, write_layout
from ffmap.blueprints import compare as compare_blueprint
from ffmap.blueprints import entities
from ffmap.blueprints.compare import ComparedRun
from ffmap.blueprints.run import view_of
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import read_tum

RECORDING = "comparison.rrd"


def compare(paths: Sequence[Path], out: Path | None, scans: bool, spawn: bool, quiet: bool) -> None:
    """Compare runs.

    Args:
        out: a folder for comparison.rrd and comparison.json, or the recording's name.
        scans: whether single scans are side by side.

    Raises InputError if there are too few or too many runs, or `out` cannot be written.
    """
    letters = string.ascii_uppercase
    if not 2 <= len(paths) <= len(letters):
        raise InputError(f"give two run folders or more, at most {len(letters)}")
    found = [open_run(path) for path in paths]
    recording = _output(found, out)
    warnings: list[str] = []
    with (
        Progress(quiet) as progress,
        tempfile.TemporaryDirectory(prefix="comparison-", dir=recording.parent) as spool,
    ):
        runs = [_open(letter, run, warnings) for letter, run in zip(letters, found, strict=False)]
        for warning in warnings:
            progress.warn(warning)
        comparison = _write(runs, warnings, Path(spool), recording, scans, progress)
    figures = recording.with_suffix(".json")
    write_json(figures, as_json(comparison))
    if not quiet:
        console = Console(highlight=False)
        for line in describe(comparison):
            console.print(line, markup=False)
        for table in print_tables(comparison):
            console.print(table)
        typer.echo(f"figures:   {figures}")
        typer.echo(f"recording: {recording}  (open it: ffmap view {recording})")
    if spawn:
        open_viewer(recording)


def _output(runs: Sequence[FinishedRun], out: Path | None) -> Path:
    """Return where the recording is written, never over a file of a run."""
    path = Path("comparison-" + "-".join(run.name for run in runs)[:100]) if out is None else out
    recording = path if path.suffix == ".rrd" and not path.is_dir() else path / RECORDING
    for run in runs:
        if recording.resolve().parent == run.path.resolve() and recording.name != RECORDING:
            raise InputError(f"{recording}: is within a run; give another place to --out")
    check_no_run_loses(recording)
    require_writable(recording.parent, "give another place to --out")
    return recording


def _open(letter: str, run: FinishedRun, warnings: list[str]) -> RunToCompare:
    """Open a run with its recording, if it has one that can be read."""
    if not run.complete:
        resume = f" ('ffmap run --resume {run.path}' continues it)"
        hint = "" if run.outcome == "running" else resume
        warnings.append(f"{letter}, {run.name}: is {run.outcome}{hint}; what it has is compared")
    if run.recording is None:
        warnings.append(f"{letter}, {run.name}: has no recording to show side by side")
        return RunToCompare(letter, run, None)
    try:
        chunk_stream(run.recording)
    except InputError as error:
        warnings.append(f"{letter}: {error}")
        return RunToCompare(letter, run, None)
    return RunToCompare(letter, run, run.recording)


def _write(
    runs: Sequence[RunToCompare],
    warnings: Sequence[str],
    spool: Path,
    out: Path,
    scans: bool,
    progress: Progress,
) -> Comparison:
    """Compare the runs and write the recording: changed points, runs, differences."""
    recording_id = str(uuid.uuid4())
    scan_of: dict[int, int] = {}  # by time stamp
    parts = [spool / "changes.rrd"]
    progress.stage("compare", None)
    with open_log(parts[0], recording_id) as log:

        def log_changed(
            letter: str,
            cloud: ScanLabels,
            points: FloatArray,
            before: UInt8Array,
            after: UInt8Array,
        ) -> None:
            scan_of[cloud.stamp_ns] = cloud.scan
            log.at(cloud.stamp_ns, cloud.scan)
            recorder.log_changed_points(log, letter, points, before, after)
            progress.advance()

        comparison = compare_runs(runs, warnings, log_changed)
    progress.stage("record", len(runs))
    for run in runs:
        if run.recording is not None:
            if not scan_of:
                recorded = rows(run.recording, entities.TRAJECTORY)
                scan_of.update((row.stamp_ns, row.scan) for row in recorded)
            part = spool / f"run-{run.letter}.rrd"
            path = run.recording
            if recorder.write_rerooted(path, run.letter, part, recording_id, scans):
                parts.append(part)
        progress.advance()
    changes = {change.b.letter: change for change in comparison.changes}
    numbers = (min(scan_of.values()), max(scan_of.values())) if scan_of else None
    layout = _layout(comparison, scans, numbers)
    parts += [spool / "layout.rrd", spool / "differences.rrd"]
    write_layout(parts[-2], recording_id, layout)
    with open_log(parts[-1], recording_id) as log:
        log.stream.send_recording_name(" – ".join(run.run.name for run in runs))
        colors = recorder.transition_colors(comparison.changes)
        recorder.log_common(log, runs_document(comparison), colors)
        for number, run in enumerate(runs):
            # Runs of other bags have another map frame.
            if run.letter not in changes or changes[run.letter].same_bag:
                poses = run.run.trajectory
                path_m = read_tum(poses).T_map_base[:, :3, 3] if poses is not None else None
                recorder.log_run(log, run.letter, number, path_m, run.grid)
        for change in comparison.changes:
            text = change_document(change, comparison)
            recorder.log_change(log, change.b.letter, change, text, scan_of, colors)
    join(out, parts)
    return comparison


def _layout(comparison: Comparison, scans: bool, numbers: tuple[int, int] | None) -> Any:  # noqa: ANN401 - Rerun's blueprint
    """Lay out the recording. numbers: of the first and the last scan."""
    changes = {change.b.letter: change for change in comparison.changes}
    shown = []
    for run in comparison.runs:
        recorded = run.recording is not None
        with_scans = scans and recorded and run.run.has_scans
        compared, judged = frozenset[str](), False
        if (change := changes.get(run.letter)) is not None:
            compared = frozenset(change.compared)
            judged = change.labels is not None and change.labels.judged is not None
        shown.append(
            ComparedRun(run.letter, run.title, with_scans, recorded, compared, judged)
        )
    letter, scan = comparison.most_changed
    centre_m, extent_m = view_of(*(run.grid for run in comparison.runs))
    return compare_blueprint.build(shown, centre_m, extent_m, scan, letter, numbers)
