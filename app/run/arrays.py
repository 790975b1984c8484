"""Dataclasses of arrays as files: Arrow files of one row, which are mapped into memory, not read.

Ray evidence is read many times while the building is fused. A mapped file costs no memory of the
process and no copy.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]

from ffmap.app.folder.atomic import written_whole

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    T = TypeVar("T", bound=DataclassInstance)

Arrays = Mapping[str, npt.NDArray[Any]]


def pack(answer: "DataclassInstance", prefix: str = "") -> Arrays:
    """Name the fields of a dataclass of arrays and numbers."""
    return {prefix + f.name: np.asarray(getattr(answer, f.name)) for f in fields(answer)}


def unpack(kind: "type[T]", arrays: Arrays, prefix: str = "") -> "T":
    """Invert `pack`."""
    return kind(**{f.name: _typed(f.type, arrays[prefix + f.name]) for f in fields(kind)})


def pack_rows(rows: "Sequence[DataclassInstance]", prefix: str = "") -> Arrays:
    """Concatenate each field of several dataclasses; arrays of any lengths keep them beside."""
    packed: dict[str, npt.NDArray[Any]] = {}
    for name in [f.name for f in fields(rows[0])] if rows else []:
        values = [getattr(row, name) for row in rows]
        if isinstance(values[0], np.ndarray):
            packed[f"{prefix}{name}_length"] = np.array([len(v) for v in values], np.int64)
            packed[prefix + name] = np.concatenate(values)
        else:
            packed[prefix + name] = np.array(values)
    return packed


def unpack_rows(kind: "type[T]", arrays: Arrays, prefix: str = "") -> "list[T]":
    """Invert `pack_rows`."""
    names = [f.name for f in fields(kind)]
    if prefix + names[0] not in arrays:
        return []
    columns: list[Sequence[Any]] = []
    for name in names:
        whole, length = arrays[prefix + name], arrays.get(f"{prefix}{name}_length")
        if length is None:
            columns.append(whole.tolist())
        else:
            ends = np.cumsum(length)
            columns.append([whole[e - n : e] for n, e in zip(length, ends, strict=True)])
    return [kind(*row) for row in zip(*columns, strict=True)]


def _typed(kind: Any, stored: npt.NDArray[Any]) -> Any:  # noqa: ANN401 - a field's type and value
    return kind(stored) if kind in (int, float, bool) else stored


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays of numbers, flags or texts; the file appears when it is complete."""
    columns, schema = [], []
    for name, values in arrays.items():
        about = {"dtype": values.dtype.str, "shape": json.dumps(values.shape)}
        schema.append(pa.field(name, pa.large_binary(), metadata=about))
        ends = np.array([0, values.nbytes], np.int64)
        content = np.ascontiguousarray(values).reshape(-1).view(np.uint8)
        buffers = [None, pa.py_buffer(ends), pa.py_buffer(content)]
        columns.append(pa.Array.from_buffers(pa.large_binary(), 1, buffers))
    with written_whole(path) as part, pa.ipc.new_file(str(part), pa.schema(schema)) as writer:
        writer.write_batch(pa.record_batch(columns, schema=pa.schema(schema)))


def map_arrays(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Map the arrays of a file by their names; changes to them stay in memory."""
    whole = np.memmap(path, np.uint8, "c")
    batch = pa.ipc.open_file(pa.py_buffer(whole)).get_batch(0)
    return {
        field.name: _mapped(whole, field.metadata, column)
        for field, column in zip(batch.schema, batch.columns, strict=True)
    }


def _mapped(
    whole: npt.NDArray[np.uint8], about: dict[bytes, bytes], column: pa.Array
) -> npt.NDArray[Any]:
    dtype, shape = np.dtype(about[b"dtype"].decode()), json.loads(about[b"shape"])
    if 0 in shape:
        return np.empty(shape, dtype)
    first = column.buffers()[2].address - whole.ctypes.data
    size = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
    return np.asarray(whole[first : first + size]).view(dtype).reshape(shape)
