"""ffmap compare: runs side by side in one recording, and what differs between the first and each of the others."""

import math
import string
import tempfile
import uuid
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.truth.changes import CLASS_NAMES, LabelChange, most_frequent, name_transition
from ffmap.app.analysis.comparison import (
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
from ffmap.app.analysis.run_labels import LabelSource
from ffmap.app.commands.inspect import open_viewer
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.names import check_no_run_loses, make_writable
from ffmap.app.progress import Progress
from ffmap.app.record.comparison import ComparisonRecorder, TransitionStyle, log_changed_points, write_rerooted
from ffmap.app.record.read_back import readable, rows
from ffmap.app.record.stream import join, open_part
from ffmap.blueprints import compare as compare_blueprint
from ffmap.blueprints import entities
from ffmap.blueprints.compare import ComparedRun
from ffmap.blueprints.run import view_of
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import read_tum

RECORDING = "comparison.rrd"
_TRANSITIONS_SHOWN = 6
_UNFINISHED = {
    "running": "is still running",
    "killed": "was killed, 'ffmap run --resume {}' goes on with it",
    "aborted": "was aborted, 'ffmap run --resume {}' goes on with it",
}
_UNKNOWN = "does not say whether it came to its end"
_HEADLINES = (
    *(f"area.{name}.f1" for name in ("ceiling", "floor", "wall", "door", "clutter", "outside")),
    *("area_scan.wall.f1", "area.outside_kept_as_structure", "doors.found", "doors.invented", "doors.width_error_m"),
    *("wall_map.precision", "wall_map.recall", "wall_map.error_m", "trajectory.ate_rmse_m"),
    *("counts.scans", "counts.walls", "counts.doors", "seconds.total"),
)


@dataclass(frozen=True)
class Comparison:
    """The first run against each of the others, and what was to be said on the way."""

    runs: tuple[RunToCompare, ...]
    changes: tuple[PairChange, ...]
    settings: dict[str, list[Any]]
    provenance: dict[str, list[Any]]
    figures: dict[str, list[float | None]]
    warnings: tuple[str, ...]


def compare(paths: Sequence[Path], out: Path | None, scans: bool, spawn: bool, quiet: bool) -> None:
    """Compare runs; raises InputError for what the user can mend.

    out: a folder for both files, or the recording's name. scans: with single scans side by side.
    """
    if len(paths) < 2:
        raise InputError("give two run folders or more; 'ffmap compare --help' has examples")
    if len(paths) > len(string.ascii_uppercase):
        raise InputError(f"{len(paths)} runs are too many to look at; give at most {len(string.ascii_uppercase)}")
    found = [open_run(path) for path in paths]
    recording, report = _targets(found, out)
    with ExitStack() as stack, Progress(quiet) as progress:
        spool = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="comparison-", dir=recording.parent)))
        warnings: list[str] = []
        runs = tuple(
            _readable(letter, run, stack, warnings) for letter, run in zip(string.ascii_uppercase, found, strict=False)
        )
        for warning in warnings:
            progress.warn(warning)
        comparison = _record(runs, recording, spool, scans, progress, warnings)
    write_json(report, as_json(comparison))
    if not quiet:
        _print(comparison)
        typer.echo(f"figures:   {report}")
        typer.echo(f"recording: {recording}  (open it: ffmap view {recording})")
    if spawn:
        open_viewer(recording)


def _targets(runs: Sequence[FinishedRun], out: Path | None) -> tuple[Path, Path]:
    """Where the recording and the report are written; never over what a run made."""
    path = Path("comparison-" + "-".join(run.name for run in runs)[:100]) if out is None else out
    recording = path if path.suffix == ".rrd" and not path.is_dir() else path / RECORDING
    for run in runs:
        if recording.resolve().parent == run.path.resolve() and recording.name != RECORDING:
            raise InputError(f"{recording}: lies among the files of a run; give another place to --out")
    check_no_run_loses(recording)
    try:
        make_writable(recording.parent)
    except OSError as error:
        raise InputError(f"{recording}: cannot be written ({error.strerror}); give another place to --out") from error
    return recording, recording.with_suffix(".json")


