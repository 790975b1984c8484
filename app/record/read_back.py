"""Recordings read back: rows of an entity in the order of the file, also from cut recordings."""

import subprocess
import sys
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

from ffmap.blueprints.entities import SCAN_TIMELINE, STAMP_TIMELINE
from ffmap.loaders.errors import InputError


@dataclass(frozen=True, eq=False)
class Row:
    """The components of an entity at one scan, by their short names, as arrays."""

    scan: int
    stamp_ns: int
    values: dict[str, Any]


@dataclass(frozen=True)
class ReadableRecording:
    """A recording that can be read to its end.

    path: the recording, or a repaired copy. warning: None if the recording is complete.
    """

    path: Path
    warning: str | None = None

    @property
    def whole(self) -> bool:
        """Whether the recording is complete."""
        return self.warning is None


@contextmanager
def readable(path: Path) -> Iterator[ReadableRecording]:
    """Open a recording that may be cut anywhere; of a cut one, a copy up to the cut.

    Raises InputError if it is no recording, or nothing of it is left.
    """
    has_footer, error = _check(path)
    if error is None:
        warning = None if has_footer else f"{path}: has no footer: it was cut, or its writer killed"
        yield ReadableRecording(path, warning)
        return
    if "Not an RRD" in error or "too small" in error:
        raise InputError(f"{path}: is not a Rerun recording; run ffmap again")
    with tempfile.TemporaryDirectory(prefix="ffmap-cut-") as folder:
        copy = Path(folder) / path.name
        command = ["-m", "rerun", "rrd", "merge", "--continue-on-error", "-o", str(copy), str(path)]
        subprocess.run([sys.executable, *command], capture_output=True, check=False)
        if not copy.exists() or _check(copy)[1] is not None:
            raise InputError(f"{path}: was cut before its first message; run ffmap again")
        yield ReadableRecording(copy, f"{path}: was cut; it is read up to the cut")


def _check(path: Path) -> tuple[bool, str | None]:
    """Return whether a recording has a footer, and why it cannot be read (None if it can)."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            RrdReader(path).stream()
        except (RuntimeError, ValueError) as error:
            return False, str(error)
    return not any("no footer" in str(warning.message) for warning in caught), None


def chunk_stream(path: Path) -> LazyChunkStream:
    """Return all chunks of a recording, in the order of the file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that there is no footer
        return RrdReader(path).stream()


def rows(path: Path, entity: str | Sequence[str], required: str | None = None) -> Iterator[Row]:
    """Yield the rows of entities on the timeline `scan`, in the order of the file.

    required: rows without this component are omitted.
    Raises InputError if the recording cannot be read.
    """
    try:
        for chunk in chunk_stream(path).filter(content=entity, has_timeline=SCAN_TIMELINE):
            yield from _rows_of(chunk.to_record_batch(), required)
    except RuntimeError as error:
        why = str(error).splitlines()[0]
        raise InputError(f"{path}: cannot be read ({why}); run ffmap again") from error


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
