"""labels.parquet: the labels of a run without its clouds, one row for each labelled scan."""

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from ffmap.algorithms.base.scan import UInt8Array
from ffmap.app.folder.atomic import written_whole
from ffmap.loaders.errors import InputError

_LABELS = pa.list_(pa.uint8())
_SCHEMA = pa.schema(
    [
        ("scan", pa.int32()),
        ("topic", pa.string()),
        ("stamp_ns", pa.int64()),
        ("label", _LABELS),
        ("label_scan", _LABELS),
    ]
)
_SCANS_AT_ONCE = 20


class ScanLabels(NamedTuple):
    """The labels of a scan, for each place of its cloud in the cloud's order.

    scan: its number among the clouds of all vertical lidars, by stamp.
    label, label_scan: (cloud_size,) final, and by the scan alone.
    """

    scan: int
    topic: str
    stamp_ns: int
    label: UInt8Array
    label_scan: UInt8Array


def write_labels(path: Path | None, labels: Iterable[ScanLabels]) -> str:
    """Write labels to a file, if one is wanted, and return the SHA-256 of them all."""
    digest, remaining = hashlib.sha256(), iter(labels)
    with ExitStack() as stack:
        writer: pq.ParquetWriter | None = None
        if path is not None:
            part = stack.enter_context(written_whole(path))
            writer = stack.enter_context(pq.ParquetWriter(part, _SCHEMA, compression="zstd"))
        while rows := list(islice(remaining, _SCANS_AT_ONCE)):
            for row in rows:
                number = np.int64(row.scan).tobytes()
                digest.update(number + row.label.tobytes() + row.label_scan.tobytes())
            if writer is not None:
                columns = dict(zip(ScanLabels._fields, zip(*rows, strict=True), strict=True))
                writer.write_table(pa.table(columns, schema=_SCHEMA))
    return digest.hexdigest()


def read_labels(path: Path, first: int = 0, count: int | None = None) -> dict[int, ScanLabels]:
    """Read the labels of the scans [first, first + count) by their number.

    Raises InputError where the file cannot be read.
    """
    last = np.iinfo(np.int32).max if count is None else first + count
    try:
        table = pq.read_table(path, filters=[("scan", ">=", first), ("scan", "<", last)])
        return {row.scan: row for batch in table.to_batches() for row in _rows(batch)}
    except (OSError, KeyError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: cannot be read ({error}); make the run again") from error


def stream_labels(path: Path) -> Iterator[ScanLabels]:
    """Yield all labels in their order.

    Raises OSError, KeyError or an error of pyarrow where the file cannot be read.
    """
    for batch in pq.ParquetFile(path).iter_batches(_SCANS_AT_ONCE):
        yield from _rows(batch)


def _rows(batch: pa.RecordBatch) -> Iterator[ScanLabels]:
    for scan, topic, stamp_ns, *labels in zip(
        *(batch.column(name) for name in ScanLabels._fields), strict=True
    ):
        label, label_scan = (np.asarray(values.values.to_numpy(), np.uint8) for values in labels)
        yield ScanLabels(scan.as_py(), topic.as_py(), stamp_ns.as_py(), label, label_scan)