def _readable(letter: str, run: FinishedRun, stack: ExitStack, warnings: list[str]) -> RunToCompare:
    """The run with its recording, if it has one that can be read, and with what has its labels."""
    if not run.complete:
        warnings.append(
            f"{letter}, {run.name}: {_UNFINISHED.get(run.outcome, _UNKNOWN).format(run.path)}; what it has is compared"
        )
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
    source = LabelSource(run, recording)
    return RunToCompare(letter, run, recording, source.file if source.has_labels() else None)


def _record(
    runs: tuple[RunToCompare, ...], out: Path, spool: Path, scans: bool, progress: Progress, warnings: list[str]
) -> Comparison:
    """Compare, and write the recording while doing so."""
    first, *others = runs
    recording_id = str(uuid.uuid4())
    parts: list[Path] = []
    changes: list[PairChange] = []
    scan_of: dict[int, int] = {}
    for other in others:
        change = PairChange(a=first, b=other)
        if labels_can_be_compared(change):
            progress.stage(f"{first.letter} – {other.letter}", None)
            comparing = LabelComparison(first, other)
            part = spool / f"changes-{other.letter}.rrd"
            with open_part(part, recording_id) as stream:
                for changed in comparing:
                    log_changed_points(stream, other.letter, changed)
                    scan_of[changed.stamp_ns] = changed.scan
                    progress.advance()
            change.labels = comparing.result()
            if change.labels.scans:
                parts.append(part)
            else:
                change.labels, change.refused["labels"] = None, "the runs have no cloud in common"
        compare_files(change)
        changes.append(change)
    for run in runs:
        if run.recording is not None and not scan_of:
            scan_of |= {row.stamp_ns: row.scan for row in rows(run.recording.path, entities.TRAJECTORY)}
    comparison = Comparison(
        runs,
        tuple(changes),
        differing_settings([run.run for run in runs]),
        differing_provenance([run.run for run in runs]),
        figures([run.run for run in runs]),
        tuple(warnings),
    )
    progress.stage("side by side", len(runs))
    of_pair = {change.b.letter: change for change in changes}
    shown = []
    for run in runs:
        part = spool / f"run-{run.letter}.rrd"
        if run.recording is not None and write_rerooted(run.recording.path, run.letter, part, recording_id, scans):
            parts.append(part)
        has_scans = run.recording is not None and run.run.has_scans
        shown.append(
            ComparedRun(
                run.letter,
                run.title,
                scans and has_scans,
                run.recording is not None,
                frozenset(of_pair[run.letter].compared) if run.letter in of_pair else frozenset(),
                frozenset(of_pair[run.letter].differing) if run.letter in of_pair else frozenset(),
            )
        )
        progress.advance()
    parts.insert(0, _write_findings(comparison, scan_of, spool, recording_id))
    parts.insert(0, _write_layout(comparison, shown, scan_of, spool, recording_id))
    join(parts, out)
    return comparison


def _write_layout(
    comparison: Comparison, shown: Sequence[ComparedRun], scan_of: dict[int, int], spool: Path, recording_id: str
) -> Path:
    part = spool / "layout.rrd"
    centre_m, extent_m = view_of(*(grid_of(run.run) for run in comparison.runs))
    letter, scan = _most_changed(comparison.changes, scan_of)
    numbers = scan_of.values()
    scans = (min(numbers), max(numbers)) if numbers else None
    with open_part(part, recording_id) as stream:
        layout = compare_blueprint.build(shown, centre_m, extent_m, scan, letter, scans)
        stream.send_blueprint(layout, make_active=True, make_default=True)
    return part


