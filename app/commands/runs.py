"""ffmap runs and ffmap serve: runs as a table, and as a catalogue that others can query."""

import os
import re
import signal
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ffmap.app.folder import figures
from ffmap.app.record.catalogue import runs as catalogue
from ffmap.app.record.catalogue.runs import Answer, Catalogue, Query
from ffmap.app.record.catalogue.server import LOOPBACK
from ffmap.app.tables import make_table
from ffmap.loaders.errors import InputError

_ALL = "all"
_LOOK_AGAIN_S = 5.0
_HEADING = 12
"""Characters of a heading's line on a terminal, unless one of its words is longer."""
_WHOLE = 10_000
"""A width that no table needs."""
_DETAILS = ("bag_path", "versions_git_revision", "outcome")
"""What is not shown where all runs have it in common."""


def runs(place: str, query: Query, columns: str | None, dataset: str | None) -> None:
    """Print a table of the runs in a folder, or of a catalogue server.

    columns: figures to show, by commas; 'all' lists the names that there are.
    Raises InputError where there are no runs, or the query is wrong.
    """
    if "://" in place:
        _show(catalogue.ask(catalogue.connect(place, dataset), query), query, columns, place)
        return
    root = Path(place)
    with catalogue.serve(catalogue.find_runs(root)) as served:
        answer = catalogue.ask(served.dataset, query) if served.taken else None
        if answer is not None:
            _show(answer, query, columns, str(root.resolve()))
        for reason in served.left_out.values():
            typer.echo(f"not in the table: {reason}", err=True)
        if answer is None:
            raise InputError(f"{root}: none of its runs has a recording that can be queried")


