"""A drive over and over in one bag, each time with later stamps: as long a recording as is needed, to measure what grows."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.bag import Bag, Message
from ffmap.loaders.bag_writer import BagWriter
from ffmap.loaders.errors import CloudError, InputError
from ffmap.loaders.firing_times import TimeField
from ffmap.loaders.livox import LIVOX_TYPES
from ffmap.loaders.ouster import OUSTER_TYPES
from ffmap.loaders.pointcloud2 import CLOUD_TYPE, describe_layout
from ffmap.loaders.rig import Rig
from ffmap.loaders.scans import CloudIndex

_CARRIED_M_S = 50.0
"""Speed at which the robot is carried back to the start."""


@dataclass(frozen=True)
class Repetition:
    """How often a drive is repeated, and by how much later each time begins than the time before it.

    held_ns: how long the poses go on before the first and after the last, at each repetition.
    """

    times: int
    step_ns: int
    held_ns: int

    @property
    def shifts_ns(self) -> list[int]:
        """By how much the stamps of each repetition are later than those of the drive."""
        return [self.step_ns * number for number in range(self.times)]

    def poses(self, trajectory: Trajectory) -> Trajectory:
        """The poses of all repetitions from those of the drive."""
        first, last = trajectory.stamp_ns[[0, -1]]
        stamps = np.concatenate([[first - self.held_ns], trajectory.stamp_ns, [last + self.held_ns]])
        poses = trajectory.at(stamps)
        return Trajectory(
            np.concatenate([stamps + shift for shift in self.shifts_ns]), np.concatenate([poses] * self.times)
        )


def plan_repetition(indices: Iterable[CloudIndex], trajectory: Trajectory, times: int, held_s: float) -> Repetition:
    """A repetition of the clouds of some topics, which leaves time for carrying the robot from the end to the start.

    trajectory: the drive's. held_s: how far beyond its poses a scan is placed.
    """
    indices, held_ns = list(indices), int(held_s * 1e9)
    stamps = np.concatenate([trajectory.stamp_ns, *(index.stamp_ns[index.usable] for index in indices)])
    logged = np.concatenate([index.log_time_ns for index in indices])
    length_ns = max(int(np.ptp(stamps)), int(np.ptp(logged)))
    period_ns = max(index.period_ns or 0 for index in indices)
    back_m = float(np.linalg.norm(trajectory.T_map_base[-1, :3, 3] - trajectory.T_map_base[0, :3, 3]))
    return Repetition(times, length_ns + period_ns + 2 * held_ns + int(back_m / _CARRIED_M_S * 1e9), held_ns)


def write_repeated_bag(path: Path, bag: Bag, rig: Rig, repetition: Repetition) -> None:
    """The clouds of the rig's lidars, repeated, and where these sit; in a bag of the same kind.

    path: of a file for ROS 1, of a folder for ROS 2. Raises InputError where the messages' times cannot be made later.
    """
    times = {lidar.topic: lidar.decoding.time for lidar in (rig.horizontal, *rig.verticals) if lidar is not None}
    for topic in times:
        if bag.topic(topic).msgtype in OUSTER_TYPES:
            raise InputError(f"{topic}: the times in Ouster's packets cannot be made later; leave --repeat out")
    with BagWriter(path, bag.container) as writer:
        for topic in times:
            writer.add_topic(topic, bag.topic(topic).msgtype)
        start_ns = bag.start_ns or 0
        writer.write("/tf_static", writer.transforms(start_ns, rig.static_transforms), start_ns, latched=True)
        for shift_ns in repetition.shifts_ns:
            for raw in bag.messages(times):
                message = later(bag.deserialize(raw), raw.topic, times[raw.topic], shift_ns)
                writer.write(raw.topic, message, raw.log_time_ns + shift_ns)


def later(message: Message, topic: str, time: TimeField | None, shift_ns: int) -> Message:
    """A cloud, or a revolution's packets, as if measured later: all absolute times of it are shifted.

    time: the field of the cloud's times; None where it has none.
    """
    moved = _stamped_later(message, shift_ns)
    if message.__msgtype__ in LIVOX_TYPES:
        return replace(moved, timebase=message.timebase + shift_ns)
    if message.__msgtype__ != CLOUD_TYPE:
        packets = [replace(packet, stamp=_later_time(packet.stamp, shift_ns)) for packet in message.packets]
        return replace(moved, packets=packets)
    if time is None or time.reference != "epoch":
        return moved
    try:
        layout = describe_layout(message, topic)
    except CloudError:
        return moved
    if layout.time_field != time.name:
        return moved
    data = np.array(message.data)
    shape, row_bytes = (layout.height, layout.width), layout.width * layout.point_step
    if 0 not in shape:
        strides = (max(int(message.row_step), row_bytes), layout.point_step)
        points = np.ndarray(shape, layout.point, data.data, strides=strides)
        points[time.name] += _in_unit(points[time.name].dtype, shift_ns, time.unit_ns)
    return replace(moved, data=data)


def _in_unit(dtype: npt.DTypeLike, shift_ns: int, unit_ns: int) -> int | float:
    return shift_ns // unit_ns if np.issubdtype(dtype, np.integer) else shift_ns / unit_ns


def _stamped_later(message: Message, shift_ns: int) -> Message:
    stamp = _later_time(message.header.stamp, shift_ns)
    return replace(message, header=replace(message.header, stamp=stamp))


def _later_time(stamp: Message, shift_ns: int) -> Message:
    sec, nanosec = divmod(int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec) + shift_ns, 1_000_000_000)
    return replace(stamp, sec=sec, nanosec=nanosec)
