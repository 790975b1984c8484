"""Runs as a catalogue: Rerun's own server over their recordings, and queries on the properties that these carry.

A recording is a segment of the dataset `runs`, its `evaluation.rrd` a layer of it; settings, results and metrics are their
properties. A query is the same whether the server runs here for a second or is one that others share.
"""

import difflib
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pyarrow as pa  # type: ignore[import-untyped]
from datafusion import Expr, col, lit
from datafusion import functions as f
from rerun.catalog import CatalogClient, DatasetEntry

from ffmap.app.folder import figures
from ffmap.app.folder.names import EVALUATION, METRICS, RECORDING, RUN_JSON, RunFolder
from ffmap.app.record.catalogue.condition import ConditionError, rows_where
from ffmap.app.record.catalogue.server import CatalogueServer
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.text_files import read_object

DATASET = "runs"
RUN = "run"
"""The column that names a run: its folder."""
_URLS = "rerun_storage_urls"
_GROUPS = ("run", "result", "metrics", "settings")
"""Properties that are asked for; where two have a name in common, the earlier is meant."""
_DEPTH = 3
_STAND_INS = "ffmap-stand-ins"


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

    def __init__(self, server: CatalogueServer, stand_ins: Path) -> None:
        """stand_ins: an empty folder, for the properties of runs that have no recording."""
        self._stand_ins = stand_ins / _STAND_INS
        self._server = server
        self.url: str = server.url
        self.dataset: DatasetEntry = CatalogClient(server.url).create_dataset(DATASET)
        self._sound: list[tuple[str, list[str]]] = []
        """Layers, and addresses of their files, in the order in which they were registered."""
        self._layout: str | None = None
        self.taken: dict[str, Path] = {}
        """Folders by their recordings' ids."""
        self._evaluated: set[Path] = set()
        self.left_out: dict[Path, str] = {}
        """Why a run is not among them, or its figures are not, and what to do."""

    def add(self, folders: Iterable[Path]) -> None:
        """Register runs; of those that cannot be, or not with their figures, `left_out` says why."""
        new: dict[str, Path] = {}
        recordings: dict[Path, Path] = {}
        copies: dict[Path, str] = {}
        for folder in folders:
            try:
                record = RunFolder(folder).read_json()
            except InputError as error:
                self.left_out[folder] = str(error)
                continue
            identity = str(record.get("recording_id"))
            if identity in self.taken or identity in new:
                copies[folder] = identity
                continue
            new[identity] = folder
            there = (folder / RECORDING).exists()
            recordings[folder] = folder / RECORDING if there else self._stand_in(folder, identity, record)
        refused = self._register([recordings[folder] for folder in new.values()], "base")
        for identity, folder in new.items():
            if reason := refused.get(recordings[folder]):
                damaged = f"{folder}: {RECORDING} is damaged ({reason}); make the run again"
                self.left_out[folder] = _no_end(folder) or damaged
            else:
                self.taken[identity] = folder
        self._add_figures()
        for folder, identity in copies.items():
            if first := self.taken.get(identity):
                self.left_out[folder] = f"{folder}: has the recording id of {first}, of which it is a copy"
        if whole := [folder for folder, identity in copies.items() if identity not in self.taken]:
            self.add(whole)

    def _stand_in(self, folder: Path, identity: str, record: Mapping[str, Any]) -> Path:
        """A recording of what run.json and metrics.json say of a run that has no recording itself."""
        properties = {
            "settings": record.get("settings"),
            "run": {name: record[name] for name in ("settings_hash", "bag", "versions", "started") if name in record},
            "result": {name: record[name] for name in ("timings_s", "counts", "outcome") if name in record},
        }
        with suppress(InputError):
            properties["metrics"] = figures.queried(read_object(folder / METRICS, ""))
        # Its place says which run it is of, to whoever asks the server.
        path = self._stand_ins / folder.resolve().relative_to(folder.resolve().anchor) / RECORDING
        path.parent.mkdir(parents=True, exist_ok=True)
        # Imported here, for with it comes the whole method: most folders hold no such run.
        from ffmap.app.record.stream import write_properties

        write_properties(path, identity, {name: of for name, of in properties.items() if isinstance(of, Mapping)})
        return path

    def _add_figures(self) -> None:
        """Those of runs that were evaluated since they were registered too."""
        files = [folder / EVALUATION for folder in self.taken.values() if folder not in self._evaluated]
        there = [file for file in files if file.exists()]
        damaged = self._register(there, "evaluation")
        self._evaluated |= {file.parent for file in there if file not in damaged}
        for file, reason in damaged.items():
            self.left_out[file.parent] = f"{file}: is damaged ({reason}); ffmap evaluate {file.parent} makes it again"

    def _register(self, files: Sequence[Path], layer: str) -> dict[Path, str]:
        """Add files as a layer of their segments, in one call: one by one they take four times as long.

        Returns those that could not be added, and why. The server refuses a call for a single file that it cannot read, and
        takes some damaged files that no list of runs can be read with; each half is then tried by itself.
        """
        if not files:
            return {}
        by_uri = {file.resolve().as_uri(): file for file in files}
        added: list[str] = []
        try:
            results = list(self.dataset.register(list(by_uri), layer_name=layer).iter_results())
            added = [result.segment_id for result in results if result.segment_id is not None]
            self.dataset.segment_table().to_arrow_table()
        except Exception as error:
            # Where its server ends, DataFusion raises the bare class itself.
            if type(error) is not Exception and not isinstance(error, ValueError | RuntimeError | OSError):
                raise
            if self._server.ended():
                self._restart()
            elif added:
                self.dataset.unregister(segments_to_drop=added, layers_to_drop=layer).wait()
            if len(files) == 1:
                return {files[0]: str(error).splitlines()[0]}
            half = len(files) // 2
            return self._register(files[:half], layer) | self._register(files[half:], layer)
        self._sound.append((layer, [result.uri for result in results if result.error is None]))
        return {by_uri[result.uri]: result.error.splitlines()[0] for result in results if result.error is not None}

    def _restart(self) -> None:
        """Another server in place of one that a recording has ended, with all that the other had."""
        self._server.restart()
        self.dataset = CatalogClient(self.url).create_dataset(DATASET)
        for layer, uris in self._sound:
            if uris:
                self.dataset.register(uris, layer_name=layer).wait()
        if self._layout is not None:
            self.set_layout(self._layout)

    def set_layout(self, uri: str) -> None:
        """How the viewer opens a run: a blueprint's address, which has to stay there."""
        self.dataset.register_blueprint(uri, set_default=True)
        self._layout = uri


