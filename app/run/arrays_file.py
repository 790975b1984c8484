"""Named arrays in a file that is mapped into memory rather than read: an Arrow file of one row, a column for each array.

What many steps ask for again and again, as the rays of all scans, then costs neither copies nor memory of the process.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]

from ffmap.app.run.arrays import Arrays


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays of any numbers, flags or texts of a fixed length."""
    fields, columns = [], []
    for name, values in arrays.items():
        about = {"dtype": values.dtype.str, "shape": json.dumps(values.shape)}
        fields.append(pa.field(name, pa.large_binary(), metadata=about))
        ends, content = np.array([0, values.nbytes], np.int64), np.ascontiguousarray(values).reshape(-1).view(np.uint8)
        columns.append(pa.Array.from_buffers(pa.large_binary(), 1, [None, pa.py_buffer(ends), pa.py_buffer(content)]))
    schema = pa.schema(fields)
    with pa.ipc.new_file(str(path), schema) as writer:
        writer.write_batch(pa.record_batch(columns, schema=schema))


def map_arrays(path: Path) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a file, by their names; they hold as long as they are used, and changes to them stay in memory."""
    whole = np.memmap(path, np.uint8, "c")
    batch = pa.ipc.open_file(pa.py_buffer(whole)).get_batch(0)
    return {
        field.name: _mapped(whole, field.metadata, column)
        for field, column in zip(batch.schema, batch.columns, strict=True)
    }


def _mapped(whole: npt.NDArray[np.uint8], about: dict[bytes, bytes], column: pa.Array) -> npt.NDArray[Any]:
    dtype, shape = np.dtype(about[b"dtype"].decode()), json.loads(about[b"shape"])
    if 0 in shape:
        return np.empty(shape, dtype)
    first = column.buffers()[2].address - whole.ctypes.data
    size = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
    return np.asarray(whole[first : first + size]).view(dtype).reshape(shape)