def _most_changed(changes: Sequence[PairChange], scan_of: dict[int, int]) -> tuple[str | None, int | None]:
    """The run and the scan that tell most: by labels, else by poses; None where nothing differs by scans."""
    worst = [(c.labels.worst, c.b.letter) for c in changes if c.labels is not None]
    by_labels = [(scan.changed, letter, scan.scan) for scan, letter in worst if scan is not None]
    by_poses = [
        (float(moved[k]), c.b.letter, scan_of.get(int(c.trajectory.stamp_ns[k])))
        for c in changes
        if c.trajectory is not None
        for moved in [c.trajectory.figures.error_unaligned_m]
        for k in [int(np.argmax(moved))]
        if moved[k] > _MOVED_M
    ]
    for found in (by_labels, by_poses):
        if found:
            _, letter, scan = max(found, key=lambda candidate: candidate[0])
            return letter, scan
    return None, None


def _write_findings(comparison: Comparison, scan_of: dict[int, int], spool: Path, recording_id: str) -> Path:
    part = spool / "findings.rrd"
    with open_part(part, recording_id) as stream:
        stream.send_recording_name(" – ".join(run.run.name for run in comparison.runs))
        style = TransitionStyle.of([c.labels for c in comparison.changes if c.labels is not None])
        recorder = ComparisonRecorder(stream, style)
        recorder.log_common(_runs_document(comparison))
        # Only runs of the same bag have a map frame in common.
        apart = {change.b.letter for change in comparison.changes if not change.same_bag}
        for k, run in enumerate(comparison.runs):
            if run.letter in apart:
                continue
            recorder.log_run(
                run.letter, entities.RUN_COLORS[k % len(entities.RUN_COLORS)], _path_of(run.run), grid_of(run.run)
            )
        for change in comparison.changes:
            recorder.log_pair(change.b.letter, change, _pair_document(change, comparison), scan_of)
    return part


def _path_of(run: FinishedRun) -> FloatArray | None:
    return read_tum(run.trajectory).T_map_base[:, :3, 3] if run.trajectory is not None else None


# --- in words ---


_MOVED_M = 1e-6
"""What is less is the arithmetic's."""
_UNDER = "  ↳ "
"""Begins a row that tells a part of the one above it."""


def _summary(change: PairChange) -> list[tuple[str, str]]:
    """What differs between two runs: what, and how much."""
    found = _labels_summary(change, change.labels) if change.labels is not None else []
    if change.planes is not None:
        lost, gained = int(change.planes.lost.sum()), int(change.planes.gained.sum())
        found.append(("wall planes of single scans", f"{lost} lost, {gained} gained"))
    if change.trajectory is not None:
        moved = change.trajectory.figures.error_unaligned_m
        found.append(("distance of the poses", f"mean {_cm(float(moved.mean()))}, largest {_cm(float(moved.max()))}"))
    if change.walls is not None:
        found.append(
            (
                "wall faces",
                f"{change.walls.lost_m:.2f} m lost, {change.walls.gained_m:.2f} m gained, of "
                f"{change.walls.length_a_m:.1f} m",
            )
        )
    if change.doors is not None:
        doors = change.doors
        found.append(
            (
                "doors",
                f"{len(doors.change.lost)} lost, {len(doors.change.gained)} gained, {len(doors.altered)} altered, of "
                f"{len(doors.before)}",
            )
        )
        found += [(f"{_UNDER}door {i} → {j}", what) for i, j, what in doors.altered]
    if change.grid is not None:
        grid = change.grid
        found.append(
            (
                "occupied map cells",
                f"{len(grid.lost)} lost, {len(grid.gained)} gained, of {grid.kept + len(grid.lost)}",
            )
        )
        found.append(("free map cells", f"{grid.blocked} lost, {grid.freed} gained"))
    return found


