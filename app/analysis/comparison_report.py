"""What a comparison of runs found: in words for the terminal and the recording, in figures for comparison.json."""

import math
from collections.abc import Sequence
from typing import Any

from ffmap.algorithms.truth.changes import CLASS_NAMES, LabelChange, most_frequent, name_transition
from ffmap.app.analysis.comparison import Comparison, PairChange
from ffmap.app.tables import markdown_table

MOVED_M = 1e-6
"""Distances of poses below this are rounding errors."""
_TRANSITIONS_SHOWN = 6
_UNDER = "  ↳ "
"""Begins a row that is a part of the one above it."""
_HEADLINES = (
    *(f"area.{name}.f1" for name in ("ceiling", "floor", "wall", "door", "clutter", "outside")),
    *("area_scan.wall.f1", "area.outside_kept_as_structure", "doors.found", "doors.invented", "doors.width_error_m"),
    *("wall_map.precision", "wall_map.recall", "wall_map.error_m", "trajectory.ate_rmse_m"),
    *("counts.scans", "counts.walls", "counts.doors", "seconds.total"),
)


def headlines(comparison: Comparison) -> dict[str, list[float | None]]:
    """The figures that a person asks for first, as far as the runs have them."""
    return {name: comparison.figures[name] for name in _HEADLINES if name in comparison.figures}


def summary(change: PairChange) -> list[tuple[str, str]]:
    """What differs between two runs: what, and how much."""
    rows = _labels_summary(change, change.labels) if change.labels is not None else []
    if (planes := change.planes) is not None:
        rows.append(("wall planes of single scans", f"{planes.lost.sum()} lost, {planes.gained.sum()} gained"))
    if change.trajectory is not None:
        moved_cm = 100 * change.trajectory.figures.error_unaligned_m
        rows.append(("distance of the poses", f"mean {moved_cm.mean():.1f} cm, largest {moved_cm.max():.1f} cm"))
    if (walls := change.walls) is not None:
        lengths = f"{walls.lost_m:.2f} m lost, {walls.gained_m:.2f} m gained, of {walls.length_a_m:.1f} m"
        rows.append(("wall faces", lengths))
    if (doors := change.doors) is not None:
        lost, gained, altered = len(doors.change.lost), len(doors.change.gained), doors.altered
        rows.append(("doors", f"{lost} lost, {gained} gained, {len(altered)} altered, of {len(doors.before)}"))
        rows += [(f"{_UNDER}door {i} → {j}", what) for i, j, what in altered]
    if (grid := change.grid) is not None:
        lost, gained = len(grid.lost), len(grid.gained)
        rows.append(("occupied map cells", f"{lost} lost, {gained} gained, of {grid.kept + lost}"))
        rows.append(("free map cells", f"{grid.blocked} lost, {grid.freed} gained"))
    return rows


def _labels_summary(change: PairChange, labels: LabelChange) -> list[tuple[str, str]]:
    """The labels that differ, and below them which became which, and in which scan they are most."""
    changed = f"{labels.changed:,} of {labels.points:,} ({_share(labels.changed, labels.points)})"
    rows = [("labels changed", changed)]
    total = labels.confusion
    for code in most_frequent([labels], _TRANSITIONS_SHOWN):
        rows.append((f"{_UNDER}{name_transition(code)}", f"{total.flat[code]:,}"))
    if (worst := labels.worst) is not None:
        most = f"{worst.changed:,} ({_share(worst.changed, worst.points)})"
        rows.append((f"{_UNDER}most of all in scan {worst.scan}", most))
    changed = f"{labels.changed_scan:,} ({_share(labels.changed_scan, labels.points)})"
    rows.append(("labels of single scans changed", changed))
    rows.append(("scans compared", str(len(labels.scans))))
    left_out = {
        f"scans in {change.a.letter} alone": labels.only_a,
        f"scans in {change.b.letter} alone": labels.only_b,
        "scans of different size, left out": labels.unlike,
    }
    return rows + [(what, str(count)) for what, count in left_out.items() if count]


def _headline(change: PairChange) -> str:
    """The answer in a sentence."""
    labels = change.labels
    if labels is None:
        return f"Labels cannot be compared: {change.refused.get('labels', 'none are there')}."
    worst = labels.worst
    if worst is None:
        return f"No labels differ, in {labels.points:,} points of {len(labels.scans)} scans."
    return (
        f"{_share(labels.changed, labels.points)} of the labels changed ({labels.changed:,} points), most often "
        f"{name_transition(most_frequent([labels], 1)[0])}, and most in scan {worst.scan}."
    )


def pair_document(change: PairChange, comparison: Comparison) -> str:
    """What differs between the first run and one of the others, in Markdown."""
    a, b = change.a.letter, change.b.letter
    first, second = (comparison.runs.index(run) for run in (change.a, change.b))
    parts = [f"# {b} against {a}", "", f"**{a}** is `{change.a.run.name}`, **{b}** is `{change.b.run.name}`."]
    parts += ["", f"**{_headline(change)}**", ""]
    settings = {name: (v[first], v[second]) for name, v in comparison.settings.items() if v[first] != v[second]}
    if settings:
        rows = ([name, *map(text_of, pair)] for name, pair in settings.items())
        parts += ["## Settings that differ", *markdown_table(["setting", a, b], rows)]
    else:
        parts.append("Their settings are the same.")
    if found := summary(change):
        parts += ["", "## What differs", *markdown_table(["what", "how much"], found)]
    if change.refused:
        parts += ["", "## What could not be compared", *(f"- {what}: {why}" for what, why in change.reasons.items())]
    figures = {
        name: (v[first], v[second])
        for name, v in headlines(comparison).items()
        if v[first] != v[second] and not name.startswith("seconds")
    }
    if figures:
        rows = ([name, *map(figure_of, pair), difference_of(*pair)] for name, pair in figures.items())
        parts += ["", "## Figures that differ", *markdown_table(["figure", a, b, ""], rows)]
    if change.labels is not None:
        counts = zip(CLASS_NAMES, change.labels.confusion.tolist(), strict=True)
        rows = ([f"**{name}**", *(f"{count:,}" for count in row)] for name, row in counts)
        parts += ["", f"## Labels: rows {a}, columns {b}", *markdown_table(["", *CLASS_NAMES], rows)]
    return "\n".join(parts)


