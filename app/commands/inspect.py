"""ffmap inspect: one scan of a finished run, labelled again with all evidence, line by line."""

import re
import uuid
from collections.abc import Sequence
from pathlib import Path

import typer
from rich.console import Console

from ffmap.app.analysis.inspection import LabelChange, agreement, faults_in_words, find_worst, label_again
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.names import check_no_run_loses, require_writable
from ffmap.app.record.inspection import ExplainedScan, write
from ffmap.app.record.line_reasons import LineReason, explain_lines, name_of, scan_document
from ffmap.app.record.stream import start_viewer
from ffmap.app.tables import make_table
from ffmap.blueprints import entities
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

WORST = "worst"
_PLAIN = re.compile(r"\*\*|`")
"""What Markdown has and a terminal does not."""


def inspect(run_path: Path, wanted: str, line: int | None, bag: BagPath | None, out: Path | None, spawn: bool) -> None:
    """Record one scan line by line; raises InputError for what the user can mend.

    line: the one to open at; None for the worst, as far as the run's files tell.
    bag: where the run's bag lies now; None for where it was.
    """
    run = open_run(run_path)
    number = None if wanted == WORST else _number(wanted)
    notes: list[str] = []
    if number is None:
        number, why = find_worst(run)
        notes.append(f"Scan {number} is the worst: {why}.")
    target = _target(run, out, number)
    inspected = label_again(run, number, bag)
    lines = len(inspected.labelling.lines)
    if line is not None and not 0 <= line < lines:
        raise InputError(f"--line {line}: a scan of this lidar has lines 0 to {lines - 1} (2 × pair + side)")
    labelling, faults = inspected.labelling, inspected.faults
    notes += [inspected.lidar] if inspected.lidar is not None else []
    notes += [faults_in_words(faults, labelling.lines), agreement(run, inspected)]
    reasons = explain_lines(labelling)
    counts = faults.counts(labelling.lines).tolist() if faults is not None else None
    document = scan_document(f"Scan {number} of {run.name}", notes, labelling, reasons, counts)
    opened = line if line is not None or faults is None else faults.worst_line(labelling.lines)
    explained = ExplainedScan(inspected.level, labelling, reasons, faults, document, opened)
    write(target, str(uuid.uuid4()), explained)
    for note in notes:
        typer.echo(_PLAIN.sub("", note))
    if line is None:
        _print_changes(inspected.changes)
        _print_outcomes(reasons)
    if opened is not None:
        _print_reason(reasons[opened])
    typer.echo(f"recording: {target}  (open it: ffmap view {target}; step through the timeline 'line')")
    if spawn:
        open_viewer(target)


def open_viewer(path: Path) -> None:
    """Raises InputError where no viewer starts."""
    try:
        start_viewer(files=[path])
    except RuntimeError as error:
        raise InputError(f"--spawn: {error} Leave it out: {path} can be opened later") from error


def _number(wanted: str) -> int:
    try:
        return int(wanted)
    except ValueError:
        raise InputError(f"--scan {wanted}: give a scan's number, or {WORST}") from None


def _target(run: FinishedRun, out: Path | None, number: int) -> Path:
    """Where the recording is written; never over what a run made."""
    path = out or run.path
    if path.is_dir():
        path /= f"inspect-{number}.rrd"
    if path.suffix != ".rrd":
        raise InputError(f"{path}: a recording's name ends in .rrd; give another to --out")
    check_no_run_loses(path)
    require_writable(path.parent, "give another file to --out")
    return path


def _print_changes(changes: Sequence[LabelChange]) -> None:
    if not changes:
        return
    rows = [
        (
            f"{own.count:,}",
            "–" if own.wrong is None else f"{own.wrong:,}",
            own.before,
            own.after,
            own.reason,
            "–" if own.off_face_m is None else f"{100 * own.off_face_m:.1f} cm",
        )
        for own in changes
    ]
    columns = ("returns", "wrong", "by the scan", "final", "because", "off the nearest face")
    Console(highlight=False).print(make_table("Why the building changed its labels", columns, rows, left=(2, 3, 4)))


def _print_outcomes(reasons: Sequence[LineReason]) -> None:
    rows = [
        (str(sum(reason.outcome == outcome for reason in reasons)), name)
        for outcome, (name, _) in entities.LINE_OUTCOMES.items()
    ]
    table = make_table("What became of its lines", ("lines", "outcome"), rows, left=(1,))
    Console(highlight=False).print(table)


def _print_reason(reason: LineReason) -> None:
    console = Console(highlight=False)
    title = f"{name_of(reason.line)}: {entities.LINE_OUTCOMES[reason.outcome][0]}"
    held = {True: "yes", False: "no", None: "–"}
    rows = [(held[check.held], check.condition, check.measured, check.needed) for check in reason.checks]
    console.print(make_table(title, ("held", "condition", "measured", "needed"), rows, left=range(4)))
    console.print(_PLAIN.sub("", reason.verdict), markup=False)