def _labels_summary(change: PairChange, labels: LabelChange) -> list[tuple[str, str]]:
    """The labels that differ, and below them which became which, and in which scan they are most."""
    kind = "labels changed" if labels.final else "labels of single scans changed (not both runs have final ones)"
    found = [(kind, f"{labels.changed:,} of {labels.points:,} ({_share(labels.changed, labels.points)})")]
    total = labels.confusion
    for code in most_frequent([labels], _TRANSITIONS_SHOWN):
        found.append((f"{_UNDER}{name_transition(code)}", f"{int(total.flat[code]):,}"))
    worst = labels.worst
    if worst is not None:
        most = f"{worst.changed:,} ({_share(worst.changed, worst.points)})"
        found.append((f"{_UNDER}most of all in scan {worst.scan}", most))
    if labels.final:
        found.append(
            (
                "labels of single scans changed",
                f"{labels.changed_scan:,} ({_share(labels.changed_scan, labels.points)})",
            )
        )
    found.append(("scans compared", str(len(labels.scans))))
    for count, what in (
        (labels.only_a, f"scans in {change.a.letter} alone"),
        (labels.only_b, f"scans in {change.b.letter} alone"),
        (labels.unlike, "scans of different size, left out"),
    ):
        if count:
            found.append((what, str(count)))
    return found


def _headline(change: PairChange) -> str:
    """The answer in a sentence."""
    labels = change.labels
    if labels is None:
        return f"Labels cannot be compared: {change.refused.get('labels', 'none are there')}."
    kind = "labels" if labels.final else "labels of single scans"
    if not labels.changed:
        return f"No {kind} differ, in {labels.points:,} points of {len(labels.scans)} scans."
    worst, (most, *_) = labels.worst, most_frequent([labels], 1)
    assert worst is not None
    return (
        f"{_share(labels.changed, labels.points)} of the {kind} changed ({labels.changed:,} points), most often "
        f"{name_transition(most)}, and most in scan {worst.scan}."
    )


def _headlines(comparison: Comparison) -> dict[str, list[float | None]]:
    return {name: comparison.figures[name] for name in _HEADLINES if name in comparison.figures}


def _pair_document(change: PairChange, comparison: Comparison) -> str:
    a, b = (comparison.runs.index(run) for run in (change.a, change.b))
    parts = [f"# {change.b.letter} against {change.a.letter}", ""]
    parts.append(f"**{change.a.letter}** is `{change.a.run.name}`, **{change.b.letter}** is `{change.b.run.name}`.")
    parts += ["", f"**{_headline(change)}**", ""]
    settings = {name: values for name, values in comparison.settings.items() if values[a] != values[b]}
    if settings:
        parts += ["## Settings that differ", f"| setting | {change.a.letter} | {change.b.letter} |", "|---|---|---|"]
        parts += [f"| {name} | {_text(values[a])} | {_text(values[b])} |" for name, values in settings.items()]
    else:
        parts.append("Their settings are the same.")
    if summary := _summary(change):
        parts += ["", "## What differs", "| what | how much |", "|---|---|"]
        parts += [f"| {what} | {how_much} |" for what, how_much in summary]
    if change.refused:
        parts += ["", "## What could not be compared"]
        parts += [f"- {what}: {why}" for what, why in change.reasons.items()]
    headlines = {n: v for n, v in _headlines(comparison).items() if v[a] != v[b] and not n.startswith("seconds")}
    if headlines:
        parts += [
            "",
            "## Figures that differ",
            f"| figure | {change.a.letter} | {change.b.letter} | |",
            "|---|---|---|---|",
        ]
        parts += [
            f"| {n} | {_figure(v[a])} | {_figure(v[b])} | {_difference(v[a], v[b])} |" for n, v in headlines.items()
        ]
    if change.labels is not None:
        parts += ["", f"## Labels: rows {change.a.letter}, columns {change.b.letter}"]
        parts += ["| | " + " | ".join(CLASS_NAMES) + " |", "|---" * (len(CLASS_NAMES) + 1) + "|"]
        parts += [
            f"| **{name}** | " + " | ".join(f"{count:,}" for count in row) + " |"
            for name, row in zip(CLASS_NAMES, change.labels.confusion.tolist(), strict=True)
        ]
    return "\n".join(parts)


