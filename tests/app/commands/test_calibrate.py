"""ffmap calibrate on a real bag: a rig file with which runs go on, how certain each value is, and a picture."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.parts import of_topics
from tests.program import ffmap, ffmap_here, rig_of, with_cache, write_rig


def calibrate(folder: Path, bag: str, *words: object) -> "subprocess.CompletedProcess[str]":
    return ffmap_here(with_cache(folder / "cache"), "calibrate", bag, *words, cwd=folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibrate")
    simulate(path / "drive.bag", SimulationSettings(building="small", seed=3, sensor="vlp16", duration_s=14.0))
    simulate(path / "one.bag", SimulationSettings(building="small", duration_s=1.0, sensor="vlp16", lidars="one"))
    return path


def test_a_rig_file_is_written_from_a_mount_that_is_off(folder: Path) -> None:
    rig = rig_of(folder / "drive.bag")
    off = transforms.make_transform(Rotation.from_euler("xyz", [3.0, -2.0, 3.0], degrees=True), [0.05, 0.06, -0.05])
    write_rig(folder / "guess.toml", rig, off, clock_s=0.04)
    words = ("--rig", "guess.toml", "--out", "rig.toml", "--recording", "both.rrd", "--quiet")
    done = ffmap(with_cache(folder / "cache"), "calibrate", "drive.bag", *words, cwd=folder)
    assert done.returncode == 0, done.stderr
    found = rig_of(folder / "drive.bag", folder / "rig.toml")
    assert rig.horizontal is not None
    assert rig.vertical is not None
    assert found.horizontal is not None
    assert found.vertical is not None
    np.testing.assert_allclose(found.horizontal.T_base_sensor, rig.horizontal.T_base_sensor, atol=1e-4)
    left = transforms.to_twist(transforms.invert(rig.vertical.T_base_sensor) @ found.vertical.T_base_sensor)
    assert np.degrees(np.linalg.norm(left[:3])) < 0.3
    assert np.linalg.norm(left[3:]) < 0.02
    assert abs(found.vertical.decoding.clock_ns) < 10e6
    assert re.search(r"clock\s.*ms", done.stdout)
    before, after = re.findall(r"([\d.]+) cm a", done.stdout)[0], re.findall(r"([\d.]+) cm as refined", done.stdout)[0]
    assert float(after) < 2.0 < float(before)
    assert (folder / "both.rrd").stat().st_size > 100_000
    # The program takes what it wrote.
    info = ffmap_here(with_cache(folder / "cache"), "info", "drive.bag", "--rig", "rig.toml", cwd=folder)
    assert info.returncode == 0, info.stderr


def test_a_mount_of_which_nothing_is_known_is_found(folder: Path) -> None:
    """A bag without transforms: the lidars are named, and how they move and what both see tells the rest."""
    rig = rig_of(folder / "drive.bag")
    assert rig.horizontal is not None
    assert rig.vertical is not None
    topics = [rig.horizontal.topic, rig.vertical.topic]
    bare = of_topics(folder / "drive.bag", topics)
    named = ("--horizontal", topics[0], "--vertical", topics[1], "--quiet")
    refused = calibrate(folder, bare.name, *named)
    assert refused.returncode == 2
    done = calibrate(folder, bare.name, *named, "--from-motion", "--out", "bare.toml")
    assert done.returncode == 0, done.stderr
    found = rig_of(bare, folder / "bare.toml")
    assert found.horizontal is not None
    assert found.vertical is not None
    expected = transforms.invert(rig.horizontal.T_base_sensor) @ rig.vertical.T_base_sensor
    left = transforms.to_twist(transforms.invert(expected) @ found.vertical.T_base_sensor)
    assert np.degrees(np.linalg.norm(left[:3])) < 0.3
    assert np.linalg.norm(left[3:]) < 0.02


def test_one_lidar_alone_has_no_mount_to_refine(folder: Path) -> None:
    done = calibrate(folder, "one.bag")
    assert done.returncode == 2
    assert "bag of two" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (folder / "one.rig.toml").exists()


@pytest.mark.parametrize("clock", ['"soon"', "11.0", "true", "nan"])
def test_a_clock_that_is_none_is_refused(folder: Path, clock: str) -> None:
    file = folder / "wrong.toml"
    file.write_text(f'[[lidar]]\ntopic = "/points"\nclock_s = {clock}\n')
    with pytest.raises(InputError, match="clock_s"):
        rig_of(folder / "drive.bag", file)
