"""labels.parquet: a run's labels without its clouds, one row for each labelled scan.

Columns: `scan`, the number of the vertical cloud in the bag; `label` and `label_scan`, one uint8 for each place of the
cloud in its own order, as in the labelled bag. Where several lidars were labelled, `scan` counts the clouds of all in the order
of their stamps, and two columns more tell which each is: `topic`, and `stamp_ns` of its header.
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

_SCHEMA = pa.schema([("scan", pa.int32()), ("label", pa.list_(pa.uint8())), ("label_scan", pa.list_(pa.uint8()))])
_WITH_CLOUDS = pa.schema([*_SCHEMA, ("topic", pa.string()), ("stamp_ns", pa.int64())])
_SCANS_AT_ONCE = 20

ScanLabels = tuple[int, UInt8Array, UInt8Array]
"""Number of a cloud, its `label` and its `label_scan`."""

Cloud = tuple[str, int]
"""Topic and stamp of a cloud."""


def clouds_of(scans: ScanOrder, topics: Sequence[str]) -> Callable[[int], Cloud] | None:
    """What the file tells of each scan by its number; None where all are of one lidar, of which its number tells enough."""
    if len(topics) < 2:
        return None
    return lambda scan: (topics[scans.lidar[scan]], int(scans.stamp_ns[scan]))


class LabelsWriter:
    """Takes the digest of all labels that pass, and keeps them in a file where one is wanted."""

    def __init__(self, path: Path | None, clouds: Callable[[int], Cloud] | None = None) -> None:
        """clouds: see `clouds_of`."""
        self._path, self._clouds = path, clouds
        self._digest = hashlib.sha256()

    @property
    def digest(self) -> str:
        """SHA-256 of all that passed: two runs with the same have the same labels, bit for bit."""
        return self._digest.hexdigest()

    def passing(self, labels: Iterable[ScanLabels]) -> Iterator[ScanLabels]:
        """The same labels, each kept as it passes; the file is there, complete, when the last has passed, and else not at all."""
        with ExitStack() as stack:
            writer: pq.ParquetWriter | None = None
            if self._path is not None:
                part = stack.enter_context(written_whole(self._path))
                writer = stack.enter_context(pq.ParquetWriter(part, self._schema, compression="zstd"))
            waiting: list[ScanLabels] = []
            for index, label, label_scan in labels:
                self._digest.update(np.int64(index).tobytes() + label.tobytes() + label_scan.tobytes())
                if writer is not None:
                    waiting.append((index, label, label_scan))
                    if len(waiting) == _SCANS_AT_ONCE:
                        writer.write_table(self._table(waiting))
                        waiting = []
                yield index, label, label_scan
            if writer is not None and waiting:
                writer.write_table(self._table(waiting))

    @property
    def _schema(self) -> pa.Schema:
        return _SCHEMA if self._clouds is None else _WITH_CLOUDS

    def _table(self, labels: Sequence[ScanLabels]) -> pa.Table:
        scan, label, label_scan = zip(*labels, strict=True)
        columns = [pa.array(scan, pa.int32()), _lists(label), _lists(label_scan)]
        if self._clouds is not None:
            columns += map(pa.array, zip(*map(self._clouds, scan), strict=True))
        return pa.table(columns, schema=self._schema)


def _lists(arrays: tuple[UInt8Array, ...]) -> pa.Array:
    offsets = np.concatenate([[0], np.cumsum([len(array) for array in arrays])])
    return pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), pa.array(np.concatenate(arrays), pa.uint8()))


def read_labels(path: Path, first: int = 0, count: int | None = None) -> dict[int, tuple[UInt8Array, UInt8Array]]:
    """`label` and `label_scan` of the clouds [first, first + count) that were labelled, by their number.

    Raises InputError where the file cannot be read.
    """
    last = np.iinfo(np.int32).max if count is None else first + count
    try:
        table = pq.read_table(path, filters=[("scan", ">=", first), ("scan", "<", last)])
        return {scan: (own, of_scan) for batch in table.to_batches() for scan, own, of_scan in _rows(batch)}
    except (OSError, KeyError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: cannot be read ({error}); make the run again") from error


def stream_labels(path: Path) -> Iterator[tuple[ScanLabels, Cloud | None]]:
    """All that `LabelsWriter` wrote, in its order, some at a time; with each what `clouds_of` told.

    Raises OSError, KeyError or an error of pyarrow's where the file cannot be read.
    """
    for batch in pq.ParquetFile(path).iter_batches(_SCANS_AT_ONCE):
        if "topic" not in batch.schema.names:
            yield from ((labels, None) for labels in _rows(batch))
            continue
        clouds = zip(batch.column("topic").to_pylist(), batch.column("stamp_ns").to_pylist(), strict=True)
        yield from zip(_rows(batch), clouds, strict=True)


def _rows(batch: pa.RecordBatch) -> Iterator[ScanLabels]:
    for scan, *labels in zip(*(batch.column(name) for name in _SCHEMA.names), strict=True):
        label, label_scan = (np.asarray(values.values.to_numpy(), np.uint8) for values in labels)
        yield scan.as_py(), label, label_scan
