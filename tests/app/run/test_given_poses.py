"""Poses from outside, in whatever frame: the map's origin is near them and on the floor."""

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader, Writer

from ffmap.app.cli import main
from ffmap.app.run import given_poses as module
from ffmap.app.run.given_poses import GivenPoses, given_poses
from ffmap.app.run.start import check_lidars_meet
from ffmap.app.setup.inputs import Inputs, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import make_typestore
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.trajectory_file import read_tum
from ffmap.loaders.truth import POSE_TOPIC
from tests.loaders.bag_builder import CLOUD

UTM_M = np.array([432_123.4, 5_412_345.6, 450.0])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "duration_s": 1.0}
    simulate(path, SimulationSettings.model_validate(values))
    return path


@pytest.fixture(scope="module")
def inputs(bag: Path) -> Inputs:
    return find_inputs(bag, RunOptions())


def written(path: Path, inputs: Inputs, shift_m: np.ndarray, turned_deg: float = 0.0, ahead_s: float = 0.0) -> str:
    """True poses of the drive as a TUM file, in a frame of its own; returns its name."""
    true = given_poses(POSE_TOPIC, inputs, Settings())
    assert true is not None
    half = np.radians(turned_deg) / 2
    lines = []
    for stamp_ns, T in zip(true.trajectory.stamp_ns.tolist(), true.trajectory.T_map_base, strict=True):
        x, y, z = T[:3, 3] + shift_m
        stamp = f"{stamp_ns // 10**9 + int(ahead_s)}.{stamp_ns % 10**9:09d}"
        lines.append(f"{stamp} {x:.9f} {y:.9f} {z:.9f} {np.sin(half):.9f} 0 0 {np.cos(half):.9f}\n")
    path.write_text("".join(lines))
    return str(path)


def placed(path: Path, inputs: Inputs, shift_m: list[float]) -> GivenPoses:
    found = given_poses(written(path, inputs, np.array(shift_m)), inputs, Settings())
    assert found is not None
    return found


def test_poses_near_their_origin_and_above_a_floor_at_height_0_stay(inputs: Inputs, tmp_path: Path) -> None:
    found = placed(tmp_path / "near.tum", inputs, [300.0, -20.0, 0.0])
    assert not found.origin_m.any()
    assert found.warnings == ()
    np.testing.assert_array_equal(found.trajectory.T_map_base, read_tum(tmp_path / "near.tum").T_map_base)


def test_poses_far_out_are_moved_to_the_floor_near_the_first_and_that_is_told(inputs: Inputs, tmp_path: Path) -> None:
    found = placed(tmp_path / "utm.tum", inputs, UTM_M.tolist())
    np.testing.assert_array_equal(found.origin_m[:2], np.round(UTM_M[:2]))
    np.testing.assert_allclose(found.origin_m[2], UTM_M[2], atol=0.02)
    given = read_tum(tmp_path / "utm.tum").T_map_base[:, :3, 3]
    np.testing.assert_allclose(found.trajectory.T_map_base[:, :3, 3] + found.origin_m, given, atol=1e-6)
    assert "x 432123, y 5412346, z 450" in found.warnings[0]


def test_time_without_poses_is_told(inputs: Inputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_GAP_S", 0.3)
    path = tmp_path / "near.tum"
    assert placed(path, inputs, [0.0, 0.0, 0.0]).warnings == ()
    lines = path.read_text().splitlines(keepends=True)
    begun = float(lines[0].split()[0])
    path.write_text("".join(line for line in lines if not 0.3 < float(line.split()[0]) - begun < 0.8))
    found = given_poses(str(path), inputs, Settings())
    assert found is not None
    assert "has no pose for 0.5 s" in found.warnings[0]


def test_the_floor_is_found_wherever_the_poses_begin(inputs: Inputs, tmp_path: Path) -> None:
    found = placed(tmp_path / "low.tum", inputs, [0.0, 0.0, -0.8])
    np.testing.assert_allclose(found.origin_m, [0, 0, -0.8], atol=0.02)


def test_poses_of_the_whole_day_count_only_while_the_bag_was_recorded(inputs: Inputs, tmp_path: Path) -> None:
    path = Path(written(tmp_path / "day.tum", inputs, np.zeros(3)))
    first = path.read_text().splitlines()[0]
    start = int(first.split(".")[0])
    before = [f"{start - 3600 + 60 * i}.0 {5000 - 80 * i} 0 0 0 0 0 1\n" for i in range(59)]
    path.write_text("".join(before) + path.read_text())
    found = given_poses(str(path), inputs, Settings())
    assert found is not None
    assert np.abs(found.trajectory.T_map_base[1:, :2, 3]).max() < 10


def test_poses_that_no_robot_has_are_refused(inputs: Inputs, tmp_path: Path) -> None:
    path = tmp_path / "a.tum"

    def refused(match: str, **changes: float) -> None:
        with pytest.raises(InputError, match=match):
            given_poses(written(path, inputs, np.zeros(3), **changes), inputs, Settings())

    refused("give poses of this drive", ahead_s=9e5)
    refused("z axis is 90 deg from", turned_deg=90.0)
    lines = [line.split() for line in Path(written(path, inputs, np.zeros(3))).read_text().splitlines()]
    for step_m, match in ((1e5, "jumps by 100000 m within"), (1e300, r"1e\+30\d m from its origin; give metres")):
        path.write_text("\n".join(" ".join([w[0], str((i + 1) * step_m), *w[2:]]) for i, w in enumerate(lines)))
        with pytest.raises(InputError, match=match):
            given_poses(str(path), inputs, Settings())


def rewritten(bag: Path, path: Path, topic: str, ahead_s: int) -> Path:
    """The same bag with the stamps of one topic's clouds ahead, recorded when they were."""

    store = make_typestore(1)
    with Reader(bag) as reader, Writer(path) as writer:
        connections = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        for connection, time_ns, data in reader.messages():
            if connection.topic == topic:
                message = store.deserialize_ros1(data, CLOUD)
                message.header.stamp.sec += ahead_s
                data = store.serialize_ros1(message, CLOUD)
            writer.write(connections[connection.id], time_ns, data)
    return path


def test_clocks_apart_are_named_before_an_earlier_run_is_touched(
    bag: Path, inputs: Inputs, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    check_lidars_meet(inputs)
    assert inputs.vertical is not None
    apart = rewritten(bag, tmp_path / "apart.bag", inputs.vertical.lidar.topic, 1000)
    assert any("1000.0 s ahead" in text for text in find_inputs(apart, RunOptions()).warnings)
    earlier = tmp_path / "run"
    earlier.mkdir()
    (earlier / "run.json").write_text(json.dumps({"program": "furniture-free-mapping", "outcome": "complete"}))
    monkeypatch.setattr("sys.argv", ["ffmap", "run", str(apart), "--out", str(earlier), "--overwrite"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "no vertical cloud has a pose: the clocks of" in line
    assert "1000.0 s ahead" in line
    assert json.loads((earlier / "run.json").read_text())["outcome"] == "complete"
