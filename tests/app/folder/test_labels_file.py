"""labels.parquet: what is written is read, its digest shows any difference, and files are whole."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from ffmap.app.folder.labels_file import LabelsWriter, ScanLabels, read_labels
from ffmap.loaders.errors import InputError


def made(seed: int) -> list[ScanLabels]:
    rng = np.random.default_rng(seed)
    numbers = np.flatnonzero(rng.random(90) < 0.5).tolist()
    return [
        (number, *(rng.integers(0, 6, size).astype(np.uint8) for _ in range(2)))
        for number, size in zip(numbers, rng.integers(0, 300, len(numbers)), strict=True)
    ]


def written(path: Path | None, labels: list[ScanLabels]) -> str:
    writer = LabelsWriter(path)
    assert len(list(writer.passing(labels))) == len(labels)
    return writer.digest


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path, labels = tmp_path / "labels.parquet", made(1)
    written(path, labels)
    found = read_labels(path)
    assert list(found) == [number for number, _, _ in labels]
    for number, label, label_scan in labels:
        np.testing.assert_array_equal(found[number][0], label)
        np.testing.assert_array_equal(found[number][1], label_scan)
    first, last = labels[10][0], labels[30][0]
    some = read_labels(path, first, last - first)
    assert list(some) == [number for number, _, _ in labels[10:30]]
    assert pq.read_table(path).schema.names == ["scan", "label", "label_scan"]


def test_the_digest_shows_any_difference(tmp_path: Path) -> None:
    labels = made(2)
    digest = written(None, labels)
    assert written(tmp_path / "labels.parquet", labels) == digest
    for column in (1, 2):
        other = [list(row) for row in labels]
        place = next(i for i, row in enumerate(other) if len(row[column]))
        other[place][column] = other[place][column] ^ 1
        assert written(None, [tuple(row) for row in other]) != digest
    assert written(None, [(n + 1, a, b) for n, a, b in labels]) != digest


def test_no_file_is_left_of_a_run_that_failed_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    path = tmp_path / "labels.parquet"

    def failing():
        yield from made(3)[:25]
        raise RuntimeError("the disk is full")

    with pytest.raises(RuntimeError, match="disk"):
        list(LabelsWriter(path).passing(failing()))
    assert list(tmp_path.iterdir()) == []
    written(path, made(4))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match=r"labels\.parquet"):
        read_labels(path)
