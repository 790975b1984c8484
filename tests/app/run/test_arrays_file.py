from pathlib import Path

import numpy as np
import pytest

from ffmap.app.run.arrays_file import map_arrays, write_arrays

ARRAYS = {
    "points": np.random.default_rng(0).normal(size=(1_000, 3)).astype(np.float32),
    "first": np.array([0, 3, 8], np.int64),
    "flags": np.array([True, False, True]),
    "reasons": np.array(["no points", "no pose at its time"]),
    "one": np.asarray(0.25),
    "none": np.zeros((0, 4, 4)),
    "turned": np.arange(12.0).reshape(3, 4).T,
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_come_back_as_they_were(tmp_path: Path, name: str) -> None:
    write_arrays(tmp_path / "a.arrow", ARRAYS)
    found = map_arrays(tmp_path / "a.arrow")
    assert list(found) == list(ARRAYS)
    assert found[name].dtype == ARRAYS[name].dtype
    np.testing.assert_array_equal(found[name], ARRAYS[name])


def test_arrays_can_be_changed_without_their_file(tmp_path: Path) -> None:
    write_arrays(tmp_path / "a.arrow", ARRAYS)
    before = (tmp_path / "a.arrow").read_bytes()
    found = map_arrays(tmp_path / "a.arrow")["points"]
    assert found.flags.writeable
    assert found.flags.aligned
    found[:] = 0.0
    assert (tmp_path / "a.arrow").read_bytes() == before


def test_arrays_outlive_their_file(tmp_path: Path) -> None:
    write_arrays(tmp_path / "a.arrow", ARRAYS)
    found = map_arrays(tmp_path / "a.arrow")["points"]
    (tmp_path / "a.arrow").unlink()
    np.testing.assert_array_equal(found, ARRAYS["points"])


def test_no_arrays_are_a_file_too(tmp_path: Path) -> None:
    write_arrays(tmp_path / "a.arrow", {})
    assert map_arrays(tmp_path / "a.arrow") == {}
