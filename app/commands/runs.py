"""ffmap runs: a table of the runs in a folder, sorted and filtered by figures and settings."""

import operator
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from ffmap.app.analysis.figures import FIGURES, HEADLINES, find_name, read_figures
from ffmap.app.folder.names import RUN_JSON
from ffmap.app.folder.record import read_record
from ffmap.app.tables import format_value, make_table
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.text_files import dotted_keys

_DEPTH = 3
"""Levels of folders below the given one in which runs are found."""
_WIDE = 10_000
"""Width of a table in a pipe or a file, so that each run is one whole line."""
_DETAILS = ("bag", "git_revision", "outcome")
"""Shown by default where the runs differ in them."""
_ADVICE = "--columns all lists them"
_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
}


@dataclass(frozen=True)
class ListedRun:
    """A run folder with its figures, settings and details by name."""

    folder: Path
    values: Mapping[str, Any]
    settings: Mapping[str, Any]


def runs(
    root: Path, where: Sequence[str], sort: str | None, reverse: bool, columns: str | None
) -> None:
    """Print the runs in a folder.

    Args:
        where: conditions like "wall.f1>0.98"; a run is listed if all hold.
        sort: column; best first for a figure, least first for other columns.
        columns: names separated by commas; "all" lists the names.

    Raises InputError if there is no run, or a column or condition is wrong.
    """
    listed = list(_read(find_runs(root)))
    if not listed:
        raise InputError(f"{root}: no run has a readable {RUN_JSON}; run ffmap again")
    known = list(dict.fromkeys(name for run in listed for name in run.values))
    if columns == "all":
        typer.echo("\n".join(sorted(known)))
        return
    for condition in where:
        listed = [run for run in listed if _holds(condition, known, run.values)]
    if sort is not None:
        sort = find_name(sort, known, "--sort", _ADVICE)
        listed = _sorted(listed, sort, reverse)
    if columns is None:
        chosen = _usual_columns(listed, sort)
    else:
        names = columns.split(",")
        chosen = [find_name(name.strip(), known, "--columns", _ADVICE) for name in names]
    _print(listed, chosen, root.resolve(), all_columns=columns is not None)


def find_runs(root: Path) -> list[Path]:
    """Return the run folders in a folder, or the folder itself; links are ignored.

    Raises InputError if the folder has no run.
    """
    if not root.is_dir():
        raise InputError(f"{root}: is no folder; give a folder of runs")
    found = []
    for folder, inner, files in os.walk(root):
        if RUN_JSON in files:
            found.append(Path(folder))
        if RUN_JSON in files or len(Path(folder).relative_to(root).parts) == _DEPTH:
            inner.clear()
    if not found:
        raise InputError(f"{root}: holds no runs; 'ffmap run' and 'ffmap sweep' make some")
    return sorted(found)


def _read(folders: Sequence[Path]) -> Iterator[ListedRun]:
    """Read the runs; print a line for each one that cannot be read."""
    for folder in folders:
        try:
            record = read_record(folder)
            figures = read_figures(folder, record)
        except InputError as error:
            typer.echo(f"not listed: {error}", err=True)
            continue
        settings = dotted_keys(record.settings)
        details = {
            "bag": Path(record.bag.path or "").name,
            "git_revision": record.versions.get("git_revision"),
            **record.as_json("outcome", "started", "settings_hash"),
        }
        yield ListedRun(folder, {**figures, **settings, **details}, settings)


def _holds(condition: str, known: Sequence[str], values: Mapping[str, Any]) -> bool:
    """Return whether a condition like "wall.f1>0.98" or "bag=office.bag" holds.

    A run without a value does not meet it. Raises InputError if it is no condition.
    """
    parts = re.fullmatch(r"\s*([\w.]+)\s*(>=|<=|!=|>|<|=)\s*(\S.*?)\s*", condition)
    if parts is None:
        raise InputError(
            f'--where {shortened(condition)}: is no condition; write it as in "wall.f1>0.98"'
        )
    column = find_name(parts[1], known, "--where", _ADVICE)
    own, compare, limit = values.get(column), _COMPARISONS[parts[2]], parts[3]
    if own is None:
        return False
    if isinstance(own, bool) or not isinstance(own, int | float):
        return compare(str(own).lower(), limit.lower())
    try:
        return compare(own, float(limit))
    except ValueError:
        raise InputError(
            f"--where {shortened(condition)}: {column} is a number; compare it with one"
        ) from None


def _sorted(listed: Sequence[ListedRun], column: str, reverse: bool) -> list[ListedRun]:
    """Sort by a column; runs without a value come last."""
    known = [run for run in listed if run.values.get(column) is not None]
    unknown = [run for run in listed if run.values.get(column) is None]
    numbers = all(isinstance(run.values[column], int | float) for run in known)

    def key(run: ListedRun) -> Any:  # noqa: ANN401 - numbers or text
        return run.values[column] if numbers else str(run.values[column])

    highest_first = column in FIGURES and FIGURES[column].better == "higher"
    return sorted(known, key=key, reverse=highest_first != reverse) + unknown


def _usual_columns(listed: Sequence[ListedRun], sort: str | None) -> list[str]:
    """The column that is sorted by, two figures, the settings that differ, then more figures."""
    settings = dict.fromkeys(name for run in listed for name in run.settings)
    differing = [
        name
        for name in (*settings, *_DETAILS)
        if len({str(run.values.get(name)) for run in listed}) > 1
    ]
    first = [sort] if sort is not None else []
    names = dict.fromkeys([*first, "wall.f1", "seconds", *differing, *HEADLINES])
    return [name for name in names if any(name in run.values for run in listed)]


def _print(
    listed: Sequence[ListedRun], chosen: Sequence[str], root: Path, all_columns: bool
) -> None:
    """Print the table: on a terminal as many columns as fit, else one whole line for each run."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDE)
    wide = console.options.update(width=_WIDE)
    shown = list(chosen)
    table = _table(console, listed, shown, root)
    while (
        not all_columns and shown and Measurement.get(console, wide, table).maximum > console.width
    ):
        shown.pop()
        table = _table(console, listed, shown, root)
    console.print(table)
    typer.echo(f"{len(listed)} {'run' if len(listed) == 1 else 'runs'} in {root}")
    if left_out := chosen[len(shown) :]:
        typer.echo(f"not shown, for want of room: {', '.join(left_out)}; --columns chooses")


def _table(
    console: Console, listed: Sequence[ListedRun], columns: Sequence[str], root: Path
) -> Table:
    rows = [
        (
            escape(os.path.relpath(run.folder.resolve(), root)),
            *(escape(format_value(run.values.get(name))) for name in columns),
        )
        for run in listed
    ]
    # On a terminal, headings are folded at the dots and underscores of names.
    headings = [re.sub(r"([._])", r"\1\n", n) if console.is_terminal else n for n in columns]
    table = make_table(None, ("run", *headings), rows)
    table.columns[0].max_width = console.width // 2
    return table
