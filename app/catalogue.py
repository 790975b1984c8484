"""Runs as a catalogue: Rerun's own server over their recordings, and queries on the properties that these carry.

A recording is a segment of the dataset `runs`, its `evaluation.rrd` a layer of it; settings, results and metrics are their
properties. A query is the same whether the server runs here for a second or is one that others share.
"""

import difflib
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr
import rerun.server
from datafusion import DataFrame, Expr, col, lit
from datafusion import functions as f
from rerun.catalog import CatalogClient, DatasetEntry

from app import figures
from app.run_folder import EVALUATION, RECORDING, RUN_JSON, RunFolder
from loaders.errors import InputError

LOOPBACK = "127.0.0.1"
DATASET = "runs"
RUN = "run"
"""The column that names a run: its folder."""
_SEGMENT = "rerun_segment_id"
_URLS = "rerun_storage_urls"
_GROUPS = ("run", "result", "metrics", "settings")
"""Properties that are asked for; where two have a name in common, the earlier is meant."""
_DEPTH = 3


def find_runs(root: Path) -> list[Path]:
    """Run folders in a folder, or the folder itself, links left out; raises InputError where there is none."""
    if not root.is_dir():
        raise InputError(f"{root}: is no folder; give one with runs")
    found = sorted(_runs_below(root, _DEPTH))
    if not found:
        raise InputError(f"{root}: holds no runs; 'ffmap run' and 'ffmap sweep' make some")
    return found


def _runs_below(folder: Path, depth: int) -> Iterator[Path]:
    if (folder / RUN_JSON).is_file():
        yield folder
    elif depth:
        try:
            inner = [entry for entry in folder.iterdir() if entry.is_dir() and not entry.is_symlink()]
        except PermissionError:
            return
        for entry in inner:
            yield from _runs_below(entry, depth - 1)


class Catalogue:
    """A server over the recordings of runs, and what it could not take."""

    def __init__(self, server: rr.server.Server) -> None:
        self.url: str = server.url()
        self.dataset: DatasetEntry = server.client().create_dataset(DATASET)
        self.taken: dict[str, Path] = {}
        """Folders by their recordings' ids."""
        self.left_out: dict[Path, str] = {}
        """Why a run is not among them, and what to do."""

    def add(self, folder: Path) -> None:
        """Register a run; one that cannot be is kept in `left_out`."""
        reason = self._register(folder)
        if reason is not None:
            self.left_out[folder] = reason

    def _register(self, folder: Path) -> str | None:
        try:
            record = RunFolder(folder).read_json()
        except InputError as error:
            return str(error)
        identity = str(record.get("recording_id"))
        recording = folder / RECORDING
        if not recording.exists():
            return f"{folder}: has no {RECORDING}, in which its properties would be"
        if identity in self.taken:
            return f"{folder}: has the recording id of {self.taken[identity]}, of which it is a copy"
        layers = [(recording, "base"), (folder / EVALUATION, "evaluation")]
        try:
            for path, layer in layers:
                if path.exists():
                    self.dataset.register([path.resolve().as_uri()], layer_name=layer).wait()
                    self.taken[identity] = folder
        except (ValueError, RuntimeError) as error:
            name = path.name
            if record.get("outcome") == "running":
                return f"{folder}: {name} has no end yet: the run goes on, or was killed; ffmap run --resume {folder}"
            return f"{folder}: {name} is damaged ({str(error).splitlines()[0]}); make the run again"
        return None


@contextmanager
def serve(folders: Sequence[Path], host: str = LOOPBACK, port: int | None = None) -> Iterator[Catalogue]:
    """A catalogue of runs for as long as the context lasts.

    Raises InputError where the address cannot be had.
    """
    try:
        server = rr.server.Server(host=host, port=port)
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(f"{host}:{port or 0}: no server can listen there ({error}); choose another --port") from error
    with server:
        catalogue = Catalogue(server)
        for folder in folders:
            catalogue.add(folder)
        yield catalogue


