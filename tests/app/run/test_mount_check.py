"""A mount that is not where the bag says it is: noticed in the first seconds, refined, used from then on and told."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.loaders.bag import open_bag
from ffmap.loaders.rig import find_rig
from ffmap.loaders.simulator import SimulationSettings, simulate

FFMAP = [sys.executable, "-c", "from ffmap.app.cli import main; main()"]
SHORT = ("--outputs", "labels,maps", "--set", "trajectory.level_s=3")


def ffmap(folder: Path, *words: object) -> "subprocess.CompletedProcess[str]":
    environment = {**os.environ, "FFMAP_CACHE": str(folder / "cache")}
    command = [*FFMAP, *map(str, words)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done


def mount_of(run: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((run / "run.json").read_text())["mount"]
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag, and a rig file that puts its vertical lidar 2 degrees and 5 cm off."""
    path = tmp_path_factory.mktemp("mount")
    simulate(path / "drive.bag", SimulationSettings(building="small", seed=3, duration_s=12.0))
    with open_bag(path / "drive.bag") as bag:
        rig = find_rig(bag)
    assert rig.horizontal is not None
    assert rig.vertical is not None
    off = transforms.make_transform(Rotation.from_euler("xyz", [1.2, -1.0, 1.2], degrees=True), [0.02, 0.04, -0.02])
    np.save(path / "true.npy", rig.vertical.T_base_sensor)
    lines = [f'base = "{rig.base_frame}"']
    for lidar, T in ((rig.horizontal, np.eye(4)), (rig.vertical, off)):
        T_base_sensor = T @ lidar.T_base_sensor
        quaternion = transforms.quaternion_xyzw(T_base_sensor).tolist()
        lines += ["[[lidar]]", f'topic = "{lidar.topic}"', f"translation = {T_base_sensor[:3, 3].tolist()}"]
        lines += [f"quaternion_xyzw = {quaternion}"]
    (path / "rig.toml").write_text("\n".join(lines))
    return path


def test_a_mount_that_is_off_is_refined_and_told(folder: Path) -> None:
    done = ffmap(folder, "run", "drive.bag", "--rig", "rig.toml", "--out", "run", *SHORT)
    mount = mount_of(folder / "run")
    assert mount["used"] == "refined"
    assert "--mount as-given" in done.stdout + done.stderr
    off = transforms.invert(np.load(folder / "true.npy")) @ np.array(mount["T_base_sensor"])
    assert np.degrees(np.linalg.norm(transforms.to_twist(off)[:3])) < 0.4
    assert np.linalg.norm(off[:3, 3]) < 0.03
    metrics = json.loads((folder / "run" / "metrics.json").read_text())
    assert metrics["area"]["wall"]["f1"] > 0.96
    # What looks at the run later looks at it with the same mount.
    inspected = ffmap(folder, "inspect", "run", "--scan", 50, "--out", "scan.rrd")
    assert "differ" not in inspected.stdout


def test_a_mount_that_is_right_stays(folder: Path) -> None:
    done = ffmap(folder, "run", "drive.bag", "--out", "right", *SHORT, "--no-evaluate")
    mount = mount_of(folder / "right")
    assert mount["used"] == "as given"
    assert "T_base_sensor" not in mount
    assert "sits" not in done.stderr


def test_as_given_it_is_not_looked_into(folder: Path) -> None:
    words = ("--mount", "as-given", "--out", "given", *SHORT, "--no-evaluate")
    ffmap(folder, "run", "drive.bag", "--rig", "rig.toml", *words)
    assert "mount" not in json.loads((folder / "given" / "run.json").read_text())
