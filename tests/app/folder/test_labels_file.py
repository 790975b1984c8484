"""labels.parquet: what is written is read, its digest shows any difference, and files are whole."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ffmap.app.folder.labels_file import ScanLabels, read_labels, stream_labels, write_labels
from ffmap.loaders.errors import InputError


def made(seed: int) -> list[ScanLabels]:
    rng = np.random.default_rng(seed)
    numbers = np.flatnonzero(rng.random(90) < 0.5).tolist()
    sizes = rng.integers(0, 300, len(numbers))
    return [
        ScanLabels(
            number,
            f"/lidar_{number % 2}",
            10**18 + number,
            *rng.integers(0, 6, (2, size)).astype(np.uint8),
        )
        for number, size in zip(numbers, sizes, strict=True)
    ]


def assert_same(found: list[ScanLabels], expected: list[ScanLabels]) -> None:
    for own, other in zip(found, expected, strict=True):
        assert own[:3] == other[:3]
        np.testing.assert_array_equal(own.label, other.label)
        np.testing.assert_array_equal(own.label_scan, other.label_scan)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path, labels = tmp_path / "labels.parquet", made(1)
    write_labels(path, labels)
    assert_same(list(stream_labels(path)), labels)
    first, last = labels[10].scan, labels[30].scan
    some = read_labels(path, first, last - first)
    assert list(some) == [row.scan for row in labels[10:30]]
    assert_same(list(some.values()), labels[10:30])


def test_the_digest_shows_any_difference(tmp_path: Path) -> None:
    labels = made(2)
    digest = write_labels(None, labels)
    assert write_labels(tmp_path / "labels.parquet", labels) == digest
    place = next(i for i, row in enumerate(labels) if len(row.label))
    for name in ("label", "label_scan"):
        other = labels[place]._replace(**{name: getattr(labels[place], name) ^ 1})
        assert write_labels(None, [*labels[:place], other, *labels[place + 1 :]]) != digest
    assert write_labels(None, [row._replace(scan=row.scan + 1) for row in labels]) != digest


def test_no_file_is_left_of_a_run_that_failed_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    path = tmp_path / "labels.parquet"

    def failing() -> Iterator[ScanLabels]:
        yield from made(3)[:25]
        raise RuntimeError("the disk is full")

    with pytest.raises(RuntimeError, match="disk"):
        write_labels(path, failing())
    assert list(tmp_path.iterdir()) == []
    write_labels(path, made(4))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match=r"labels\.parquet"):
        read_labels(path)
