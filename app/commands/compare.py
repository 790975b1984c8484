"""ffmap compare: runs side by side in one recording, and what differs between the first and each of the others."""

import string
import tempfile
import uuid
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import typer
from rich.console import Console

from ffmap.app.analysis import comparison_report as report
from ffmap.app.analysis.comparison import (
    Comparison,
    LabelComparison,
    PairChange,
    RunToCompare,
    compare_files,
    differing_provenance,
    differing_settings,
    figures,
    grid_of,
    labels_can_be_compared,
)
from ffmap.app.commands.inspect import open_viewer
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.names import check_no_run_loses, require_writable
from ffmap.app.progress import Progress
from ffmap.app.record.comparison import ComparisonRecorder, log_changed_points, write_rerooted
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.read_back import readable, rows
from ffmap.app.record.stream import send_part
from ffmap.app.tables import make_table
from ffmap.blueprints import compare as compare_blueprint
from ffmap.blueprints import entities
from ffmap.blueprints.compare import ComparedRun
from ffmap.blueprints.run import view_of
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import read_tum

RECORDING = "comparison.rrd"
_UNFINISHED = {
    "running": "is still running",
    "killed": "was killed, 'ffmap run --resume {}' goes on with it",
    "aborted": "was aborted, 'ffmap run --resume {}' goes on with it",
}
_UNKNOWN = "does not say whether it came to its end"


def compare(paths: Sequence[Path], out: Path | None, scans: bool, spawn: bool, quiet: bool) -> None:
    """Compare runs; raises InputError for what the user can mend.

    out: a folder for both files, or the recording's name. scans: with single scans side by side.
    """
    if len(paths) < 2:
        raise InputError("give two run folders or more; 'ffmap compare --help' has examples")
    if len(paths) > len(string.ascii_uppercase):
        raise InputError(f"{len(paths)} runs are too many to look at; give at most {len(string.ascii_uppercase)}")
    found = [open_run(path) for path in paths]
    recording = _target(found, out)
    figures_file = recording.with_suffix(".json")
    with ExitStack() as stack, Progress(quiet) as progress:
        spool = stack.enter_context(tempfile.TemporaryDirectory(prefix="comparison-", dir=recording.parent))
        warnings: list[str] = []
        runs = [
            _readable(letter, run, stack, warnings) for letter, run in zip(string.ascii_uppercase, found, strict=False)
        ]
        for warning in warnings:
            progress.warn(warning)
        parts = _Parts(Path(spool), scans)
        comparison = _compare(runs, warnings, parts, progress)
        _write_recording(comparison, parts, recording, progress)
    write_json(figures_file, report.as_json(comparison))
    if not quiet:
        _print(comparison)
        typer.echo(f"figures:   {figures_file}")
        typer.echo(f"recording: {recording}  (open it: ffmap view {recording})")
    if spawn:
        open_viewer(recording)


def _target(runs: Sequence[FinishedRun], out: Path | None) -> Path:
    """Where the recording is written, the report beside it; never over what a run made."""
    path = Path("comparison-" + "-".join(run.name for run in runs)[:100]) if out is None else out
    recording = path if path.suffix == ".rrd" and not path.is_dir() else path / RECORDING
    for run in runs:
        if recording.resolve().parent == run.path.resolve() and recording.name != RECORDING:
            raise InputError(f"{recording}: lies among the files of a run; give another place to --out")
    check_no_run_loses(recording)
    require_writable(recording.parent, "give another place to --out")
    return recording


def _readable(letter: str, run: FinishedRun, stack: ExitStack, warnings: list[str]) -> RunToCompare:
    """The run with its recording, if it has one that can be read."""
    if not run.complete:
        unfinished = _UNFINISHED.get(run.outcome, _UNKNOWN).format(run.path)
        warnings.append(f"{letter}, {run.name}: {unfinished}; what it has is compared")
    recording = None
    if run.recording is None:
        warnings.append(f"{letter}, {run.name}: has no recording, so nothing of it is shown side by side")
    else:
        try:
            recording = stack.enter_context(readable(run.recording))
        except InputError as error:
            warnings.append(f"{letter}: {error}")
    if recording is not None and recording.warning is not None:
        warnings.append(f"{letter}: {recording.warning}")
    return RunToCompare(letter, run, recording)


@dataclass(frozen=True)
class _Parts:
    """The parts of the comparison's recording. scans: whether single scans are wanted. scan_of: the scan of each stamp."""

    spool: Path
    scans: bool
    recording_id: str = field(default_factory=lambda: str(uuid.uuid4()))
    written: list[Path] = field(default_factory=list)
    scan_of: dict[int, int] = field(default_factory=dict)

    def open(self, name: str) -> AbstractContextManager[Log]:
        """A new part; it belongs to the recording once it is added to those that are written."""
        return open_log(self.spool / name, self.recording_id)


def _compare(runs: Sequence[RunToCompare], warnings: Sequence[str], parts: _Parts, progress: Progress) -> Comparison:
    """Compare, and write the points whose labels changed while doing so."""
    first, *others = runs
    changes = [PairChange(a=first, b=other) for other in others]
    for change in changes:
        if labels_can_be_compared(change):
            progress.stage(f"{first.letter} – {change.b.letter}", None)
            _compare_labels(change, parts, progress)
        compare_files(change)
    for run in runs:
        if run.recording is not None and not parts.scan_of:
            parts.scan_of.update((row.stamp_ns, row.scan) for row in rows(run.recording.path, entities.TRAJECTORY))
    own = [run.run for run in runs]
    tables = differing_settings(own), differing_provenance(own), figures(own)
    return Comparison(tuple(runs), tuple(changes), *tables, tuple(warnings))


