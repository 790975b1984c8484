"""A drive over and over in one bag: the same clouds with later stamps, and poses that go with them."""

from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.setup.inputs import InputOptions, Inputs, find_inputs
from ffmap.loaders.bag import make_typestore, open_bag
from ffmap.loaders.firing_times import TimeField
from ffmap.loaders.pointcloud2 import make_cloud
from ffmap.loaders.repeated_bag import Repetition, later, plan_repetition, write_repeated_bag
from ffmap.loaders.scans import read_scans
from ffmap.loaders.simulator import SimulationSettings, simulate

STAMP_NS = 1_700_900_000_000
LATER_NS = 1_500_000_000


@pytest.fixture(scope="module", params=["bag", "mcap"])
def repeated(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Inputs, Inputs, Repetition]:
    """A drive, the same three times over, and how it was repeated."""
    folder = tmp_path_factory.mktemp("repeated")
    once, thrice = folder / "once.bag", folder / "thrice.bag"
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "format": request.param, "duration_s": 1.5}
    simulate(once, SimulationSettings.model_validate(values))
    drive = find_inputs(once, InputOptions())
    with open_bag(once) as bag:
        repetition = plan_repetition([s.index for s in drive.by_role.values()], straight(drive), 3, 0.3)
        write_repeated_bag(thrice, bag, drive.rig, repetition)
    return drive, find_inputs(thrice, InputOptions()), repetition


def straight(inputs: Inputs) -> Trajectory:
    """Forward by 20 m."""
    assert inputs.horizontal is not None
    stamps = inputs.horizontal.index.stamp_ns
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, 0, 3] = np.linspace(0, 20, len(stamps))
    return Trajectory(stamps, poses)


def test_the_clouds_come_again_with_later_stamps(repeated: tuple[Inputs, Inputs, Repetition]) -> None:
    drive, again, repetition = repeated
    for role, sensor in again.by_role.items():
        own = drive.by_role[role]
        assert sensor.lidar.topic == own.lidar.topic
        assert len(sensor.index) == 3 * len(own.index)
        assert sensor.index.usable.all()
        for read in (sensor.index.stamp_ns, sensor.index.log_time_ns):
            assert (np.diff(read) > 0).all()
        assert sensor.index.stamp_ns[2 * len(own.index)] == own.index.stamp_ns[0] + 2 * repetition.step_ns
        np.testing.assert_allclose(sensor.lidar.T_base_sensor, own.lidar.T_base_sensor, atol=1e-9)


def test_the_returns_are_the_same(repeated: tuple[Inputs, Inputs, Repetition]) -> None:
    drive, again, repetition = repeated
    assert drive.vertical is not None
    assert again.vertical is not None
    first, second = (
        scan_of(inputs, sensor, number)
        for inputs, sensor, number in (
            (drive, drive.vertical, 2),
            (again, again.vertical, 2 + len(drive.vertical.index)),
        )
    )
    np.testing.assert_array_equal(first.points_sensor, second.points_sensor)
    np.testing.assert_array_equal(first.time_ns, second.time_ns)
    assert second.start_ns - first.start_ns == repetition.step_ns


def scan_of(inputs: Inputs, sensor: Any, number: int) -> Scan:
    with open_bag(inputs.bag_path) as bag:
        ((_, scan),) = read_scans(bag, sensor.index, number, 1, sensor.lidar.decoding)
    assert isinstance(scan, Scan)
    return scan


def test_transforms_are_told_once(repeated: tuple[Inputs, Inputs, Repetition]) -> None:
    with open_bag(repeated[1].bag_path) as bag:
        assert bag.topics["/tf_static"].count == 1
        assert set(bag.topics) == {"/tf_static", *(s.lidar.topic for s in repeated[1].by_role.values())}


def test_poses_hold_for_all_scans_and_time_is_left_to_carry_the_robot(
    repeated: tuple[Inputs, Inputs, Repetition],
) -> None:
    drive, again, repetition = repeated
    once = straight(drive)
    poses = repetition.poses(once)
    for sensor in again.by_role.values():
        assert poses.covers(sensor.index.stamp_ns).all()
    for shift in repetition.shifts_ns:
        np.testing.assert_allclose(poses.at(once.stamp_ns + shift), once.T_map_base, atol=1e-9)
    speed = np.diff(poses.T_map_base[:, 0, 3]) / (np.diff(poses.stamp_ns) / 1e9)
    assert speed.min() > -100


@pytest.mark.parametrize(("unit", "kind"), [("s", "<f8"), ("ms", "<u4")])
@pytest.mark.parametrize("reference", ["epoch", "stamp"])
def test_only_absolute_times_of_returns_are_shifted(unit: str, kind: str, reference: Any) -> None:
    field = TimeField("timestamp", unit, reference, 100_000_000)
    points = np.zeros((2, 3), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("timestamp", kind)])
    begin_ns = STAMP_NS if reference == "epoch" else 0
    points["timestamp"] = begin_ns // field.unit_ns + np.arange(6).reshape(2, 3)
    before = points["timestamp"].copy()
    moved = later(make_cloud(make_typestore(2), header(), points), "/points", field, LATER_NS)
    assert (moved.header.stamp.sec, moved.header.stamp.nanosec) == (1_702, 400_000_000)
    by = np.array(LATER_NS / field.unit_ns if reference == "epoch" else 0, kind)
    times = np.frombuffer(moved.data.tobytes(), points.dtype)["timestamp"].reshape(2, 3)
    np.testing.assert_array_equal(times, before + by)
    np.testing.assert_array_equal(points["timestamp"], before)


def test_packets_are_shifted_with_their_revolution() -> None:
    types = make_typestore(1).types
    stamp = types["builtin_interfaces/msg/Time"](1_700, 950_000_000)
    packet = types["velodyne_msgs/msg/VelodynePacket"](stamp, np.zeros(1206, np.uint8))
    moved = later(types["velodyne_msgs/msg/VelodyneScan"](header(1), [packet]), "/packets", None, LATER_NS)
    assert (moved.header.stamp.sec, moved.header.stamp.nanosec) == (1_702, 400_000_000)
    assert (moved.packets[0].stamp.sec, moved.packets[0].stamp.nanosec) == (1_702, 450_000_000)


def header(ros: Any = 2) -> Any:
    types = make_typestore(ros).types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(STAMP_NS, 1_000_000_000))
    return types["std_msgs/msg/Header"](*([0] if ros == 1 else []), stamp, "lidar")