def _runs_document(comparison: Comparison) -> str:
    letters = [run.letter for run in comparison.runs]
    head, rule = " | ".join(letters), "|---" * (len(letters) + 1) + "|"
    parts = ["# The runs", "| | folder | outcome | bag |", "|---|---|---|---|"]
    parts += [
        f"| **{run.letter}** | {run.run.name} | {run.run.outcome} | {run.run.part('bag').get('path', '–')} |"
        for run in comparison.runs
    ]
    parts += ["", *(f"- {warning}" for warning in comparison.warnings)]
    for title, table in (
        ("Settings that differ", comparison.settings),
        ("What else they were made with, as far as it differs", comparison.provenance),
    ):
        if table:
            parts += ["", f"## {title}", f"| | {head} |", rule]
            parts += [f"| {n} | " + " | ".join(_text(v) for v in values) + " |" for n, values in table.items()]
    if comparison.figures:
        parts += ["", "## All figures", f"| | {head} |", rule]
        parts += [f"| {n} | " + " | ".join(map(_figure, values)) + " |" for n, values in comparison.figures.items()]
    return "\n".join(parts)


def _print(comparison: Comparison) -> None:
    console = Console(highlight=False)
    letters = [run.letter for run in comparison.runs]
    table = Table(title="Runs", title_justify="left")
    for heading in ("", "folder", "outcome", "labels from", "bag"):
        table.add_column(heading, overflow="fold")
    for run in comparison.runs:
        bag = run.run.bag_path
        table.add_row(run.letter, str(run.run.path), run.run.outcome, run.labels_from or "–", bag.name if bag else "–")
    console.print(table)
    if comparison.settings:
        table = Table(title="Settings that differ", title_justify="left")
        table.add_column("setting", overflow="fold")
        for letter in letters:
            table.add_column(letter)
        for name, values in comparison.settings.items():
            table.add_row(name, *map(_text, values))
        console.print(table)
    else:
        console.print("Settings: all the same.")
    for change in comparison.changes:
        table = Table(title=f"{change.b.letter} against {change.a.letter}", title_justify="left", show_header=False)
        for what, how_much in _summary(change):
            table.add_row(what, how_much)
        for what, why in change.reasons.items():
            table.add_row(f"{what}: not compared", why)
        console.print(table)
    _print_figures(console, comparison, letters)


def _print_figures(console: Console, comparison: Comparison, letters: Sequence[str]) -> None:
    headlines = _headlines(comparison)
    if not headlines:
        return
    table = Table(title="Figures", title_justify="left")
    table.add_column("figure", overflow="fold")
    for letter in letters:
        table.add_column(letter, justify="right")
    for letter in letters[1:]:
        table.add_column(f"{letter} − {letters[0]}", justify="right")
    for name, values in headlines.items():
        table.add_row(name, *map(_figure, values), *(_difference(values[0], value) for value in values[1:]))
    console.print(table)


def as_json(comparison: Comparison) -> dict[str, Any]:
    """What comparison.json holds.

    labels.confusion and label_scan rows and columns are in the order of `classes`; figures have one value a run, and
    their differences to the first.
    """
    return {
        "classes": list(CLASS_NAMES),
        "runs": [
            {
                "letter": run.letter,
                "path": str(run.run.path.resolve()),
                "outcome": run.run.outcome,
                "recording_id": run.run.record.get("recording_id"),
                "bag": dict(run.run.part("bag")),
                "versions": dict(run.run.part("versions")),
                "labels_from": run.labels_from,
            }
            for run in comparison.runs
        ],
        "warnings": list(comparison.warnings),
        "settings": _by_letter(comparison.runs, comparison.settings),
        "provenance": _by_letter(comparison.runs, comparison.provenance),
        "figures": {
            name: {
                **{run.letter: value for run, value in zip(comparison.runs, values, strict=True)},
                "differences": [
                    None if values[0] is None or value is None else value - values[0] for value in values[1:]
                ],
            }
            for name, values in comparison.figures.items()
        },
        "comparisons": [_pair_json(change) for change in comparison.changes],
    }


