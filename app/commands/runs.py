"""ffmap runs: a table of the runs in a folder, sorted and filtered by their figures and settings."""

import difflib
import operator
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape

from ffmap.app.folder import figures
from ffmap.app.folder.names import METRICS, RUN_JSON, RunFolder
from ffmap.app.tables import make_table
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.text_files import dotted_keys, read_object

_DEPTH = 3
"""Levels of folders below the given one in which runs are found."""
_ALL = "all"
_WHOLE = 10_000
"""Width of a table that is not printed to a terminal: each run is one whole line."""
_HEADING = 12
"""Characters of a line of a heading on a terminal, unless a word is longer."""
_DETAILS = ("bag", "git_revision", "outcome")
"""Columns that are shown by default where the runs differ in them."""
_COMPARISONS = {
    ">=": operator.ge,
    "<=": operator.le,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
}


@dataclass(frozen=True)
class ListedRun:
    """A run folder with its values by column: figures, settings, details."""

    folder: Path
    values: Mapping[str, Any]
    settings: Mapping[str, Any]


def runs(
    root: Path, where: Sequence[str], sort: str | None, reverse: bool, columns: str | None
) -> None:
    """Print the runs in a folder.

    Args:
        where: conditions like "wall_f1>0.98"; a run is listed if all hold.
        sort: column; best first for a metric, least first for other columns.
        columns: names separated by commas; "all" lists the names.

    Raises InputError if there is no run, or a column or condition is wrong.
    """
    listed = list(_read(find_runs(root)))
    if not listed:
        raise InputError(f"{root}: no run has a readable {RUN_JSON}; run ffmap again")
    known = list(dict.fromkeys(name for run in listed for name in run.values))
    if columns == _ALL:
        typer.echo("\n".join(sorted(known)))
        return
    for condition in where:
        holds = parse_condition(condition, known)
        listed = [run for run in listed if holds(run.values)]
    if sort is not None:
        listed = sort_runs(listed, _known(sort, known, "--sort"), reverse)
    _print(listed, _chosen(listed, columns, sort, known), str(root.resolve()), columns is None)


def find_runs(root: Path) -> list[Path]:
    """Return the run folders in a folder, or the folder itself; links are ignored.

    Raises InputError if there is none.
    """
    if not root.is_dir():
        raise InputError(f"{root}: is no folder; give a folder of runs")
    found = sorted(_runs_below(root, _DEPTH))
    if not found:
        raise InputError(f"{root}: holds no runs; 'ffmap run' and 'ffmap sweep' make some")
    return found


def _runs_below(folder: Path, depth: int) -> Iterator[Path]:
    if (folder / RUN_JSON).is_file():
        yield folder
    elif depth:
        try:
            inner = [path for path in folder.iterdir() if path.is_dir() and not path.is_symlink()]
        except PermissionError:
            return
        for path in inner:
            yield from _runs_below(path, depth - 1)


def _read(folders: Sequence[Path]) -> Iterator[ListedRun]:
    """Read the runs; print a line for each one that cannot be read."""
    for folder in folders:
        try:
            record = RunFolder(folder).read_json()
            path = folder / METRICS
            metrics = read_object(path, "ffmap evaluate makes it again") if path.exists() else None
        except InputError as error:
            typer.echo(f"not listed: {error}", err=True)
            continue
        parts = {name: part for name, part in record.items() if isinstance(part, Mapping)}
        settings = dotted_keys(parts.get("settings", {}))
        details = {
            "bag": Path(str(parts.get("bag", {}).get("path", ""))).name,
            "git_revision": parts.get("versions", {}).get("git_revision"),
            **{name: record.get(name) for name in ("outcome", "started", "settings_hash")},
        }
        values = {**figures.figures_of(parts, metrics), **settings, **details}
        yield ListedRun(folder, values, settings)


def parse_condition(text: str, known: Sequence[str]) -> "Holds":
    """Parse a condition like "wall_f1>0.98" or "bag=office.bag".

    A run without a value in that column does not meet it. Raises InputError if it is no condition.
    """
    parts = re.fullmatch(r"\s*([\w.]+)\s*(>=|<=|!=|>|<|=)\s*(\S.*?)\s*", text)
    if parts is None:
        raise InputError(f'--where {shortened(text)}: is no condition; write it as in "wall_f1>0.98"')
    return Holds(_known(parts[1], known, "--where"), parts[2], parts[3])