def connect(url: str, name: str | None) -> DatasetEntry:
    """The dataset of a catalogue server; raises InputError where there is none."""
    try:
        client = CatalogClient(url)
        names = client.dataset_names()
    except (ConnectionError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{url}: no catalogue answers there ({reason}); 'ffmap serve DIR' starts one") from None
    wanted = name or (DATASET if DATASET in names or len(names) != 1 else names[0])
    if wanted not in names:
        raise InputError(f"{url}: has no dataset {wanted!r}; choose one with --dataset: {', '.join(names) or 'it has none'}")
    return client.get_dataset(wanted)


@dataclass(frozen=True)
class Query:
    """What is asked of a catalogue: SQL that a run has to satisfy, and a column to sort by."""

    where: str | None = None
    sort: str | None = None
    reverse: bool = False
    """What is better, or less, comes last."""


@dataclass(frozen=True)
class Answer:
    """Runs that a query found.

    table: one row a run, a column for each property by its name in `app.figures`, and `run`, its folder.
    """

    table: pa.Table
    settings: tuple[str, ...]
    """Columns that are settings."""

    @property
    def differing(self) -> list[str]:
        """Settings that are not the same in all runs."""
        return [name for name in self.settings if len(set(self.table.column(name).to_pylist())) > 1]


def ask(dataset: DatasetEntry, query: Query) -> Answer:
    """Runs of a dataset; raises InputError where the query cannot be understood, or names what is not there."""
    segments = dataset.segment_table()
    names, settings = _columns(segments.schema().names)
    runs = segments.select(
        *(f.array_element(_column(source), lit(1)).alias(name) for name, source in names.items()),
        f.array_element(_column(_URLS), lit(1)).alias(RUN),
        _column(_SEGMENT),
    )
    known = [*names, RUN]
    if query.where is not None:
        runs = _filtered(runs, _without_dots(query.where, known), query.where, known)
    if query.sort is not None:
        name = _without_dots(query.sort, known)
        if name not in known:
            raise InputError(f"--sort {query.sort}: {unknown(query.sort, known)}")
        more_is_better = name in figures.OBJECTIVES and not figures.less_is_better(name)
        runs = runs.sort(_column(name).sort(ascending=more_is_better == query.reverse, nulls_first=False))
    else:
        runs = runs.sort(_column(RUN).sort(ascending=True))
    table = runs.to_arrow_table()
    folders = [_folder_of(url) for url in table.column(RUN).to_pylist()]
    table = table.set_column(table.column_names.index(RUN), RUN, pa.array(folders, pa.string()))
    return Answer(table, tuple(settings))


def _columns(names: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """The properties' columns by the names that they have here; and which of them are settings."""
    found: dict[str, str] = {}
    settings = []
    for group in _GROUPS:
        for source in names:
            if source.startswith(prefix := f"property:{group}:"):
                name = figures.column_name(group, source.removeprefix(prefix))
                if found.setdefault(name, source) == source and group == "settings":
                    settings.append(name)
    return found, settings


def _column(name: str) -> Expr:
    return col(f'"{name}"')


def _filtered(runs: DataFrame, condition: str, said: str, known: Sequence[str]) -> DataFrame:
    try:
        filtered = runs.filter(condition)
        # A plan is checked against the columns' types only when it is carried out.
        filtered.execution_plan()
    except Exception as error:
        text = str(error)
        missing = re.search(r"No field named (\S+?)[.,]?(?:\s|$)", text)
        if missing is not None:
            raise InputError(f"--where {said}: {unknown(missing.group(1).strip(chr(34)), known)}") from None
        reason = re.sub(r"^DataFusion error: ", "", text.splitlines()[0])
        raise InputError(
            f"--where {said}: is not understood ({reason}); write it as SQL, as in \"wall_f1 > 0.98 and doors = 4\""
        ) from None
    return filtered


def unknown(name: str, known: Sequence[str]) -> str:
    """What to say of a column that is not there."""
    close = difflib.get_close_matches(name.replace(".", "_"), known, n=1, cutoff=0.5)
    usual = [figure for figure in figures.HEADLINES if figure in known]
    return (
        f"there is no column {name!r}; "
        + (f"did you mean {close[0]!r}? " if close else "")
        + f"There are {', '.join(usual) or 'no figures'} and {len(known) - len(usual)} more; --columns all lists them"
    )


def _without_dots(text: str, known: Sequence[str]) -> str:
    """A setting as 'ffmap settings' names it is the column that has underscores for dots."""
    return re.sub(
        r"\b[a-z_]\w*(?:\.[a-z_]\w*)+\b",
        lambda found: found[0].replace(".", "_") if found[0].replace(".", "_") in known else found[0],
        text,
    )


def _folder_of(url: str) -> str:
    """The folder of a recording, where it is a file."""
    parts = urlsplit(url)
    return str(Path(unquote(parts.path)).parent) if parts.scheme == "file" else url.rpartition("/")[0]
