"""Recordings read back: rows of an entity in the order of the file."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from rerun.chunk import LazyChunkStream, RrdReader

from ffmap.blueprints.entities import SCAN_TIMELINE, STAMP_TIMELINE
from ffmap.loaders.errors import InputError


@dataclass(frozen=True, eq=False)
class Row:
    """The components of an entity at one scan, by their short names, as arrays."""

    scan: int
    stamp_ns: int
    values: dict[str, Any]


def chunk_stream(path: Path) -> LazyChunkStream:
    """Return all chunks of a recording, in the order of the file.

    Raises InputError if it is not a complete recording.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # that it has no footer
        try:
            return RrdReader(path).stream()
        except (RuntimeError, ValueError, Warning) as error:
            raise InputError(
                f"{path}: is not a complete Rerun recording; run ffmap again"
            ) from error


def text_of(path: Path, entity: str) -> str | None:
    """Return the static text of an entity; None without one.

    Raises InputError if it is not a complete recording.
    """
    for chunk in chunk_stream(path).filter(content=entity):
        return str(chunk.to_record_batch().column("TextDocument:text")[0].as_py()[0])
    return None


def rows(path: Path, entity: str | Sequence[str], required: str | None = None) -> Iterator[Row]:
    """Yield the rows of entities on the timeline `scan`, in the order of the file.

    required: rows without this component are omitted.
    Raises InputError if it is not a complete recording.
    """
    for chunk in chunk_stream(path).filter(content=entity, has_timeline=SCAN_TIMELINE):
        yield from _rows_of(chunk.to_record_batch(), required)


def _rows_of(batch: pa.RecordBatch, required: str | None) -> Iterator[Row]:
    columns = {name.rpartition(":")[2]: batch.column(name) for name in batch.schema.names}
    if required is not None and required not in columns:
        return
    scans = columns.pop(SCAN_TIMELINE).to_pylist()
    stamps = columns.pop(STAMP_TIMELINE).cast(pa.int64()).to_pylist()
    columns.pop("rerun.controls.RowId", None)
    for i, (scan, stamp_ns) in enumerate(zip(scans, stamps, strict=True)):
        values = {name: _array(c[i].values) for name, c in columns.items() if c[i].is_valid}
        if required is None or required in values:
            yield Row(scan, stamp_ns, values)


def _array(values: pa.Array) -> Any:  # noqa: ANN401 - of any type
    if pa.types.is_fixed_size_list(values.type):
        flat = values.flatten().to_numpy(zero_copy_only=False)
        return flat.reshape(len(values), values.type.list_size)
    if pa.types.is_list(values.type):
        return [_array(item.values) for item in values]
    return np.asarray(values.to_numpy(zero_copy_only=False))
