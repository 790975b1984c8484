"""ffmap inspect: evidence for the building of a finished run, or for the labels of one scan."""

import re
import uuid
from collections.abc import Collection, Sequence
from pathlib import Path

import typer
from rich.console import Console
from rich.markdown import Markdown

from ffmap.app.analysis.inspection import (
    CHANGE_HEADINGS,
    InspectedScan,
    agreement,
    faults_in_words,
    find_worst,
    label_again,
    label_counts,
)
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.names import check_no_run_loses, require_writable
from ffmap.app.record.conditions import HEADINGS, NOTE
from ffmap.app.record.inspection import ExplainedScan, write
from ffmap.app.record.line_reasons import (
    LineReason,
    count_outcomes,
    explain_lines,
    name_of,
    scan_document,
)
from ffmap.app.record.read_back import text_of
from ffmap.app.record.return_reasons import SURFACE_HEADINGS, ReturnReasons
from ffmap.app.record.stream import start_viewer
from ffmap.app.record.tables import table
from ffmap.app.tables import make_table
from ffmap.blueprints.entities import LINE_OUTCOMES, REASONS
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

WORST = "worst"
_MARKDOWN = re.compile(r"\*+|`")
_WIDTH = 140


def print_building(run_path: Path) -> None:
    """Print the evidence for walls, doors, windows and refused faces.

    Raises InputError if the run has no recording of its building.
    """
    run = open_run(run_path)
    text = None if run.recording is None else text_of(run.recording, REASONS)
    if text is None:
        raise InputError(
            f"{run.path}: has no recording of its building; run ffmap again with "
            "--outputs +recording"
        )
    _console().print(Markdown(text))


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
        number, why = find_worst(run, bag)
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
    of_returns = ReturnReasons(labelling, inspected.level.placed.points_level)
    opened = line if line is not None or faults is None else faults.worst_line(lines)
    title = f"Scan {number} of {run.name}"
    explained = ExplainedScan(
        level=inspected.level,
        labelling=labelling,
        reasons=reasons,
        final=inspected.final,
        truth=inspected.truth,
        why_changed=inspected.why_changed,
        faults=faults,
        notes=[_returns_in_markdown(inspected, of_returns, own) for own in range(len(lines))],
        document=_document(title, notes, inspected, of_returns, reasons),
        line=opened,
    )
    write(target, str(uuid.uuid4()), explained)
    _print(f"{title}: labels of its returns", *label_counts(inspected), (0, 1))
    for note in notes:
        typer.echo(_MARKDOWN.sub("", note))
    if line is None:
        if inspected.changes:
            title = "Why the building changed its labels"
            _print(title, CHANGE_HEADINGS, inspected.changes, (2, 3, 5, 6), (6,))
        _print("Floor and ceilings", SURFACE_HEADINGS, of_returns.surface_rows, (0,))
        _print("Outcomes of its lines", ("lines", "outcome"), count_outcomes(reasons), (1,))
    if opened is not None:
        reason, own = reasons[opened], lines.of(opened)
        title = f"{name_of(reason.line)}: {LINE_OUTCOMES[reason.outcome][0]}"
        conditions = [own.row for own in reason.conditions]
        _print(title, HEADINGS, conditions, range(6), (5,))
        typer.echo(f"{reason.sentence}\n{_MARKDOWN.sub('', NOTE)}")
        _print("Labels of its returns", *label_counts(inspected, own), (0, 1))
        title = "Why its returns have their labels by the scan (median return)"
        _print(title, ("returns", "label", *HEADINGS), of_returns.rows(own), range(1, 8), (7,))
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


def _returns_in_markdown(inspected: InspectedScan, of_returns: ReturnReasons, line: int) -> str:
    """Return the labels of a line's returns, and why the scan gave them."""
    own = inspected.labelling.lines.of(line)
    if not len(own):
        return ""
    labels, why = table(*label_counts(inspected, own)), of_returns.document(own)
    why_heading = "## Why its returns have their labels by the scan (median return)"
    return "\n\n".join(("## Labels of its returns", labels, why_heading, why))


def _document(
    title: str,
    notes: Sequence[str],
    inspected: InspectedScan,
    of_returns: ReturnReasons,
    reasons: Sequence[LineReason],
) -> str:
    """Return the document on the whole scan."""
    faults, lines = inspected.faults, inspected.labelling.lines
    marked = None if faults is None else faults.counts(lines).tolist()
    parts = [
        *(f"# {title}", table(*label_counts(inspected)), *notes),
        *("## Floor and ceilings", table(SURFACE_HEADINGS, of_returns.surface_rows)),
        *("## Why the scan gave its labels (median return)", of_returns.document(), NOTE),
    ]
    if inspected.changes:
        changes = table(CHANGE_HEADINGS, inspected.changes)
        parts += ["## Why the building changed its labels", changes]
    return "\n\n".join([*parts, scan_document(inspected.labelling, reasons, marked)])


def _print(
    title: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    left: Collection[int],
    whole: Collection[int] = (),
) -> None:
    _console().print(make_table(title, headings, rows, left=left, whole=whole))


def _console() -> Console:
    console = Console(highlight=False)
    if not console.is_terminal:  # of no width that anyone sees
        console.width = max(console.width, _WIDTH)
    return console
