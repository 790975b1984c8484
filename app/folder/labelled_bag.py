"""labelled.bag or labelled/: every vertical cloud again, with its labels, and the poses."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.folder.names import LABELLED_BAG, LABELLED_FOLDER
from ffmap.loaders.bag import Bag, Message
from ffmap.loaders.bag_writer import BagWriter
from ffmap.loaders.cloud_digest import joined
from ffmap.loaders.errors import CloudError, InputError
from ffmap.loaders.frames import StaticTransform
from ffmap.loaders.pointcloud2 import describe_layout, encode_labelled, stamp_ns
from ffmap.loaders.rig import Rig
from ffmap.loaders.scans import CloudIndex, read_messages

_TRANSFORMS = (("/tf_static", "tf2_msgs/msg/TFMessage"), ("/tf", "tf2_msgs/msg/TFMessage"))


def write_labelled_bag(
    run_dir: Path,
    bag: Bag,
    index: CloudIndex,
    rig: Rig,
    trajectory: Trajectory,
    labels: Iterable[tuple[int, UInt8Array, UInt8Array]],
    clouds: str | None = None,
) -> Path:
    """Every vertical cloud of the bag again, with its labels, as `labelled.bag` (ROS 1) or `labelled/` (ROS 2).

    index: the vertical clouds. trajectory: T_map_base. labels: in the bag's order, for each labelled scan its number,
    `label` and `label_scan`, both (height x width,); the points of clouds that are not among them get 255.
    clouds: digest of the bytes of all clouds that were labelled, where known. Raises InputError where the bag holds others now.
    """
    labelled, static = iter(labels), rig.static_transforms
    digests: list[bytes] = []
    following = next(labelled, None)
    name = LABELLED_BAG if bag.container == "ros1" else LABELLED_FOLDER
    with BagWriter(run_dir / name, bag.container) as writer:
        for topic, msgtype in (*_TRANSFORMS, (index.topic, "sensor_msgs/msg/PointCloud2")):
            writer.add_topic(topic, msgtype, latched=topic == "/tf_static")
        for i, message in read_messages(bag, index, digests=digests):
            if following is not None and following[0] < i:
                raise ValueError(f"the labels of scan {following[0]} come out of order")
            if isinstance(message, CloudError):
                continue
            label = label_scan = np.full(int(message.height) * int(message.width), NO_RETURN, np.uint8)
            if following is not None and following[0] == i:
                _, label, label_scan = following
                following = next(labelled, None)
            log_time_ns, stamp = int(index.log_time_ns[i]), stamp_ns(message)
            if static:
                writer.write("/tf_static", writer.transforms(stamp, static), log_time_ns)
                static = ()
            if index.usable[i] and len(trajectory):
                pose = StaticTransform("map", rig.base_frame, trajectory.at(index.stamp_ns[i : i + 1])[0])
                writer.write("/tf", writer.transforms(stamp, [pose]), log_time_ns)
            writer.write(index.topic, _labelled(message, index.topic, label, label_scan), log_time_ns)
        if clouds is not None and joined(digests).hex() != clouds:
            raise InputError(
                f"{bag.path}: changed while the run was reading it; let nothing write to it, and start a new run"
            )
    return writer.path


def _labelled(message: Message, topic: str, label: UInt8Array, label_scan: UInt8Array) -> Message:
    """The cloud with its labels; one that contradicts itself stays as it is."""
    try:
        describe_layout(message, topic)
    except CloudError:
        return message
    return encode_labelled(message, label, label_scan)
