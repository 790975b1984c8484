"""ffmap runs and ffmap serve: runs as a table, and as a catalogue that others can query."""

import os
import signal
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

import typer
from rich.table import Table

from app import catalogue, figures
from app.catalogue import Answer, Catalogue, Query
from app.catalogue_server import LOOPBACK
from app.progress import table_console
from loaders.errors import InputError

_ALL = "all"
_LOOK_AGAIN_S = 5.0
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
    console = table_console()
    names, parent = _run_names(answer, place)
    chosen = _chosen(answer, columns, query, known, console.width - max(map(len, names), default=0) - 4)
    console.print(_table(answer, chosen, names))
    where = f", where {query.where}" if query.where else ""
    typer.echo(f"{_count(len(names))} in {parent}{where}")


def _count(runs: int) -> str:
    return "1 run" if runs == 1 else f"{runs} runs"


def _run_names(answer: Answer, place: str) -> tuple[list[str], str]:
    """Each run's folder within the one that was named, or that a server's have in common; and that folder."""
    folders = answer.table.column(catalogue.RUN).to_pylist()
    if "://" in place and folders:
        common = os.path.commonpath(folders) if len(folders) > 1 else str(Path(folders[0]).parent)
        parent, said = common, f"{common} at {place}"
    else:
        parent = said = place
    names = [os.path.relpath(folder, parent) for folder in folders]
    return [Path(folder).name if name == "." else name for name, folder in zip(names, folders, strict=True)], said


def _chosen(answer: Answer, columns: str | None, query: Query, known: Sequence[str], width: int) -> list[str]:
    """The columns that were asked for; else settings that differ, and the usual figures as far as there is room."""
    if columns is not None:
        chosen = [name.strip().replace(".", "_") for name in columns.split(",")]
        for name in chosen:
            if name not in known:
                raise InputError(f"--columns: {catalogue.unknown(name, known)}")
        return chosen
    usual = list(figures.HEADLINES)
    if query.sort is not None:
        # What is sorted by is to be seen.
        usual = list(dict.fromkeys([query.sort.replace(".", "_"), *usual]))
    there = [name for name in usual if name in known and answer.table.column(name).null_count < answer.table.num_rows]
    differing = answer.differing
    details = [name for name in _DETAILS if len(set(answer.table.column(name).to_pylist() if name in known else [])) > 1]
    taken = sum(len(name) + 3 for name in (*differing, *details))
    return [*differing, *details, *figures.fit([name for name in there if name not in differing], width - taken)]


def _table(answer: Answer, columns: Sequence[str], names: Sequence[str]) -> Table:
    table = Table()
    table.add_column("run", no_wrap=True)
    for name in columns:
        table.add_column(name, justify="right", overflow="fold")
    for run, row in zip(names, answer.table.select(list(columns)).to_pylist(), strict=True):
        table.add_row(run, *(_cell(name, row[name]) for name in columns))
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
    from app.read_only import read_only

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
    from app.finished_run import open_run
    from blueprints import entities
    from blueprints import run as run_blueprint

    path = folder / "run.rbl"
    scans = any(open_run(run).has_scans for run in served.taken.values())
    run_blueprint.build(evaluated=True, scans=scans).save(entities.APPLICATION_ID, str(path))
    served.set_layout(path.resolve().as_uri())