@dataclass(frozen=True)
class Holds:
    """A condition on the values of a run."""

    column: str
    comparison: str
    value: str

    def __call__(self, values: Mapping[str, Any]) -> bool:
        """Compare as numbers where the run's value is one, else as text."""
        own = values.get(self.column)
        if own is None:
            return False
        compare = _COMPARISONS[self.comparison]
        if isinstance(own, bool) or not isinstance(own, int | float):
            return bool(compare(str(own).lower(), self.value.lower()))
        try:
            return bool(compare(own, float(self.value)))
        except ValueError:
            said = f"--where {self.column}{self.comparison}{shortened(self.value)}"
            raise InputError(f"{said}: {self.column} is a number; compare it with one") from None


def sort_runs(listed: Sequence[ListedRun], column: str, reverse: bool) -> list[ListedRun]:
    """Sort by a column; runs without a value come last."""
    best_first = column in figures.OBJECTIVES and not figures.less_is_better(column)
    there = [run for run in listed if run.values.get(column) is not None]
    numbers = all(isinstance(run.values[column], int | float) for run in there)

    def key(run: ListedRun) -> Any:  # noqa: ANN401 - numbers or text
        return run.values[column] if numbers else str(run.values[column])

    without = [run for run in listed if run.values.get(column) is None]
    return sorted(there, key=key, reverse=best_first != reverse) + without


def _known(name: str, known: Sequence[str], option: str) -> str:
    """The column of this name; dots of settings may be underscores."""
    same = (column for column in known if column.replace(".", "_") == name.replace(".", "_"))
    if column := next(same, None):
        return column
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    meant = f"did you mean {close[0]!r}? " if close else ""
    raise InputError(f"{option}: no column {shortened(name)!r}; {meant}--columns all lists them")


def _chosen(
    listed: Sequence[ListedRun], columns: str | None, sort: str | None, known: Sequence[str]
) -> list[str]:
    """The columns of the table: as given, else the usual figures and the settings that differ."""
    if columns is not None:
        return [_known(name.strip(), known, "--columns") for name in columns.split(",")]
    first = [] if sort is None else [_known(sort, known, "--sort")]
    settings = dict.fromkeys(name for run in listed for name in run.settings)
    differing = [name for name in (*settings, *_DETAILS) if _differs(listed, name)]
    there = [name for name in figures.HEADLINES if any(name in run.values for run in listed)]
    main = [name for name in (figures.QUALITY, figures.SECONDS) if name in there]
    return list(dict.fromkeys([*first, *main, *differing, *there]))


def _differs(listed: Sequence[ListedRun], name: str) -> bool:
    return len({str(run.values.get(name)) for run in listed}) > 1


def _print(listed: Sequence[ListedRun], chosen: list[str], root: str, may_leave_out: bool) -> None:
    console = Console()
    terminal = console.is_terminal
    names = [os.path.relpath(run.folder.resolve(), root) for run in listed]
    names = [Path(root).name if name == "." else name for name in names]
    cells = {
        name: [figures.format_value(run.values.get(name)) for run in listed] for name in chosen
    }
    shown = chosen
    if not terminal:
        console = Console(width=_WHOLE)
    elif may_leave_out:
        room = console.width - min(max(map(len, names), default=0), console.width // 2) - 4
        widths = {name: max(map(len, (*_lines(name).split("\n"), *cells[name]))) for name in chosen}
        shown = figures.fit(widths, room)
    headings = ("run", *(_lines(name) if terminal else name for name in shown))
    rows = zip(names, *(cells[name] for name in shown), strict=True)
    table = make_table(None, headings, (map(escape, row) for row in rows))
    table.columns[0].max_width = console.width // 2 if terminal else None
    console.print(table)
    typer.echo(f"{len(listed)} {'run' if len(listed) == 1 else 'runs'} in {root}")
    if left_out := [name for name in chosen if name not in shown and "." in name]:
        typer.echo(f"not shown, for want of room: {', '.join(left_out)}; --columns chooses")


def _lines(name: str) -> str:
    """Break a name into lines of a narrow column."""
    lines = [""]
    for word in re.findall(r"[^._]+[._]?", name):
        if lines[-1] and len(lines[-1] + word) > _HEADING:
            lines.append("")
        lines[-1] += word
    return "\n".join(lines)
