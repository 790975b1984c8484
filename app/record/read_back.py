"""Recordings read back: rows of an entity in the order of the file, and recordings that were cut."""

import shutil
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from rerun.chunk import LazyChunkStream, RrdReader

from ffmap.app.record.stream import whole_messages
from ffmap.blueprints import entities
from ffmap.loaders.errors import InputError


@dataclass(frozen=True, eq=False)
class Row:
    """What was logged of an entity at one scan.

    values: components by their short names, as arrays of their own shape; none that was not logged.
    """

    scan: int
    stamp_ns: int
    values: dict[str, Any]


@dataclass(frozen=True)
class ReadableRecording:
    """A recording that can be read to its end.

    path: itself, or a copy up to where it was cut. warning: what is to be said of it; None where it is whole.
    """

    path: Path
    warning: str | None = None

    @property
    def whole(self) -> bool:
        """Whether all that its writer meant to write is there."""
        return self.warning is None


@contextmanager
def readable(path: Path) -> Iterator[ReadableRecording]:
    """A recording that can be read to its end: where it was cut in the middle of a message, a copy that ends before it.

    Raises InputError where it is no recording, or nothing of it is left.
    """
    end = whole_messages(path)
    if end.complete:
        warning = None if end.has_footer else f"{path}: has no footer: it was cut, or its writer killed"
        yield ReadableRecording(path, warning)
        return
    with tempfile.TemporaryDirectory(prefix="ffmap-cut-") as folder:
        copy = Path(folder) / path.name
        with path.open("rb") as source, copy.open("wb") as target:
            shutil.copyfileobj(source, target)
            target.truncate(end.position)
        yield ReadableRecording(copy, f"{path}: was cut; it is read up to the cut")


def chunk_stream(path: Path) -> LazyChunkStream:
    """All chunks of a recording, in the order of the file."""
    with warnings.catch_warnings():
        # A recording without a footer is read all the same.
        warnings.simplefilter("ignore")
        return RrdReader(path).stream()


def rows(path: Path, entity: str | Sequence[str], required: str | None = None) -> Iterator[Row]:
    """The rows of entities that lie on the timeline `scan`, in the order of the file.

    required: a component without which a row is left out.
    Raises InputError where the recording cannot be read.
    """
    try:
        for chunk in chunk_stream(path).filter(content=entity, has_timeline=entities.SCAN_TIMELINE):
            yield from _rows_of(chunk.entity_path, chunk.to_record_batch(), required)
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be read ({str(error).splitlines()[0]}); run ffmap again") from error


def _rows_of(entity: str, batch: pa.RecordBatch, required: str | None) -> Iterator[Row]:
    names = {name.rpartition(":")[2]: name for name in batch.schema.names}
    if required is not None and required not in names:
        return
    scans = batch.column(entities.SCAN_TIMELINE).to_numpy()
    stamps = batch.column(entities.STAMP_TIMELINE).cast(pa.int64()).to_numpy()
    columns = {
        short: batch.column(name)
        for short, name in names.items()
        if short not in (entities.SCAN_TIMELINE, entities.STAMP_TIMELINE, "rerun.controls.RowId")
    }
    for i, (scan, stamp) in enumerate(zip(scans.tolist(), stamps.tolist(), strict=True)):
        values = {short: _array(column[i].values) for short, column in columns.items() if column[i].is_valid}
        if required is None or required in values:
            yield Row(scan, stamp, values)


def _array(values: pa.Array) -> Any:  # noqa: ANN401 - of any type
    if pa.types.is_fixed_size_list(values.type):
        return values.flatten().to_numpy(zero_copy_only=False).reshape(len(values), values.type.list_size)
    if pa.types.is_list(values.type):
        return [_array(item.values) for item in values]
    return np.asarray(values.to_numpy(zero_copy_only=False))
