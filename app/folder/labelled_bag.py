"""labelled.bag or labelled/: every vertical cloud again, with its labels, and the poses."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.folder.names import LABELLED_BAG, LABELLED_FOLDER
from ffmap.loaders.bag import Bag, Message
from ffmap.loaders.bag_writer import BagWriter
from ffmap.loaders.cloud_index import CloudIndex
from ffmap.loaders.errors import CloudError
from ffmap.loaders.frames import StaticTransform
from ffmap.loaders.pointcloud2 import describe_layout, encode_labelled, stamp_ns
from ffmap.loaders.rig import Rig
from ffmap.loaders.scan_order import ScanOrder
from ffmap.loaders.scans import read_messages

_TRANSFORMS = (("/tf_static", "tf2_msgs/msg/TFMessage"), ("/tf", "tf2_msgs/msg/TFMessage"))


def write_labelled_bag(
    run_dir: Path,
    bags: Sequence[Bag],
    indices: Sequence[CloudIndex],
    rig: Rig,
    trajectory: Trajectory,
    labels: Iterable[tuple[int, UInt8Array, UInt8Array]],
) -> Path:
    """Every vertical cloud of the bag again, with its labels, as `labelled.bag` (ROS 1) or `labelled/` (ROS 2).

    indices: each vertical lidar's clouds; bags: where they are read, one for each. trajectory: T_map_base. labels: in the order
    of all of them, see `ScanOrder`, for each labelled scan its number, `label` and `label_scan`, both (height x width,); the
    points of clouds that are not among them get 255.
    """
    labelled, static = iter(labels), rig.tree.rooted_at(rig.base_frame)
    following, posed_ns = next(labelled, None), None
    container = bags[0].container
    name = LABELLED_BAG if container == "ros1" else LABELLED_FOLDER
    scans = ScanOrder.of(indices)

    def read(lidar: int, first: int, count: int) -> Iterator[tuple[int, Message | CloudError]]:
        return read_messages(bags[lidar], indices[lidar], first, count)

    with BagWriter(run_dir / name, container) as writer:
        for topic, msgtype in (*_TRANSFORMS, *((index.topic, "sensor_msgs/msg/PointCloud2") for index in indices)):
            writer.add_topic(topic, msgtype, latched=topic == "/tf_static")
        for scan, lidar, message in scans.read(0, None, read):
            if following is not None and following[0] < scan:
                raise ValueError(f"the labels of scan {following[0]} come out of order")
            if isinstance(message, CloudError):
                continue
            label = label_scan = np.full(int(message.height) * int(message.width), NO_RETURN, np.uint8)
            if following is not None and following[0] == scan:
                _, label, label_scan = following
                following = next(labelled, None)
            index, cloud = indices[lidar], int(scans.cloud[scan])
            log_time_ns, stamp = int(index.log_time_ns[cloud]), stamp_ns(message)
            if static:
                writer.write("/tf_static", writer.transforms(stamp, static), log_time_ns)
                static = ()
            # Clouds that were taken at once have one pose.
            if index.usable[cloud] and len(trajectory) and stamp != posed_ns:
                pose = StaticTransform("map", rig.base_frame, trajectory.at(index.stamp_ns[cloud : cloud + 1])[0])
                writer.write("/tf", writer.transforms(stamp, [pose]), log_time_ns)
                posed_ns = stamp
            writer.write(index.topic, _labelled(message, index.topic, label, label_scan), log_time_ns)
    return writer.path


def _labelled(message: Message, topic: str, label: UInt8Array, label_scan: UInt8Array) -> Message:
    """The cloud with its labels; one that contradicts itself stays as it is."""
    try:
        describe_layout(message, topic)
    except CloudError:
        return message
    return encode_labelled(message, label, label_scan)
