"""Poses of another frame than the base: the clouds show which, and it is used and told."""

from pathlib import Path

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.run.given_poses import GivenPoses, given_poses
from ffmap.app.setup.inputs import Inputs, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.trajectory_file import write_tum
from ffmap.loaders.truth import POSE_TOPIC

CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Inputs:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    values = {"building": "small", "seed": 2, "sensor": "vlp16", "duration_s": 14.0}
    simulate(path, SimulationSettings.model_validate(values))
    return find_inputs(path, RunOptions())


@pytest.fixture(scope="module")
def true(inputs: Inputs) -> Trajectory:
    found = given_poses(POSE_TOPIC, inputs, Settings())
    assert found is not None
    return found.trajectory


def given(
    inputs: Inputs,
    path: Path,
    T_map_frame: FloatArray,
    stamp_ns: FloatArray,
    frame: str | None = None,
) -> GivenPoses:
    write_tum(path, Trajectory(stamp_ns, T_map_frame))
    found = given_poses(str(path), inputs, Settings(), frame)
    assert found is not None
    return found


def test_poses_of_a_lidar_or_a_camera_are_carried_to_the_base(
    inputs: Inputs, true: Trajectory, tmp_path: Path
) -> None:
    assert inputs.horizontal is not None
    lidar = inputs.horizontal.lidar
    for name, T_base_frame in (
        (lidar.frame_id, lidar.T_base_sensor),
        (f"{inputs.rig.base_frame} with z forward and y down", CAMERA),
    ):
        # As odometries write them: from the sensor's own first pose on.
        T = true.T_map_base @ T_base_frame
        found = given(inputs, tmp_path / "a.tum", transforms.invert(T[0]) @ T, true.stamp_ns)
        assert found.frame == name
        assert f"contains poses of {name}, not of {inputs.rig.base_frame}" in found.warnings[0]
        T_true_found = true.T_map_base[0] @ transforms.invert(found.trajectory.T_map_base[0])
        left = found.trajectory.moved(T_true_found).T_map_base - true.T_map_base
        assert np.abs(left).max() < 1e-4
        assert found.trajectory.T_map_base[0, 2, 2] > 0.999


def test_poses_of_the_base_stay_and_a_frame_can_be_named(
    inputs: Inputs, true: Trajectory, tmp_path: Path
) -> None:
    found = given(inputs, tmp_path / "a.tum", true.T_map_base, true.stamp_ns)
    assert (found.frame, found.warnings) == (inputs.rig.base_frame, ())
    assert inputs.horizontal is not None
    lidar = inputs.horizontal.lidar
    T = true.T_map_base @ lidar.T_base_sensor
    named = given(inputs, tmp_path / "b.tum", T, true.stamp_ns, lidar.frame_id)
    np.testing.assert_allclose(named.trajectory.T_map_base, true.T_map_base, atol=1e-6)
    with pytest.raises(InputError, match=f"no such frame; use one of {inputs.rig.base_frame}, "):
        given(inputs, tmp_path / "b.tum", T, true.stamp_ns, "nowhere")


def test_poses_by_which_surfaces_disagree_are_told_or_refused(
    inputs: Inputs, true: Trajectory, tmp_path: Path
) -> None:
    backwards = given(inputs, tmp_path / "a.tum", true.T_map_base[::-1], true.stamp_ns)
    assert "which blurs the map" in backwards.warnings[0]
    assert backwards.frame == inputs.rig.base_frame
    centimetres = true.T_map_base.copy()
    centimetres[:, :3, 3] *= 100.0
    turning = [
        transforms.from_yaw(0.7 * s, [0, 0, 0]) for s in (true.stamp_ns - true.stamp_ns[0]) / 1e9
    ]
    for T in (centimetres, turning @ true.T_map_base):
        with pytest.raises(InputError, match="saw at different times are"):
            given(inputs, tmp_path / "a.tum", T, true.stamp_ns)
