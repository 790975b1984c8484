"""labelled.bag or labelled/: every vertical cloud with its labels, and the poses."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.folder.labels_file import ScanLabels
from ffmap.app.folder.names import LABELLED_BAG, LABELLED_FOLDER
from ffmap.app.setup.inputs import Inputs
from ffmap.loaders.bag import Message, open_bag
from ffmap.loaders.bag_writer import BagWriter
from ffmap.loaders.errors import CloudError
from ffmap.loaders.frames import StaticTransform
from ffmap.loaders.pointcloud2 import CLOUD_TYPE, describe_layout, encode_labelled, stamp_ns
from ffmap.loaders.scans import read_messages


def write_labelled_bag(
    folder: Path, inputs: Inputs, trajectory: Trajectory, labels: Iterable[ScanLabels]
) -> Path:
    """Write the vertical clouds with their labels, as `labelled.bag` (ROS 1) or `labelled/`.

    trajectory: T_map_base. labels: in the order of the scans; points of other clouds get 255.
    """
    base_frame, indices = inputs.rig.base_frame, [sensor.index for sensor in inputs.verticals]
    labelled, static = iter(labels), inputs.rig.tree.rooted_at(base_frame)
    following, posed_ns = next(labelled, None), None
    name = LABELLED_BAG if inputs.container == "ros1" else LABELLED_FOLDER
    with ExitStack() as stack:
        bags = [stack.enter_context(open_bag(inputs.bag_path)) for _ in indices]

        def read(lidar: int, first: int, count: int) -> Iterator[tuple[int, Message | CloudError]]:
            return read_messages(bags[lidar], indices[lidar], first, count)

        writer = stack.enter_context(BagWriter(folder / name, inputs.container))
        writer.add_topic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        writer.add_topic("/tf", "tf2_msgs/msg/TFMessage")
        for index in indices:
            writer.add_topic(index.topic, CLOUD_TYPE)
        for scan, lidar, message in inputs.scans.read(0, None, read):
            if isinstance(message, CloudError):
                continue
            size = int(message.height) * int(message.width)
            label = label_scan = np.full(size, NO_RETURN, np.uint8)
            if following is not None and following.scan == scan:
                label, label_scan = following.label, following.label_scan
                following = next(labelled, None)
            index, cloud = indices[lidar], int(inputs.scans.cloud[scan])
            log_time_ns, stamp = int(index.log_time_ns[cloud]), stamp_ns(message)
            if static:
                writer.write("/tf_static", writer.transforms(stamp, static), log_time_ns)
                static = ()
            # Clouds with one stamp have one pose.
            if index.usable[cloud] and len(trajectory) and stamp != posed_ns:
                T_map_base = trajectory.at(index.stamp_ns[cloud : cloud + 1])[0]
                pose = StaticTransform("map", base_frame, T_map_base)
                writer.write("/tf", writer.transforms(stamp, [pose]), log_time_ns)
                posed_ns = stamp
            with suppress(CloudError):  # An inconsistent cloud stays the same
                describe_layout(message, index.topic)
                message = encode_labelled(message, label, label_scan)
            writer.write(index.topic, message, log_time_ns)
    return writer.path
