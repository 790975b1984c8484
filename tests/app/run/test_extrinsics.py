"""Extrinsics that are wrong in the bag: detected in the first seconds, refined, used, reported."""

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import ffmap_here, rig_of, with_cache, write_rig

SHORT = ("--outputs", "labels,maps")


def run(folder: Path, out: str, *words: object) -> "subprocess.CompletedProcess[str]":
    done = ffmap_here(
        with_cache(folder / "cache"),
        "run",
        folder / "drive.bag",
        "--out",
        folder / out,
        *SHORT,
        *words,
    )
    assert done.returncode == 0, done.stderr
    return done


def mount_of(run: Path) -> dict[str, object]:
    (found,) = json.loads((run / "run.json").read_text())["mounts"].values()
    return dict(found)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag, and a rig file that puts its vertical lidar 2 degrees and 5 cm off."""
    path = tmp_path_factory.mktemp("mount")
    simulate(path / "drive.bag", SimulationSettings(building="small", seed=3, duration_s=12.0))
    off = transforms.make_transform(
        Rotation.from_euler("xyz", [1.2, -1.0, 1.2], degrees=True), [0.02, 0.04, -0.02]
    )
    write_rig(path / "rig.toml", rig_of(path / "drive.bag"), off)
    return path


def test_a_mount_that_is_off_is_refined_and_told(folder: Path) -> None:
    done = run(folder, "run", "--rig", folder / "rig.toml")
    mount = mount_of(folder / "run")
    assert mount["used"] == "refined"
    assert "--mount as-given" in done.stdout + done.stderr
    vertical = rig_of(folder / "drive.bag").vertical
    assert vertical is not None
    left = transforms.to_twist(
        transforms.invert(vertical.T_base_sensor) @ np.array(mount["T_base_sensor"])
    )
    assert np.degrees(np.linalg.norm(left[:3])) < 0.4
    assert np.linalg.norm(left[3:]) < 0.03
    metrics = json.loads((folder / "run" / "metrics.json").read_text())
    assert metrics["wall.f1"] > 0.96
    # What looks at the run later looks at it with the same mount.
    words = ("inspect", folder / "run", "--scan", 50, "--out", folder / "s.rrd")
    inspected = ffmap_here(with_cache(folder / "cache"), *words)
    assert inspected.returncode == 0, inspected.stderr
    assert "labels equal" in inspected.stdout


@pytest.mark.parametrize("off", ["20 degrees", "the inverse"])
def test_a_mount_that_is_far_off_ends_the_run_before_the_odometry(folder: Path, off: str) -> None:
    """Degrees for radians, say; of the inverse few returns meet the other lidar's at all."""
    rig = rig_of(folder / "drive.bag")
    assert rig.vertical is not None
    T = transforms.make_transform(Rotation.from_euler("z", 20, degrees=True))
    if off == "the inverse":
        inverse = transforms.invert(rig.vertical.T_base_sensor)
        T = transforms.invert(rig.vertical.T_base_sensor) @ inverse
    write_rig(folder / "far.toml", rig, T)
    words = ("--out", folder / "far", "--overwrite", "--rig", folder / "far.toml", *SHORT)
    done = ffmap_here(with_cache(folder / "cache"), "run", folder / "drive.bag", *words)
    assert done.returncode == 2
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("ffmap: ")]
    assert "the transform base_link -> vertical_velodyne is wrong" in line
    assert "--from-motion" in line
    assert "odometry" not in json.loads((folder / "far" / "run.json").read_text())["timings_s"]
    if off == "the inverse":
        wrong = ("calibrate", folder / "drive.bag", "--rig", folder / "far.toml")
        refused = ffmap_here(with_cache(folder / "cache"), *wrong, "--out", folder / "wrong.toml")
        assert refused.returncode == 2
        assert "--from-motion" in refused.stderr
        assert not (folder / "wrong.toml").exists()


def test_a_clock_that_is_off_is_named(tmp_path: Path) -> None:
    """Driving straight hides it in the first seconds; the whole drive shows it."""
    values = SimulationSettings(building="small", seed=2, sensor="vlp16", duration_s=16.0)
    simulate(tmp_path / "drive.bag", values)
    write_rig(tmp_path / "late.toml", rig_of(tmp_path / "drive.bag"), np.eye(4), clock_s=0.06)
    words = ("--rig", tmp_path / "late.toml", "--trajectory", "/truth/pose", "--no-evaluate")
    done = run(tmp_path, "late", *words)
    assert re.search(r"clock by -(5|6)\d ms", done.stdout + done.stderr), done.stderr
    assert "ffmap calibrate" in done.stderr
