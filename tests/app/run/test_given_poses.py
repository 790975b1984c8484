"""Poses from outside, in whatever frame and of whatever frame: used, moved, reported or refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Reader, Writer

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
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
from ffmap.loaders.trajectory_file import read_tum, write_tum
from ffmap.loaders.truth import POSE_TOPIC
from tests.loaders.bag_builder import CLOUD

UTM_M = np.array([432_123.4, 5_412_345.6, 450.0])
CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    simulate(path, SimulationSettings(building="small", seed=2, sensor="vlp16", duration_s=14.0))
    return path


@pytest.fixture(scope="module")
def inputs(bag: Path) -> Inputs:
    return find_inputs(bag, RunOptions())


@pytest.fixture(scope="module")
def true(inputs: Inputs) -> Trajectory:
    found = given_poses(POSE_TOPIC, inputs, Settings())
    assert found is not None
    return found.trajectory


def given(
    inputs: Inputs, path: Path, T: FloatArray, stamp_ns: Any, frame: str | None = None
) -> GivenPoses:
    write_tum(path, Trajectory(stamp_ns, T))
    found = given_poses(str(path), inputs, Settings(), frame)
    assert found is not None
    return found


def moved(true: Trajectory, shift_m: Any) -> FloatArray:
    return transforms.make_transform(translation=np.array(shift_m, float)) @ true.T_map_base


def test_poses_near_their_origin_and_above_a_floor_at_height_0_stay(
    inputs: Inputs, true: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "near.tum"
    found = given(inputs, path, moved(true, [300.0, -20.0, 0.0]), true.stamp_ns)
    assert not found.origin_m.any()
    assert (found.frame, found.warnings) == (inputs.rig.base_frame, ())
    np.testing.assert_array_equal(found.trajectory.T_map_base, read_tum(path).T_map_base)
    monkeypatch.setattr(module, "_GAP_S", 0.3)
    elapsed_s = (true.stamp_ns - true.stamp_ns[0]) / 1e9
    kept = (elapsed_s < 3.0) | (elapsed_s > 3.5)
    found = given(inputs, path, true.T_map_base[kept], true.stamp_ns[kept])
    assert "has no pose for 0." in found.warnings[0]


def test_poses_far_out_are_moved_to_the_floor_near_the_first(
    inputs: Inputs, true: Trajectory, tmp_path: Path
) -> None:
    path = tmp_path / "utm.tum"
    found = given(inputs, path, moved(true, UTM_M), true.stamp_ns)
    np.testing.assert_array_equal(found.origin_m[:2], np.round(read_tum(path).T_map_base[0, :2, 3]))
    np.testing.assert_allclose(found.origin_m[2], UTM_M[2], atol=0.02)
    there = read_tum(path).T_map_base[:, :3, 3]
    here = found.trajectory.T_map_base[:, :3, 3]
    np.testing.assert_allclose(here + found.origin_m, there, atol=1e-6)
    assert "the origin of the map" in found.warnings[0]
    # Below the first pose the floor is found at any height.
    low = given(inputs, path, moved(true, [0, 0, -0.8]), true.stamp_ns)
    np.testing.assert_allclose(low.origin_m, [0, 0, -0.8], atol=0.02)


def test_poses_of_a_lidar_or_a_camera_are_converted_to_the_base(
    inputs: Inputs, true: Trajectory, tmp_path: Path
) -> None:
    assert inputs.horizontal is not None
    lidar, base = inputs.horizontal.lidar, inputs.rig.base_frame
    for name, T_base_frame in (
        (lidar.frame_id, lidar.T_base_sensor),
        (f"{base} with z forward and y down", CAMERA),
    ):
        # As odometries write them: from the sensor's own first pose on.
        T = true.T_map_base @ T_base_frame
        found = given(inputs, tmp_path / "a.tum", transforms.invert(T[0]) @ T, true.stamp_ns)
        assert found.frame == name
        assert f"contains poses of {name}, not of {base}" in found.warnings[0]
        T_true_found = true.T_map_base[0] @ transforms.invert(found.trajectory.T_map_base[0])
        left = found.trajectory.moved(T_true_found).T_map_base - true.T_map_base
        assert np.abs(left).max() < 1e-4
        assert found.trajectory.T_map_base[0, 2, 2] > 0.999
    T = true.T_map_base @ lidar.T_base_sensor
    named = given(inputs, tmp_path / "b.tum", T, true.stamp_ns, lidar.frame_id)
    np.testing.assert_allclose(named.trajectory.T_map_base, true.T_map_base, atol=1e-6)
    with pytest.raises(InputError, match=f"no such frame; use one of {base}, "):
        given(inputs, tmp_path / "b.tum", T, true.stamp_ns, "nowhere")


def test_poses_that_no_robot_has_are_refused(
    inputs: Inputs, true: Trajectory, tmp_path: Path
) -> None:
    path, stamps, poses = tmp_path / "a.tum", true.stamp_ns, true.T_map_base
    for T in (poses[::-1], _scaled(poses, 100.0)):
        assert "which blurs the map" in given(inputs, path, T, stamps).warnings[0]
    turning = np.array(
        [transforms.from_yaw(0.7 * s, [0, 0, 0]) for s in (stamps - stamps[0]) / 1e9]
    )
    lying = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    for T, stamp_ns, words in (
        (poses, stamps + 10**15, "give poses of this drive"),
        (lying @ poses, stamps, "z axis is 90 deg from"),
        (turning @ poses, stamps, "saw at different times are"),
        (_scaled(poses, 0.0, 1e4), stamps, "jumps by 10000 m within"),
        (_scaled(poses, 0.0, 1e300), stamps, r"e\+30\d m from its origin; give metres"),
    ):
        with pytest.raises(InputError, match=words):
            given(inputs, path, T, stamp_ns)


def test_poses_in_centimetres_are_refused(tmp_path: Path) -> None:
    """In rooms off a corridor; along one corridor alone, poses 100 times too far apart may fit."""
    path = tmp_path / "drive.bag"
    simulate(path, SimulationSettings(building="ell", seed=2, sensor="vlp16", duration_s=14.0))
    inputs = find_inputs(path, RunOptions())
    true = given_poses(POSE_TOPIC, inputs, Settings())
    assert true is not None
    T, stamp_ns = true.trajectory.T_map_base, true.trajectory.stamp_ns
    with pytest.raises(InputError, match="saw at different times are"):
        given(inputs, tmp_path / "a.tum", _scaled(T, 100.0), stamp_ns)


def _scaled(poses: FloatArray, scale: float, step_m: float = 0.0) -> FloatArray:
    """Poses with scaled positions, and a step along x from each to the next."""
    T = poses.copy()
    T[:, :3, 3] *= scale
    T[:, 0, 3] += step_m * np.arange(1, len(T) + 1)
    return T


def test_clocks_apart_are_named_before_an_earlier_run_is_touched(
    bag: Path,
    inputs: Inputs,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    check_lidars_meet(inputs)
    assert inputs.vertical is not None
    apart, earlier, store = tmp_path / "apart.bag", tmp_path / "run", make_typestore(1)
    with Reader(bag) as reader, Writer(apart) as writer:
        topics = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=store)
            for c in reader.connections
        }
        for connection, time_ns, data in reader.messages():
            if connection.topic == inputs.vertical.lidar.topic:
                message = store.deserialize_ros1(data, CLOUD)
                message.header.stamp.sec += 1000
                data = store.serialize_ros1(message, CLOUD)
            writer.write(topics[connection.id], time_ns, data)
    assert any("1000.0 s ahead" in text for text in find_inputs(apart, RunOptions()).warnings)
    earlier.mkdir()
    record = {"program": "furniture-free-mapping", "outcome": "complete"}
    (earlier / "run.json").write_text(json.dumps(record))
    monkeypatch.setattr(
        "sys.argv", ["ffmap", "run", str(apart), "--out", str(earlier), "--overwrite"]
    )
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "no vertical cloud has a pose: the clocks of" in line
    assert "1000.0 s ahead" in line
    assert json.loads((earlier / "run.json").read_text()) == record
