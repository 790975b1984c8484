"""The cache of odometries: what was kept comes back, what is not as it was written never does, and it stays small."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from ffmap.app.run import odometry_cache
from ffmap.app.run.odometry_cache import Writer, entries, entry_name, has_any, look_up

KEY = "0123456789abcdef01234567"
CONTENT, OTHER = "a" * 32, "b" * 32
FILES = [{"index": np.arange(5), "T": np.eye(4)}, {"weight": np.array([0.5, 1.0])}]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(odometry_cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache" / "odometry"


def keep(key: str = KEY, content: str = CONTENT) -> Writer:
    with Writer(key) as writer:
        for arrays in FILES:
            writer.add(arrays)
        writer.complete(content)
    return writer


def test_what_was_kept_comes_back_for_the_same_clouds_alone() -> None:
    assert not has_any(KEY)
    assert keep().failure is None
    assert has_any(KEY)
    found = look_up(KEY, CONTENT)
    assert found.damage is None
    assert found.files is not None
    for file, expected in zip(found.files, FILES, strict=True):
        assert file.keys() == expected.keys()
        assert all(np.array_equal(file[name], expected[name]) for name in expected)
    assert look_up(KEY, OTHER).files is None
    assert look_up(KEY[::-1], CONTENT).files is None


def flip_a_bit(entry: Path) -> None:
    data = bytearray((entry / "000000.npz").read_bytes())
    # Within an array's values, where nothing but a checksum notices.
    data[data.index(np.eye(4).tobytes()) + 3] ^= 1
    (entry / "000000.npz").write_bytes(data)


@pytest.mark.parametrize(
    "damage",
    [
        flip_a_bit,
        lambda entry: (entry / "000001.npz").unlink(),
        lambda entry: (entry / "000001.npz").write_bytes(b""),
        lambda entry: (entry / "complete").write_bytes(b""),
        lambda entry: (entry / "complete").write_text('{"files": {"000000.npz": 3}}'),
        lambda entry: (entry / "complete").write_text("[]"),
        lambda entry: (entry / "complete").unlink(),
    ],
)
def test_damaged_entry_is_told_and_thrown_away(damage, cache: Path) -> None:
    keep()
    entry = cache / entry_name(KEY, CONTENT)
    damage(entry)
    found = look_up(KEY, CONTENT)
    assert found.files is None
    assert found.damage
    assert list(cache.iterdir()) == []
    keep()
    assert look_up(KEY, CONTENT).files is not None


def test_cache_that_cannot_be_written_is_told_and_stops_nobody(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.parent.mkdir()
    cache.write_text("a file in the place of the folder")
    assert keep().failure is not None
    cache.unlink()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert keep().failure == "No space left on device"
    assert not has_any(KEY)
    assert list(cache.iterdir()) == []


def test_what_was_not_used_for_longest_goes_first(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"{i:024x}" for i in range(5)]
    for age, name in zip((500, 400, 300, 200), names, strict=False):
        keep(name)
        then = time.time() - age
        os.utime(cache / entry_name(name, CONTENT) / "complete", (then, then))
    # The oldest is used again.
    assert look_up(names[0], CONTENT).files is not None
    monkeypatch.setattr(odometry_cache, "LIMIT_BYTES", 3.5 * entries()[0].size_bytes)
    keep(names[4])
    assert {entry.path.name[:24] for entry in entries()} == {names[4], names[0], names[3]}


def test_parts_of_killed_runs_go_in_time(cache: Path) -> None:
    abandoned, fresh = cache / f"{KEY}.1.part", cache / f"{KEY}.2.part"
    for part in (abandoned, fresh):
        part.mkdir(parents=True)
        (part / "000000.npz").touch()
    os.utime(abandoned, (0, 0))
    keep()
    assert not abandoned.exists()
    assert fresh.exists()
