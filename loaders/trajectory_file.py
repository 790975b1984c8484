"""Trajectories from outside: TUM files (as of evo), and topics with poses.

Stamps are nanoseconds since 1970 in 19 digits: they are read and written as integers, as a double
has only 16.
"""

from collections.abc import Iterable
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.bag import Bag, Message
from ffmap.loaders.errors import InputError
from ffmap.loaders.frames import TF_TYPES, FrameTree, edge_of, pose_matrices
from ffmap.loaders.pointcloud2 import stamp_ns
from ffmap.loaders.text_files import read_text

_ORDER = "stamp x y z qx qy qz qw"
_UNITS_NS = {17: 1, 14: 1_000, 11: 1_000_000}
"""Unit of stamps by their least decimal exponent, from 1973 on; 1e11 s are the year 5138."""
_EXPONENT_MAX = 18  # Of a stamp: 64 bits of nanoseconds end in the year 2262
_POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)


def read_tum(path: Path) -> Trajectory:
    """Read a TUM file: a pose a line, "stamp x y z qx qy qz qw"; # begins a comment.

    Stamps are in seconds; the size of the first shows milli-, micro- or nanoseconds.
    Raises InputError with the line.
    """
    stamps: list[int] = []
    poses: list[list[float]] = []
    unit_ns = 0
    for number, line in enumerate(read_text(path, "give a TUM file").splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        where = f"{path}: line {number}"
        if len(words) != 8:
            raise InputError(f"{where}: {len(words)} values instead of 8 ({_ORDER}, by spaces)")
        try:
            exponent = Decimal(words[0]).adjusted()
            units = (ns for least, ns in _UNITS_NS.items() if exponent >= least)
            unit_ns = unit_ns or next(units, 1_000_000_000)
            stamp = _nanoseconds(words[0], unit_ns)
            pose = [float(word) for word in words[1:]]
        except (ValueError, InvalidOperation, OverflowError):
            raise InputError(f"{where}: not all values are numbers ({_ORDER})") from None
        if not np.all(np.isfinite(pose)) or abs(float(np.linalg.norm(pose[3:])) - 1) > 0.05:
            raise InputError(
                f"{where}: the quaternion does not have length 1, or a value is not finite "
                f"({_ORDER})"
            )
        if stamps and stamp <= stamps[-1]:
            raise InputError(f"{where}: the stamp does not increase; sort the file")
        stamps.append(stamp)
        poses.append(pose)
    if not poses:
        raise InputError(f"{path}: no poses in the file; give a TUM file ({_ORDER})")
    T_map_base = [transforms.from_quaternion(pose[:3], pose[3:]) for pose in np.array(poses)]
    return Trajectory(np.array(stamps, np.int64), np.array(T_map_base))


def _nanoseconds(text: str, unit_ns: int) -> int:
    """Convert a stamp; raises OverflowError beyond 64 bits."""
    stamp = Decimal(text)
    if stamp.adjusted() > _EXPONENT_MAX:  # As an integer it may not fit into memory
        raise OverflowError(text)
    nanoseconds = int((stamp * unit_ns).to_integral_value())
    if not -(2**63) <= nanoseconds < 2**63:
        raise OverflowError(text)
    return nanoseconds


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a TUM file, under another name until it is complete."""
    positions = trajectory.T_map_base[:, :3, 3]
    quaternions = transforms.quaternion_xyzw(trajectory.T_map_base)
    part = path.with_name(path.name + ".part")
    with part.open("w") as file:
        for stamp, *pose in zip(trajectory.stamp_ns.tolist(), positions, quaternions, strict=True):
            values = " ".join(f"{value:.9f}" for value in np.concatenate(pose))
            whole, rest = divmod(abs(stamp), 1_000_000_000)
            file.write(f"{'-' if stamp < 0 else ''}{whole}.{rest:09d} {values}\n")
    part.replace(path)


def read_pose_topic(
    bag: Bag, topic: str, base_frame: str | None, static: FrameTree | None = None
) -> Trajectory:
    """Read the poses T_map_base of a topic.

    Poses without a rotation, with NaN, or with a stamp that does not increase are ignored.

    Args:
        topic: Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped, or a
            TFMessage, whose transforms are followed from `base_frame` to the topmost frame.
        base_frame: the frame whose poses are read; None for the topic's own.
        static: joins the frame of the topic's poses with `base_frame`.

    Raises InputError where the topic has no such poses, or no transform joins the frames.
    """
    found, bag_name = bag.topic(topic), bag.path.name
    if found.msgtype in TF_TYPES:
        if base_frame is None:
            raise InputError(f"{bag_name}: {found.name} has poses of many frames; name the frame")
        return _follow_tf(bag, found.name, base_frame, static or FrameTree([]))
    if found.msgtype not in _POSES:
        known = ", ".join(name.split("/")[-1] for name in (*_POSES, *TF_TYPES))
        raise InputError(
            f"{bag_name}: topic {found.name} is {found.msgtype}, which is no pose; name one of "
            f"{known}"
        )
    stamps: list[int] = []
    positions: list[list[float]] = []
    quaternions: list[list[float]] = []
    child = ""
    for raw in bag.messages([found.name]):
        message = bag.deserialize(raw)
        child = child or str(getattr(message, "child_frame_id", "")).removeprefix("/")
        position, quaternion = _pose_of(message, found.msgtype)
        stamps.append(stamp_ns(message))
        positions.append([position.x, position.y, position.z])
        quaternions.append([quaternion.x, quaternion.y, quaternion.z, quaternion.w])
    T, valid = pose_matrices(
        np.array(positions).reshape(-1, 3), np.array(quaternions).reshape(-1, 4)
    )
    poses = zip(np.array(stamps)[valid].tolist(), T, strict=True)
    trajectory = _trajectory(poses, bag, found.name)
    if base_frame is None or child in ("", base_frame):
        return trajectory
    T_child_base = static.between(child, base_frame) if static else None
    if T_child_base is None:
        raise InputError(
            f"{bag_name}: {found.name} gives poses of frame {child}, and no transform joins it "
            f"with {base_frame}; record /tf_static"
        )
    return Trajectory(trajectory.stamp_ns, trajectory.T_map_base @ T_child_base)


def _pose_of(message: Message, msgtype: str) -> tuple[Message, Message]:
    """Return the position and the quaternion of a message."""
    if msgtype.endswith("TransformStamped"):
        return message.transform.translation, message.transform.rotation
    pose = message.pose if msgtype.endswith("/PoseStamped") else message.pose.pose
    return pose.position, pose.orientation


def _follow_tf(bag: Bag, topic: str, base_frame: str, static: FrameTree) -> Trajectory:
    """Multiply the transforms above the base, at the stamps of the busiest one."""
    by_child: dict[str, tuple[str, list[tuple[int, FloatArray]]]] = {}
    for raw in bag.messages([topic]):
        for stamped in bag.deserialize(raw).transforms:
            edge = edge_of(stamped)
            if edge is None:
                continue
            parent, poses = by_child.setdefault(edge.child, (edge.parent, []))
            if parent == edge.parent:
                poses.append((stamp_ns(stamped), edge.T_parent_child))
    for edge in static.edges:
        by_child.setdefault(edge.child, (edge.parent, [(0, edge.T_parent_child)]))
    chain: list[Trajectory] = []
    frame, seen = base_frame, {base_frame}
    while frame in by_child and by_child[frame][0] not in seen:
        frame, poses = by_child[frame]
        seen.add(frame)
        chain.append(_trajectory(poses, bag, topic))
    if not any(len(part) > 1 for part in chain):
        known = ", ".join(sorted(by_child)) or "none"
        raise InputError(
            f"{bag.path.name}: {topic} moves nothing above frame {base_frame}; it has: {known}"
        )
    stamps = max(chain, key=len).stamp_ns
    T = np.broadcast_to(np.eye(4), (len(stamps), 4, 4))
    for part in chain:
        T = part.at(stamps) @ T
    return Trajectory(stamps, T)


def _trajectory(poses: Iterable[tuple[int, FloatArray]], bag: Bag, topic: str) -> Trajectory:
    stamps: list[int] = []
    kept: list[FloatArray] = []
    for stamp, T in poses:
        if not stamps or stamp > stamps[-1]:
            stamps.append(stamp)
            kept.append(T)
    if not kept:
        raise InputError(f"{bag.path.name}: {topic} has no valid pose; name another topic")
    return Trajectory(np.array(stamps, np.int64), np.array(kept))