def _compare_labels(change: PairChange, parts: _Parts, progress: Progress) -> None:
    comparing, name = LabelComparison(change.a, change.b), f"changes-{change.b.letter}.rrd"
    with parts.open(name) as log:
        for changed in comparing:
            log_changed_points(log, change.b.letter, changed)
            parts.scan_of[changed.stamp_ns] = changed.scan
            progress.advance()
    labels = comparing.result()
    if labels.scans:
        change.labels = labels
        parts.written.append(parts.spool / name)
    else:
        change.refused["labels"] = "the runs have no cloud in common"


def _write_recording(comparison: Comparison, parts: _Parts, out: Path, progress: Progress) -> None:
    """The layout, what was found, the points that changed, and the runs side by side."""
    progress.stage("side by side", len(comparison.runs))
    of_pair = {change.b.letter: change for change in comparison.changes}
    shown = []
    for run in comparison.runs:
        part, own = parts.spool / f"run-{run.letter}.rrd", run.recording
        if own is not None and write_rerooted(own.path, run.letter, part, parts.recording_id, parts.scans):
            parts.written.append(part)
        scans, change = parts.scans and own is not None and run.run.has_scans, of_pair.get(run.letter)
        compared = (frozenset(change.compared), frozenset(change.differing)) if change is not None else ()
        shown.append(ComparedRun(run.letter, run.title, scans, own is not None, *compared))
        progress.advance()
    centre_m, extent_m = view_of(*(grid_of(run.run) for run in comparison.runs))
    letter, scan = _most_changed(comparison.changes, parts.scan_of)
    numbers = parts.scan_of.values()
    shown_scans = (min(numbers), max(numbers)) if numbers else None
    layout = compare_blueprint.build(shown, centre_m, extent_m, scan, letter, shown_scans)
    with open_log(out, parts.recording_id, layout=layout) as log:
        _log_findings(comparison, parts, log)
        for part in parts.written:
            send_part(log.stream, part)


def _most_changed(changes: Sequence[PairChange], scan_of: dict[int, int]) -> tuple[str | None, int | None]:
    """The run and the scan that tell most: by labels, else by poses; None where nothing differs by scans."""
    by_labels = [
        (worst.changed, c.b.letter, worst.scan)
        for c in changes
        if c.labels is not None and (worst := c.labels.worst) is not None
    ]
    by_poses = []
    for change in changes:
        if change.trajectory is not None:
            moved = change.trajectory.figures.error_unaligned_m
            k = int(np.argmax(moved))
            if moved[k] > report.MOVED_M:
                by_poses.append((float(moved[k]), change.b.letter, scan_of.get(int(change.trajectory.stamp_ns[k]))))
    found = by_labels or by_poses
    return max(found, key=lambda candidate: candidate[0])[1:] if found else (None, None)


def _log_findings(comparison: Comparison, parts: _Parts, log: Log) -> None:
    log.stream.send_recording_name(" – ".join(run.run.name for run in comparison.runs))
    recorder = ComparisonRecorder(log, [c.labels for c in comparison.changes if c.labels is not None])
    recorder.log_common(report.runs_document(comparison))
    # Only runs of the same bag have a map frame in common.
    apart = {change.b.letter for change in comparison.changes if not change.same_bag}
    for k, run in enumerate(comparison.runs):
        if run.letter not in apart:
            color = entities.RUN_COLORS[k % len(entities.RUN_COLORS)]
            poses = run.run.trajectory
            path = read_tum(poses).T_map_base[:, :3, 3] if poses is not None else None
            recorder.log_run(run.letter, color, path, grid_of(run.run))
    for change in comparison.changes:
        recorder.log_pair(change.b.letter, change, report.pair_document(change, comparison), parts.scan_of)


def _print(comparison: Comparison) -> None:
    console = Console(highlight=False)
    first, *others = letters = [run.letter for run in comparison.runs]
    rows: list[list[str]] = []
    for run in comparison.runs:
        bag = run.run.bag_path
        rows.append([run.letter, str(run.run.path), run.run.outcome, bag.name if bag else "–"])
    console.print(make_table("Runs", ("", "folder", "outcome", "bag"), rows, left=range(4)))
    if comparison.settings:
        rows = [[name, *map(report.text_of, values)] for name, values in comparison.settings.items()]
        headings = ("setting", *letters)
        console.print(make_table("Settings that differ", headings, rows, left=range(len(headings))))
    else:
        console.print("Settings: all the same.")
    for change in comparison.changes:
        refused = [(f"{what}: not compared", why) for what, why in change.reasons.items()]
        title = f"{change.b.letter} against {first}"
        console.print(make_table(title, ("", ""), [*report.summary(change), *refused], left=(0, 1), show_header=False))
    rows = [
        [name, *map(report.figure_of, values), *(report.difference_of(values[0], value) for value in values[1:])]
        for name, values in report.headlines(comparison).items()
    ]
    if rows:
        console.print(make_table("Figures", ("figure", *letters, *(f"{other} − {first}" for other in others)), rows))
