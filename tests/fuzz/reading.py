"""Parts of runs that read files of users; each raises an InputError for damaged input."""

from contextlib import suppress
from pathlib import Path

from ffmap.app.setup.inputs import find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_index import read_headers
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import read_scans
from ffmap.loaders.trajectory_file import read_pose_topic, read_tum, write_tum
from ffmap.loaders.truth import TruthClasses, read_truth


def read_every_scan(path: Path, rig: Path | None = None) -> None:
    inputs = find_inputs(path, RunOptions(rig=rig))
    with open_bag(inputs.bag_path) as bag:
        for sensor in (inputs.horizontal, *inputs.verticals):
            if sensor is not None:
                for _ in read_scans(bag, sensor.index, 0, None, sensor.lidar.decoding):
                    pass


def read_truth_and_poses(path: Path) -> None:
    with open_bag(path) as bag:
        for topic in bag.topics:
            with suppress(InputError):
                read_pose_topic(bag, topic, "v")
        truth = read_truth(bag)
        for topic in truth.classes.values() if truth is not None else ():
            classes = TruthClasses(bag, topic)
            for stamp in read_headers(bag, topic)[1].tolist():
                classes.at(stamp)


def read_trajectory(path: Path) -> None:
    trajectory = read_tum(path)
    trajectory.at(trajectory.stamp_ns)
    write_tum(path.with_suffix(".again"), trajectory)
    read_tum(path.with_suffix(".again"))