def _show(answer: Answer, query: Query, columns: str | None, place: str) -> None:
    known = answer.table.column_names
    if columns == _ALL:
        typer.echo("\n".join(sorted(known)))
        return
    names, parent = _run_names(answer, place)
    chosen = _chosen(answer, columns, query, known)
    cells = {name: [_cell(name, value) for value in answer.table.column(name).to_pylist()] for name in chosen}
    console, shown = Console(), chosen
    if not console.is_terminal:
        # Nobody's screen limits it: each run is one whole line, for whatever reads them.
        console = Console(width=_WHOLE)
    elif columns is None:
        # The names take at most half a screen, with the table's edges.
        longest = max(map(len, names), default=0)
        widths = {name: max(map(len, (*_heading(name).split("\n"), *cells[name]))) for name in chosen}
        shown = figures.fit(widths, console.width - min(longest, console.width // 2) - 4)
    console.print(_table(names, {name: cells[name] for name in shown}, console))
    where = f", where {query.where}" if query.where else ""
    typer.echo(f"{_count(len(names))} in {parent}{where}")
    if left_out := [name for name in chosen if name not in shown and name in answer.settings]:
        typer.echo(
            f"no room for settings that differ: {', '.join(left_out)}; choose with --columns, or pipe the table to a file"
        )


def _heading(name: str) -> str:
    """The name in lines of a narrow column, broken where its words end."""
    lines = [""]
    for word in re.findall(r"[^._]+[._]?", name):
        if lines[-1] and len(lines[-1] + word) > _HEADING:
            lines.append("")
        lines[-1] += word
    return "\n".join(lines)


def _count(runs: int) -> str:
    return "1 run" if runs == 1 else f"{runs} runs"


def _run_names(answer: Answer, place: str) -> tuple[list[str], str]:
    """Each run's folder within the one that was named, or that a server's have in common; and that folder."""
    folders = answer.table.column(catalogue.RUN).to_pylist()
    parent = said = place
    if "://" in place and folders:
        parent = os.path.commonpath(folders) if len(folders) > 1 else str(Path(folders[0]).parent)
        said = f"{parent} at {place}"
    names = [os.path.relpath(folder, parent) for folder in folders]
    return [Path(folder).name if name == "." else name for name, folder in zip(names, folders, strict=True)], said


def _chosen(answer: Answer, columns: str | None, query: Query, known: Sequence[str]) -> list[str]:
    """The columns that were asked for; else what is sorted by, the usual figures, and between them settings that differ."""
    if columns is not None:
        return [_known_column(name.strip(), known) for name in columns.split(",")]
    # What is sorted by is to be seen.
    first = [] if query.sort is None else [_known_column(query.sort, known)]
    values = {name: set(answer.table.column(name).to_pylist()) for name in known}
    there = [name for name in figures.HEADLINES if values.get(name, {None}) != {None}]
    details = [name for name in _DETAILS if len(values.get(name, ())) > 1]
    before = [name for name in (figures.QUALITY, figures.SECONDS) if name in there]
    return list(dict.fromkeys([*first, *before, *answer.differing, *details, *there]))


def _known_column(name: str, known: Sequence[str]) -> str:
    column = catalogue.known_as(name, known)
    if column is None:
        raise InputError(f"--columns: {catalogue.unknown(name, known)}")
    return column


def _table(names: Sequence[str], cells: Mapping[str, Sequence[str]], console: Console) -> Table:
    """Rows of text; on a terminal headings are broken, and names that are longer than half a screen."""
    headings = ("run", *(_heading(name) if console.is_terminal else name for name in cells))
    table = make_table(None, headings, (map(escape, row) for row in zip(names, *cells.values(), strict=True)))
    table.columns[0].max_width = console.width // 2 if console.is_terminal else None
    return table


def _cell(name: str, value: object) -> str:
    return Path(str(value)).name if name == "bag_path" and value is not None else figures.format_value(value)


def serve(root: Path, host: str, port: int) -> None:
    """Serve a folder of runs until the user ends it; runs that are finished meanwhile are added."""
    folders = catalogue.find_runs(root)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    # Here: a list of runs needs none of it.
    from ffmap.app.record.catalogue.read_only import read_only

    with (
        catalogue.serve(folders) as served,
        read_only(served.url, host, port) as url,
        tempfile.TemporaryDirectory(prefix="ffmap-serve-") as folder,
    ):
        _add_layout(served, Path(folder))
        typer.echo(f"{_count(len(served.taken))} of {root}, served at {url}")
        for reason in served.left_out.values():
            typer.echo(f"not among them: {reason}", err=True)
        if host != LOOPBACK:
            typer.echo(
                f"whoever reaches {host} can read them without a password: recordings, settings, paths of bags and folders; "
                "nothing is encrypted, and nobody can change them from there",
                err=True,
            )
        typer.echo(
            f'\nquery them:    ffmap runs {url} --where "wall_f1 > 0.9" --sort seconds\n'
            f"look at them:  rerun {url}\n"
            f'from Python:   rerun.catalog.CatalogClient("{url}").get_dataset("{catalogue.DATASET}").segment_table()\n'
            "\nCtrl-C ends it"
        )
        while not stop.wait(_LOOK_AGAIN_S):
            _add_new(served, root)
    typer.echo("ended")


def _add_new(served: Catalogue, root: Path) -> None:
    new = [folder for folder in catalogue.find_runs(root) if folder not in served.taken.values()]
    said = {folder: served.left_out.pop(folder, None) for folder in new}
    served.add(new)
    for folder in new:
        if folder in served.taken.values():
            typer.echo(f"added: {folder}")
        reason = served.left_out.get(folder)
        if reason not in (None, said[folder]):
            typer.echo(f"not among them: {reason}", err=True)


def _add_layout(served: Catalogue, folder: Path) -> None:
    """How the viewer opens a run of the catalogue."""
    from ffmap.app.folder.finished_run import open_run
    from ffmap.blueprints import entities
    from ffmap.blueprints import run as run_blueprint

    path = folder / "run.rbl"
    scans = any(open_run(run).has_scans for run in served.taken.values())
    run_blueprint.build(evaluated=True, scans=scans).save(entities.APPLICATION_ID, str(path))
    served.set_layout(path.resolve().as_uri())
