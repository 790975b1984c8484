"""The reading parts of the commands; each raises an InputError for damaged input."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ffmap.app.analysis.evaluation import evaluate_run
from ffmap.app.commands import compare as compare_command
from ffmap.app.commands import info as info_command
from ffmap.app.commands import rooms as rooms_command
from ffmap.app.commands import runs as runs_command
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.map_files import read_map
from ffmap.app.setup.inputs import Inputs, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import as_toml, load_settings
from ffmap.loaders.bag import make_typestore, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig_file import read_rig_file
from ffmap.loaders.scans import read_scans
from ffmap.loaders.trajectory_file import read_pose_topic, read_tum, write_tum
from ffmap.loaders.truth import BUILDING_TOPIC, read_truth
from tests.loaders.bag_builder import (
    PERIOD_NS,
    START_NS,
    cloud,
    clouds,
    header,
    sweep,
    tf_message,
    write_bag,
)


def look_over_bag(path: Path, options: RunOptions | None = None) -> None:
    """Describe a bag, read its scans, ground truth and poses."""
    options = options or RunOptions()
    found: list[Inputs] = []
    steps: list[Callable[[], object]] = [
        lambda: info_command.describe(path, options.rig, time_from=options.time_from),
        lambda: found.append(find_inputs(path, options)),
        lambda: _read_all(found[0]) if found else None,
        lambda: _read_rest(path),
    ]
    failures = []
    for step in steps:
        try:
            step()
        except InputError as error:
            failures.append(error)
    if failures:
        raise max(failures, key=lambda error: len(str(error)))


def _read_all(inputs: Inputs) -> None:
    with open_bag(inputs.bag_path) as bag:
        for sensor in (inputs.horizontal, *inputs.verticals):
            if sensor is not None:
                for _ in read_scans(bag, sensor.index, 0, None, sensor.lidar.decoding):
                    pass


def _read_rest(path: Path) -> None:
    with open_bag(path) as bag:
        truth = read_truth(bag)
        for classes in truth.classes if truth is not None else ():
            for _ in classes:
                pass
        for topic in bag.topics:
            with suppress(InputError):
                read_pose_topic(bag, topic, "v")


def look_over_clouds(folder: Path, change: dict[str, Any], every: bool) -> None:
    """A bag in which all clouds, or one, have other attributes."""
    good = sweep(24)
    entries: list[Any] = [("/tf_static", START_NS, extrinsics())]
    for i in range(6):
        message = cloud(good, START_NS + i * PERIOD_NS, "v")
        if every or i == 3:
            make = make_typestore(1).types["sensor_msgs/msg/PointField"]
            for name, value in change.items():
                if name == "fields":
                    value = [make(*field) for field in value]
                if name == "data":
                    value = np.frombuffer(value, np.uint8)
                setattr(message.header if name == "frame_id" else message, name, value)
        entries.append(("/v", START_NS + (i + 1) * PERIOD_NS, message))
    path = folder / "case.bag"
    path.unlink(missing_ok=True)
    look_over_bag(write_bag(path, entries))


def look_over_packets(folder: Path, packets: list[bytes], stamps_ns: list[int]) -> None:
    """A bag of three equal scans of raw packets of 1206 bytes."""
    types = make_typestore(1).types
    make, scan = types["velodyne_msgs/msg/VelodynePacket"], types["velodyne_msgs/msg/VelodyneScan"]
    entries: list[Any] = []
    for i in range(3):
        stamp = START_NS + i * PERIOD_NS
        made = [
            make(
                stamp=header(types, stamp + later, "v").stamp,
                data=np.frombuffer(data.ljust(1206, b"\0")[:1206], np.uint8),
            )
            for data, later in zip(packets, stamps_ns, strict=True)
        ]
        message = scan(header=header(types, stamp, "v"), packets=made)
        entries.append(("/packets", stamp + 1, message))
    path = folder / "case.bag"
    path.unlink(missing_ok=True)
    look_over_bag(write_bag(path, entries))


def look_over_rig(path: Path, bag: Path) -> None:
    read_rig_file(path)
    look_over_bag(bag, RunOptions(rig=path))


def look_over_trajectory(path: Path) -> None:
    trajectory = read_tum(path)
    trajectory.at(trajectory.stamp_ns)
    write_tum(path.with_suffix(".again"), trajectory)
    read_tum(path.with_suffix(".again"))


def look_over_map(path: Path, out: Path) -> None:
    read_map(path)
    rooms_command.rooms(path, out=out)


def look_over_settings(config: Path | None, words: tuple[str, ...]) -> None:
    settings = load_settings(config, words)
    as_toml(settings)
    settings.short_hash()


def evaluate(run: Path) -> None:
    evaluate_run(open_run(run), workers=1)


def evaluate_by(run: Path, bag: Path, building: bytes) -> None:
    """Evaluate by the ground truth of a bag with another building."""
    store, path = make_typestore(1), run.parent / "truth.bag"
    text = store.types["std_msgs/msg/String"](building.decode(errors="replace"))
    with open_bag(bag) as source:
        kept = {topic for topic in source.topics if topic.startswith("/truth/")} - {BUILDING_TOPIC}
        messages = source.messages(kept)
        entries = [(raw.topic, raw.log_time_ns, source.deserialize(raw)) for raw in messages]
    truth = write_bag(path, [(BUILDING_TOPIC, START_NS, text), *entries])
    evaluate_run(open_run(run), BagPath((truth,)), workers=1)


def compare(run: Path, other: Path, out: Path) -> None:
    compare_command.compare([run, other], out, scans=False, spawn=False, quiet=True)


def list_runs(root: Path) -> None:
    runs_command.runs(root, [], None, False, None)


_TILT = (0.0, 0.7071067811865476, 0.0, 0.7071067811865476)


def extrinsics(ros_version: int = 1) -> Any:
    edges = [("base", "h", (0, 0, 1), (0, 0, 0, 1)), ("base", "v", (0, 0, 0.8), _TILT)]
    return tf_message(edges, ros_version)


def small_drive(ros_version: int) -> list[Any]:
    """Two lidars, four sweeps each, and their extrinsics."""
    small = {"columns": 16, "elevations_deg": (-3, -1, 1, 3)}
    entries = [
        ("/tf_static", START_NS, extrinsics(ros_version)),
        *clouds("/h", 4, "h", ros_version, **small),
        *clouds("/v", 4, "v", ros_version, late_ns=10**6, **small),
    ]
    return sorted(entries, key=lambda entry: entry[1])
