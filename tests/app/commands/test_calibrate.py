"""ffmap calibrate on a real bag: the rig file, the standard deviations, and a picture."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.rig import Rig
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.parts import of_topics
from tests.program import ffmap, ffmap_here, rig_of, with_cache, write_rig


def calibrate(folder: Path, bag: str, *words: object) -> "subprocess.CompletedProcess[str]":
    return ffmap_here(with_cache(folder / "cache"), "calibrate", bag, *words, cwd=folder)


def T_vertical_horizontal(rig: Rig) -> FloatArray:  # noqa: N802 - the field's notation
    assert rig.horizontal is not None
    assert rig.vertical is not None
    return transforms.invert(rig.vertical.T_base_sensor) @ rig.horizontal.T_base_sensor


def assert_same_extrinsics(found: Rig, expected: Rig) -> None:
    T = T_vertical_horizontal(expected) @ transforms.invert(T_vertical_horizontal(found))
    off = transforms.to_twist(T)
    assert np.degrees(np.linalg.norm(off[:3])) < 0.3
    assert np.linalg.norm(off[3:]) < 0.02


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibrate")
    drive = SimulationSettings(building="small", seed=3, sensor="vlp16", duration_s=14.0)
    simulate(path / "drive.bag", drive)
    one = SimulationSettings(building="small", duration_s=1.0, sensor="vlp16", lidars="one")
    simulate(path / "one.bag", one)
    return path


def test_extrinsics_and_clock_are_refined(folder: Path) -> None:
    rig = rig_of(folder / "drive.bag")
    turn = Rotation.from_euler("xyz", [3.0, -2.0, 3.0], degrees=True)
    T_off = transforms.make_transform(turn, [0.05, 0.06, -0.05])
    write_rig(folder / "guess.toml", rig, T_off, clock_s=0.04)
    words = ("--rig", "guess.toml", "--out", "rig.toml", "--recording", "both.rrd", "--quiet")
    cache = with_cache(folder / "cache")
    done = ffmap(cache, "calibrate", "drive.bag", *words, cwd=folder)
    assert done.returncode == 0, done.stderr
    found = rig_of(folder / "drive.bag", folder / "rig.toml")
    assert_same_extrinsics(found, rig)
    assert found.vertical is not None
    assert abs(found.vertical.decoding.clock_ns) < 10e6
    assert re.search(r"clock\s.*ms", done.stdout)
    before, after = map(float, re.findall(r"([\d.]+) cm (?:as given|refined)", done.stdout))
    assert after < 2.0 < before
    assert (folder / "both.rrd").stat().st_size > 100_000
    info = ffmap_here(cache, "info", "drive.bag", "--rig", "rig.toml", cwd=folder)
    assert info.returncode == 0, info.stderr


def test_extrinsics_are_found_without_a_guess(folder: Path) -> None:
    """A bag without transforms: the lidars are named on the command line."""
    rig = rig_of(folder / "drive.bag")
    assert rig.horizontal is not None
    assert rig.vertical is not None
    topics = [rig.horizontal.topic, rig.vertical.topic]
    bare = of_topics(folder / "drive.bag", topics)
    named = ("--horizontal", topics[0], "--vertical", topics[1], "--quiet")
    assert calibrate(folder, bare.name, *named).returncode == 2
    done = calibrate(folder, bare.name, *named, "--from-motion", "--out", "bare.toml")
    assert done.returncode == 0, done.stderr
    assert_same_extrinsics(rig_of(bare, folder / "bare.toml"), rig)


def test_a_single_lidar_is_refused(folder: Path) -> None:
    done = calibrate(folder, "one.bag")
    assert done.returncode == 2
    assert "give a bag of two" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (folder / "one.rig.toml").exists()