def runs_document(comparison: Comparison) -> str:
    """Which runs were compared, what they were made with, and all their figures, in Markdown."""
    rows = [[f"**{r.letter}**", r.run.name, r.run.outcome, str(r.run.bag_path or "–")] for r in comparison.runs]
    parts = ["# The runs", *markdown_table(["", "folder", "outcome", "bag"], rows)]
    parts += ["", *(f"- {warning}" for warning in comparison.warnings)]
    for title, table, in_words in (
        ("Settings that differ", comparison.settings, text_of),
        ("What else they were made with, as far as it differs", comparison.provenance, text_of),
        ("All figures", comparison.figures, figure_of),
    ):
        if table:
            rows = [[name, *map(in_words, values)] for name, values in table.items()]
            parts += ["", f"## {title}", *markdown_table(["", *(run.letter for run in comparison.runs)], rows)]
    return "\n".join(parts)


def as_json(comparison: Comparison) -> dict[str, Any]:
    """What comparison.json holds.

    labels.confusion: rows (first run) and columns in the order of `classes`. differences of figures: to the first run.
    """

    def by_letter(values: Sequence[Any]) -> dict[str, Any]:
        return {run.letter: value for run, value in zip(comparison.runs, values, strict=True)}

    def differences(values: Sequence[float | None]) -> list[float | None]:
        first, *others = values
        return [None if first is None or value is None else value - first for value in others]

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
            }
            for run in comparison.runs
        ],
        "warnings": list(comparison.warnings),
        "settings": {name: by_letter(values) for name, values in comparison.settings.items()},
        "provenance": {name: by_letter(values) for name, values in comparison.provenance.items()},
        "figures": {
            name: {**by_letter(values), "differences": differences(values)}
            for name, values in comparison.figures.items()
        },
        "comparisons": [_pair_json(change) for change in comparison.changes],
    }


def _pair_json(change: PairChange) -> dict[str, Any]:
    content = {
        "a": change.a.letter,
        "b": change.b.letter,
        "compared": change.compared,
        "not_compared": change.refused,
    }
    if change.labels is not None:
        content["labels"] = _labels_json(change.labels)
    if (planes := change.planes) is not None:
        content["planes"] = {"lost": int(planes.lost.sum()), "gained": int(planes.gained.sum())}
    if change.trajectory is not None:
        moved, aligned = change.trajectory.figures.error_unaligned_m, change.trajectory.figures.error_m
        content["trajectory"] = {
            "poses": len(moved),
            "mean_m": float(moved.mean()),
            "max_m": float(moved.max()),
            "aligned_mean_m": float(aligned.mean()),
            "aligned_max_m": float(aligned.max()),
        }
    if change.walls is not None:
        names = ("length_a_m", "length_b_m", "lost_m", "gained_m", "lost", "gained")
        content["walls"] = {name: getattr(change.walls, name) for name in names}
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


def _labels_json(labels: LabelChange) -> dict[str, Any]:
    confusion, all_transitions = labels.confusion, most_frequent([labels], len(CLASS_NAMES) ** 2)
    return {
        "points": labels.points,
        "changed": labels.changed,
        "changed_share": labels.changed / labels.points if labels.points else None,
        "changed_label_scan": labels.changed_scan,
        "confusion": confusion.tolist(),
        "transitions": {name_transition(code): int(confusion.flat[code]) for code in all_transitions},
        "scans_in_a_alone": labels.only_a,
        "scans_in_b_alone": labels.only_b,
        "scans_of_different_size": labels.unlike,
        "scans": [
            {name: getattr(scan, name) for name in ("scan", "stamp_ns", "points", "changed")}
            | {"changed_label_scan": scan.changed_scan}
            for scan in labels.scans
        ],
    }


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f} %" if whole else "–"


def text_of(value: object) -> str:
    return "–" if value is None else str(value)


def figure_of(value: float | None) -> str:
    """A figure in a table: counts whole, anything else with four decimals."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:,.0f}" if float(value).is_integer() and abs(value) > 1 else f"{value:.4f}"


def difference_of(first: float | None, second: float | None) -> str:
    """What a figure of one run is more than that of the first, in a table."""
    if first is None or second is None:
        return "–"
    if math.isclose(first, second, rel_tol=1e-9):
        # Sums that were taken in another order differ in their last bits.
        return "="
    if float(first).is_integer() and float(second).is_integer() and max(abs(first), abs(second)) > 1:
        return f"{second - first:+,.0f}"
    # What is less than the last digit is told by its size.
    return f"{second - first:+.4f}" if abs(second - first) >= 5e-5 else f"{second - first:+.0e}"
