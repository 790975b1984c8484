"""labelled.bag or labelled/: every vertical cloud with its labels, and the poses."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
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
from ffmap.loaders.pointcloud2 import CLOUD_TYPE, describe_layout, encode_labelled, stamp_ns
from ffmap.loaders.rig import Rig
from ffmap.loaders.scan_order import ScanOrder
from ffmap.loaders.scans import read_messages


def write_labelled_bag(
    run_dir: Path,
    bags: Sequence[Bag],
    indices: Sequence[CloudIndex],
    rig: Rig,
    trajectory: Trajectory,
    labels: Iterable[tuple[int, UInt8Array, UInt8Array]],
) -> Path:
    """Write the vertical clouds with their labels, as `labelled.bag` (ROS 1) or `labelled/`.

    Args:
        bags: the bag of each vertical lidar's clouds.
        indices: each vertical lidar's clouds.
        trajectory: T_map_base.
        labels: number of each labelled scan, see `ScanOrder`, with `label` and `label_scan`
            (height x width,). The points of other clouds get 255.
    """
    labelled, static = iter(labels), rig.tree.rooted_at(rig.base_frame)
    following, posed_ns = next(labelled, None), None
    container = bags[0].container
    name = LABELLED_BAG if container == "ros1" else LABELLED_FOLDER
    scans = ScanOrder.of(indices)

    def read(lidar: int, first: int, count: int) -> Iterator[tuple[int, Message | CloudError]]:
        return read_messages(bags[lidar], indices[lidar], first, count)

    with BagWriter(run_dir / name, container) as writer:
        writer.add_topic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        writer.add_topic("/tf", "tf2_msgs/msg/TFMessage")
        for index in indices:
            writer.add_topic(index.topic, CLOUD_TYPE)
        for scan, lidar, message in scans.read(0, None, read):
            if following is not None and following[0] < scan:
                raise ValueError(f"the labels of scan {following[0]} come out of order")
            if isinstance(message, CloudError):
                continue
            size = int(message.height) * int(message.width)
            label = label_scan = np.full(size, NO_RETURN, np.uint8)
            if following is not None and following[0] == scan:
                _, label, label_scan = following
                following = next(labelled, None)
            index, cloud = indices[lidar], int(scans.cloud[scan])
            log_time_ns, stamp = int(index.log_time_ns[cloud]), stamp_ns(message)
            if static:
                writer.write("/tf_static", writer.transforms(stamp, static), log_time_ns)
                static = ()
            # Clouds with one stamp have one pose.
            if index.usable[cloud] and len(trajectory) and stamp != posed_ns:
                T_map_base = trajectory.at(index.stamp_ns[cloud : cloud + 1])[0]
                pose = StaticTransform("map", rig.base_frame, T_map_base)
                writer.write("/tf", writer.transforms(stamp, [pose]), log_time_ns)
                posed_ns = stamp
            with suppress(CloudError):  # An inconsistent cloud stays the same
                describe_layout(message, index.topic)
                message = encode_labelled(message, label, label_scan)
            writer.write(index.topic, message, log_time_ns)
    return writer.path
