"""ffmap inspect: one scan of a finished run, labelled again with all evidence, line by line."""

import re
import uuid
from collections.abc import Sequence
from pathlib import Path

import typer
from rich.console import Console

from ffmap.app.analysis.inspection import (
    CHANGE_HEADINGS,
    agreement,
    faults_in_words,
    find_worst,
    label_again,
)
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.names import check_no_run_loses, require_writable
from ffmap.app.record.inspection import ExplainedScan, write
from ffmap.app.record.line_reasons import (
    CONDITION_HEADINGS,
    condition_rows,
    explain_lines,
    name_of,
    scan_document,
)
from ffmap.app.record.stream import start_viewer
from ffmap.app.tables import make_table
from ffmap.blueprints.entities import LINE_OUTCOMES
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

WORST = "worst"
_MARKDOWN = re.compile(r"\*\*|`")


def inspect(
    run_path: Path,
    wanted: str,
    line: int | None,
    bag: BagPath | None,
    out: Path | None,
    spawn: bool,
) -> None:
    """Record one scan line by line.

    wanted: number of the scan, or `WORST`. line: the line to open at; None for the worst.
    bag: where the run's bag is now; None for where it was.
    Raises InputError for errors of the user.
    """
    run = open_run(run_path)
    notes: list[str] = []
    if wanted == WORST:
        number, why = find_worst(run)
        notes.append(f"Scan {number} is the worst: {why}.")
    else:
        try:
            number = int(wanted)
        except ValueError:
            raise InputError(f"--scan {wanted}: give a scan's number, or {WORST}") from None
    target = _target(run, out, number)
    inspected = label_again(run, number, bag)
    labelling, faults = inspected.labelling, inspected.faults
    lines = labelling.lines
    if line is not None and not 0 <= line < len(lines):
        raise InputError(
            f"--line {line}: scans of this lidar have lines 0 to {len(lines) - 1} (2 × pair + side)"
        )
    if inspected.lidar is not None:
        notes.append(inspected.lidar)
    notes += [faults_in_words(faults, lines), agreement(run, inspected)]
    reasons = explain_lines(labelling)
    counts = None if faults is None else faults.counts(lines).tolist()
    document = scan_document(f"Scan {number} of {run.name}", notes, labelling, reasons, counts)
    opened = line if line is not None or faults is None else faults.worst_line(lines)
    explained = ExplainedScan(inspected.level, labelling, reasons, faults, document, opened)
    write(target, str(uuid.uuid4()), explained)
    for note in notes:
        typer.echo(_MARKDOWN.sub("", note))
    if line is None:
        if inspected.changes:
            title = "Why the building changed its labels"
            _print(title, CHANGE_HEADINGS, inspected.changes, (2, 3, 4))
        outcomes = [
            (str(sum(reason.outcome == outcome for reason in reasons)), name)
            for outcome, (name, _) in LINE_OUTCOMES.items()
        ]
        _print("Outcomes of its lines", ("lines", "outcome"), outcomes, (1,))
    if opened is not None:
        reason = reasons[opened]
        title = f"{name_of(reason.line)}: {LINE_OUTCOMES[reason.outcome][0]}"
        _print(title, CONDITION_HEADINGS, condition_rows(reason.conditions), (0, 1, 2, 3))
        typer.echo(reason.sentence)
    typer.echo(f"recording: {target}  (open it: ffmap view {target}; move the timeline 'line')")
    if spawn:
        open_viewer(target)


def open_viewer(path: Path) -> None:
    """Raises InputError if no viewer starts."""
    try:
        start_viewer(files=[path])
    except RuntimeError as error:
        raise InputError(f"--spawn: {error} Omit it: {path} can be opened later") from error


def _target(run: FinishedRun, out: Path | None, number: int) -> Path:
    """Return the path of the recording; never a file of a run."""
    path = out or run.path
    if path.is_dir():
        path /= f"inspect-{number}.rrd"
    if path.suffix != ".rrd":
        raise InputError(f"{path}: a recording's name ends in .rrd; give another to --out")
    check_no_run_loses(path)
    require_writable(path.parent, "give another file to --out")
    return path


def _print(
    title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int]
) -> None:
    Console(highlight=False).print(make_table(title, headings, rows, left=left))