def _no_end(folder: Path) -> str | None:
    """What to say of a run that did not come to its end."""
    if RunFolder(folder).read_json().get("outcome") != "running":
        return None
    return f"{folder}: {RECORDING} has no end yet: the run goes on, or was killed; ffmap run --resume {folder}"


@contextmanager
def serve(folders: Sequence[Path]) -> Iterator[Catalogue]:
    """A catalogue of runs for as long as the context lasts, on a loopback port that is free.

    Rerun's server lets whoever reaches it change the list and register files: others come by `app.read_only`.
    """
    with closing(CatalogueServer()) as server, tempfile.TemporaryDirectory(prefix="ffmap-runs-") as stand_ins:
        catalogue = Catalogue(server, Path(stand_ins))
        catalogue.add(folders)
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
        known = ", ".join(names) or "it has none"
        raise InputError(f"{url}: has no dataset {wanted!r}; choose one with --dataset: {known}")
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
    columns, settings = _columns(segments.schema().names)
    if query.sort is not None:
        name = known_as(query.sort, columns)
        if name is None:
            raise InputError(f"--sort {query.sort}: {unknown(query.sort, list(columns))}")
        more_is_better = name in figures.OBJECTIVES and not figures.less_is_better(name)
        by = _value(columns[name])
        segments = segments.sort(by.sort(ascending=more_is_better == query.reverse, nulls_first=False))
    else:
        segments = segments.sort(_value(_URLS).sort(ascending=True))
    found = segments.to_arrow_table()
    if query.where is not None:
        found = _filtered(found, query.where, columns)
    table = {name: _firsts(found.column(source)) for name, source in columns.items()}
    table[RUN] = pa.array([_folder_of(url) for url in table[RUN].to_pylist()], pa.string())
    return Answer(pa.table(table), tuple(settings))


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
    return {**found, RUN: _URLS}, settings


def _value(column: str) -> Expr:
    """A property's value: the catalogue has lists of one."""
    return f.array_element(col(f'"{column}"'), lit(1))


def _firsts(column: pa.ChunkedArray) -> pa.Array:
    return pa.array([values[0] if values else None for values in column.to_pylist()], column.type.value_type)


def _filtered(runs: pa.Table, said: str, columns: Mapping[str, str]) -> pa.Table:
    try:
        return runs.take(pa.array(rows_where(runs, _in_their_words(said, columns)), pa.int64()))
    except ConditionError as error:
        text = str(error)
        missing = re.search(r"No field named (\S+?)[.,]?(?:\s|$)", text)
        if missing is not None:
            raise InputError(f"--where {said}: {unknown(missing.group(1).strip(chr(34)), list(columns))}") from None
        reason = re.sub(r"^DataFusion error: ", "", text.splitlines()[0])
        example = '"wall_f1 > 0.98 and doors = 4"'
        said, reason = shortened(said), shortened(reason)
        raise InputError(f"--where {said}: has no answer ({reason}); write it as SQL, as in {example}") from None


def known_as(name: str, known: Iterable[str]) -> str | None:
    """The column that is meant: a setting may be written with underscores alone. None where there is none."""
    return next((column for column in known if column.replace(".", "_") == name.replace(".", "_")), None)


def unknown(name: str, known: Sequence[str]) -> str:
    """What to say of a column that is not there."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    usual = [figure for figure in figures.HEADLINES if figure in known]
    meant = f"did you mean {close[0]!r}? " if close else ""
    there = f"There are {', '.join(usual) or 'no figures'} and {len(known) - len(usual)} more"
    return f"there is no column {name!r}; {meant}{there}; --columns all lists them"


def _in_their_words(condition: str, columns: Mapping[str, str]) -> str:
    """SQL on the catalogue's columns; what stands for a setting may have its dot, as 'ffmap settings' names it."""

    def value(found: re.Match[str]) -> str:
        name = known_as(found[0].strip('"'), columns)
        return found[0] if name is None else f'"{columns[name]}"[1]'

    # What stands between single quotes is text.
    parts = condition.split("'")
    parts[::2] = [re.sub(r'"[^"]+"|[A-Za-z_][\w.]*', value, part) for part in parts[::2]]
    return "'".join(parts)


def _folder_of(url: str) -> str:
    """The folder of a recording, where it is a file."""
    parts = urlsplit(url)
    if parts.scheme != "file":
        return url.rpartition("/")[0]
    folder = Path(unquote(parts.path)).parent
    if _STAND_INS not in folder.parts:
        return str(folder)
    return str(Path(folder.anchor, *folder.parts[folder.parts.index(_STAND_INS) + 1 :]))
