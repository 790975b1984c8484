from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.app.run.arrays import (
    map_arrays,
    pack,
    pack_rows,
    unpack,
    unpack_rows,
    write_arrays,
)
from ffmap.loaders.scans import SkippedScan

ARRAYS = {
    "points": np.random.default_rng(0).normal(size=(1_000, 3)).astype(np.float32),
    "flags": np.array([True, False, True]),
    "reasons": np.array(["no points", "no pose at its time"]),
    "one": np.asarray(0.25),
    "none": np.zeros((0, 4, 4)),
    "turned": np.arange(12.0).reshape(3, 4).T,
}


@dataclass(frozen=True)
class Part:
    number: int
    T: FloatArray
    rows: IntArray


def test_arrays_come_back_as_they_were_and_outlive_their_file(tmp_path: Path) -> None:
    path = tmp_path / "a.arrow"
    write_arrays(path, ARRAYS)
    written, found = path.read_bytes(), map_arrays(path)
    assert list(found) == list(ARRAYS)
    assert found["points"].flags.writeable
    found["points"][0] = 0.0
    assert path.read_bytes() == written
    found = map_arrays(path)
    path.unlink()
    for name, values in ARRAYS.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values)


def test_dataclasses_come_back_with_arrays_of_any_lengths(tmp_path: Path) -> None:
    parts = [Part(i, np.eye(4) * i, np.arange(3 * i, dtype=np.int32)) for i in (2, 0, 5)]
    skipped = [SkippedScan(3, 4, "no points"), SkippedScan(5, 6, "ValueError: x", "Traceback\n...")]
    arrays = {**pack_rows(parts), **pack_rows(skipped, "skipped_"), **pack_rows([], "none_")}
    write_arrays(tmp_path / "a.arrow", {**arrays, **pack(parts[2], "last_")})
    found = map_arrays(tmp_path / "a.arrow")
    read = [*unpack_rows(Part, found), unpack(Part, found, "last_")]
    for own, expected in zip(read, [*parts, parts[2]], strict=True):
        assert type(own.number) is int
        assert own.number == expected.number
        np.testing.assert_array_equal(own.T, expected.T)
        np.testing.assert_array_equal(own.rows, expected.rows)
        assert own.rows.dtype == np.int32
    assert unpack_rows(SkippedScan, found, "skipped_") == skipped
    assert unpack_rows(Part, found, "none_") == []
