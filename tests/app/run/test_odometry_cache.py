"""The cache of odometries: it returns what was written, detects damage, and stays small."""

import os
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.run import odometry_cache
from ffmap.app.run.odometry_cache import CacheWriter, Result, read_cached

KEY, OTHER_KEY = "0123456789abcdef01234567", "f" * 24
BAG, OTHER_BAG = "a" * 32, "b" * 32


def results() -> list[Result]:
    points = np.random.default_rng(0).normal(size=(300, 3)).astype(np.float32)
    figures = dict.fromkeys(
        ("threshold_m", "correction_m", "residual_m", "inlier_share", "refined_m"), 0.5
    )
    figures |= {
        "refined_inlier_share": float("nan"),
        "weakest_share": 0.1,
        "agreement": 1.0,
        "rival": 0.0,
    }
    scans: list[Result] = [
        Registration(
            index=i, stamp_ns=10**9 * i, T_odom_sensor=np.eye(4) * (i + 1),
            keypoints_sensor=points[:i],
            local_map_odom=points[: 7 * (i % 3)], refused=i == 5, milliseconds=2.0, **figures,
        )
        for i in range(120)
    ]  # fmt: skip
    T, ones = np.tile(np.eye(4), (3, 1, 1)), np.arange(3)
    return [
        *scans,
        PoseGraph(np.eye(4), ones, T, 2 * T, ones, ones, 0.5 * ones, 0.5 * ones, 0.5 * ones),
    ]


RESULTS = results()


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(odometry_cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache" / "odometry"


def keep(key: str = KEY, bag: str = BAG) -> CacheWriter:
    writer = CacheWriter(key, lambda: bag)
    assert list(writer.keep(RESULTS)) == RESULTS
    return writer


def is_cached(key: str = KEY, bag: str = BAG) -> bool:
    return read_cached(key, lambda: bag).results is not None


def test_what_was_written_is_read_for_the_same_bag_alone() -> None:
    assert not is_cached()
    assert keep().failure is None
    found = read_cached(KEY, lambda: BAG)
    assert found.damage is None
    assert found.results is not None
    for own, expected in zip(found.results, RESULTS, strict=True):
        assert type(own) is type(expected)
        for name, value in vars(expected).items():
            np.testing.assert_array_equal(getattr(own, name), value, err_msg=name)
    assert not is_cached(bag=OTHER_BAG)
    assert not is_cached(OTHER_KEY)
    # The bag is not read where the cache has nothing of these settings.
    read_cached(OTHER_KEY, lambda: pytest.fail("hashed"))


def flip_a_bit(path: Path) -> None:
    with zipfile.ZipFile(path) as file:
        data = bytearray(path.read_bytes())
        # Within an array's values, where nothing but a checksum notices.
        data[file.getinfo("000001/T_odom_sensor").header_offset + 200] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    "damage",
    [
        flip_a_bit,
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:-100]),
        lambda path: path.write_bytes(
            path.read_bytes()[:1000] + bytes(1000) + path.read_bytes()[2000:]
        ),
    ],
)
def test_a_damaged_file_is_reported_and_removed(damage, cache: Path) -> None:
    keep()
    damage(cache / f"{KEY}-{BAG}.zip")
    found = read_cached(KEY, lambda: BAG)
    assert found.results is None
    assert "was damaged" in str(found.damage)
    assert list(cache.iterdir()) == []
    keep()
    assert is_cached()


def test_a_cache_that_cannot_be_written_is_reported(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache.parent.mkdir()
    cache.write_text("a file in the place of the folder")
    assert "cannot be kept in the cache" in str(keep().failure)
    cache.unlink()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array", full)
    assert "(No space left on device)" in str(keep().failure)
    assert not is_cached()
    assert list(cache.iterdir()) == []


def test_an_odometry_that_is_interrupted_leaves_nothing(cache: Path) -> None:
    kept = CacheWriter(KEY, lambda: BAG).keep(RESULTS)
    for _ in range(60):
        next(kept)
    kept.close()
    assert list(cache.iterdir()) == []


def test_what_was_not_used_for_longest_is_removed_first(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = [f"{i:024x}" for i in range(5)]
    for age, key in zip((500, 400, 300, 200), keys, strict=False):
        keep(key)
        then = time.time() - age
        os.utime(cache / f"{key}-{BAG}.zip", (then, then))
    assert is_cached(keys[0])
    abandoned, fresh = cache / f"{KEY}-1.part", cache / f"{KEY}-2.part"
    for part in (abandoned, fresh):
        part.touch()
    os.utime(abandoned, (0, 0))
    size = (cache / f"{keys[0]}-{BAG}.zip").stat().st_size
    monkeypatch.setattr(odometry_cache, "LIMIT_BYTES", 3.5 * size)
    keep(keys[4])
    assert {path.name[:24] for path in cache.glob("*.zip")} == {keys[4], keys[0], keys[3]}
    assert list(cache.glob("*.part")) == [fresh]