def _pair_json(change: PairChange) -> dict[str, Any]:
    content: dict[str, Any] = {
        "a": change.a.letter,
        "b": change.b.letter,
        "compared": change.compared,
        "not_compared": change.refused,
    }
    if (labels := change.labels) is not None:
        content["labels"] = {
            "final": labels.final,
            "points": labels.points,
            "changed": labels.changed,
            "changed_share": labels.changed / labels.points if labels.points else None,
            "changed_label_scan": labels.changed_scan,
            "confusion": labels.confusion.tolist(),
            "transitions": {
                name_transition(code): int(labels.confusion.flat[code])
                for code in most_frequent([labels], len(CLASS_NAMES) ** 2)
            },
            "scans_in_a_alone": labels.only_a,
            "scans_in_b_alone": labels.only_b,
            "scans_of_different_size": labels.unlike,
            "scans": [
                {
                    "scan": s.scan,
                    "stamp_ns": s.stamp_ns,
                    "points": s.points,
                    "changed": s.changed,
                    "changed_label_scan": s.changed_scan,
                }
                for s in labels.scans
            ],
        }
    if (planes := change.planes) is not None:
        content["planes"] = {"lost": int(planes.lost.sum()), "gained": int(planes.gained.sum())}
    if (trajectory := change.trajectory) is not None:
        moved, aligned = trajectory.figures.error_unaligned_m, trajectory.figures.error_m
        content["trajectory"] = {
            "poses": len(moved),
            "mean_m": float(moved.mean()),
            "max_m": float(moved.max()),
            "aligned_mean_m": float(aligned.mean()),
            "aligned_max_m": float(aligned.max()),
        }
    if (walls := change.walls) is not None:
        content["walls"] = {
            "length_a_m": walls.length_a_m,
            "length_b_m": walls.length_b_m,
            "lost_m": walls.lost_m,
            "gained_m": walls.gained_m,
            "lost": walls.lost,
            "gained": walls.gained,
        }
    if (doors := change.doors) is not None:
        content["doors"] = {
            "lost": [doors.before[i] for i in doors.change.lost],
            "gained": [doors.after[j] for j in doors.change.gained],
            "altered": [{"a": i, "b": j, "what": what} for i, j, what in doors.altered],
        }
    if (grid := change.grid) is not None:
        content["grid"] = {
            "occupied_lost": len(grid.lost),
            "occupied_gained": len(grid.gained),
            "occupied_kept": grid.kept,
            "free_lost": grid.blocked,
            "free_gained": grid.freed,
        }
    return content


def _by_letter(runs: Sequence[RunToCompare], table: dict[str, list[Any]]) -> dict[str, dict[str, Any]]:
    return {
        name: {run.letter: value for run, value in zip(runs, values, strict=True)} for name, values in table.items()
    }


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f} %" if whole else "–"


def _cm(metres: float) -> str:
    return f"{100 * metres:.1f} cm"


def _text(value: object) -> str:
    return "–" if value is None else str(value)


def _figure(value: float | None) -> str:
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:,.0f}" if float(value).is_integer() and abs(value) > 1 else f"{value:.4f}"


def _difference(first: float | None, second: float | None) -> str:
    if first is None or second is None:
        return "–"
    if math.isclose(first, second, rel_tol=1e-9):
        # Sums that were taken in another order differ in their last bits.
        return "="
    whole = float(first).is_integer() and float(second).is_integer() and max(abs(first), abs(second)) > 1
    if whole:
        return f"{second - first:+,.0f}"
    # What is less than the last digit is told by its size.
    return f"{second - first:+.4f}" if abs(second - first) >= 5e-5 else f"{second - first:+.0e}"
