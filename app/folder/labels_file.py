"""labels.parquet: the labels of a run without its clouds, one row for each labelled scan.

Columns: `scan`, the number of the vertical cloud in the bag; `label` and `label_scan`, a uint8 for
each place of the cloud in its own order, as in the labelled bag. With several lidars, `scan` counts
the clouds of all in the order of their stamps, and `topic` and `stamp_ns` name the cloud.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from ffmap.algorithms.base.scan import UInt8Array
from ffmap.app.folder.atomic import written_whole
from ffmap.loaders.errors import InputError
from ffmap.loaders.scan_order import ScanOrder

_LABELS = pa.list_(pa.uint8())
_SCHEMA = pa.schema([("scan", pa.int32()), ("label", _LABELS), ("label_scan", _LABELS)])
_WITH_CLOUDS = pa.schema([*_SCHEMA, ("topic", pa.string()), ("stamp_ns", pa.int64())])
_SCANS_AT_ONCE = 20

ScanLabels = tuple[int, UInt8Array, UInt8Array]
"""Number of a cloud, its `label` and its `label_scan`."""

Cloud = tuple[str, int]
"""Topic and stamp of a cloud."""


def clouds_of(scans: ScanOrder, topics: Sequence[str]) -> Callable[[int], Cloud] | None:
    """Return what names the cloud of a scan; None with one lidar, where the number does."""
    if len(topics) < 2:
        return None
    return lambda scan: (topics[scans.lidar[scan]], int(scans.stamp_ns[scan]))


class LabelsWriter:
    """Writes labels to a file, if one is wanted, and computes their digest."""

    def __init__(self, path: Path | None, clouds: Callable[[int], Cloud] | None = None) -> None:
        """clouds: see `clouds_of`."""
        self._path, self._clouds = path, clouds
        self._schema = _SCHEMA if clouds is None else _WITH_CLOUDS
        self._digest = hashlib.sha256()

    @property
    def digest(self) -> str:
        """SHA-256 of all labels so far."""
        return self._digest.hexdigest()

    def passing(self, labels: Iterable[ScanLabels]) -> Iterator[ScanLabels]:
        """Yield the same labels; the file appears when the last one has passed."""
        with ExitStack() as stack:
            writer: pq.ParquetWriter | None = None
            if self._path is not None:
                part = stack.enter_context(written_whole(self._path))
                parquet = pq.ParquetWriter(part, self._schema, compression="zstd")
                writer = stack.enter_context(parquet)
            waiting: list[ScanLabels] = []
            for scan, label, label_scan in labels:
                number = np.int64(scan).tobytes()
                self._digest.update(number + label.tobytes() + label_scan.tobytes())
                waiting.append((scan, label, label_scan))
                if writer is not None and len(waiting) == _SCANS_AT_ONCE:
                    writer.write_table(self._table(waiting))
                waiting = waiting[: len(waiting) % _SCANS_AT_ONCE]
                yield scan, label, label_scan
            if writer is not None and waiting:
                writer.write_table(self._table(waiting))

    def _table(self, labels: Sequence[ScanLabels]) -> pa.Table:
        scan, label, label_scan = zip(*labels, strict=True)
        columns = [pa.array(scan, pa.int32()), _lists(label), _lists(label_scan)]
        if self._clouds is not None:
            columns += map(pa.array, zip(*map(self._clouds, scan), strict=True))
        return pa.table(columns, schema=self._schema)


def _lists(arrays: tuple[UInt8Array, ...]) -> pa.Array:
    ends = pa.array(np.cumsum([0, *map(len, arrays)]), pa.int32())
    return pa.ListArray.from_arrays(ends, pa.array(np.concatenate(arrays), pa.uint8()))


def read_labels(
    path: Path, first: int = 0, count: int | None = None
) -> dict[int, tuple[UInt8Array, UInt8Array]]:
    """Read `label` and `label_scan` of the clouds [first, first + count) by their number.

    Raises InputError where the file cannot be read.
    """
    last = np.iinfo(np.int32).max if count is None else first + count
    try:
        table = pq.read_table(path, filters=[("scan", ">=", first), ("scan", "<", last)])
        rows = (row for batch in table.to_batches() for row in _rows(batch))
        return {scan: (label, label_scan) for scan, label, label_scan in rows}
    except (OSError, KeyError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: cannot be read ({error}); make the run again") from error


def stream_labels(path: Path) -> Iterator[tuple[ScanLabels, Cloud | None]]:
    """Yield all labels in their order, each with its cloud, see `clouds_of`.

    Raises OSError, KeyError or an error of pyarrow where the file cannot be read.
    """
    for batch in pq.ParquetFile(path).iter_batches(_SCANS_AT_ONCE):
        if "topic" not in batch.schema.names:
            yield from ((labels, None) for labels in _rows(batch))
            continue
        topics, stamps_ns = (batch.column(name).to_pylist() for name in ("topic", "stamp_ns"))
        yield from zip(_rows(batch), zip(topics, stamps_ns, strict=True), strict=True)


def _rows(batch: pa.RecordBatch) -> Iterator[ScanLabels]:
    for scan, *labels in zip(*(batch.column(name) for name in _SCHEMA.names), strict=True):
        label, label_scan = (np.asarray(values.values.to_numpy(), np.uint8) for values in labels)
        yield scan.as_py(), label, label_scan
