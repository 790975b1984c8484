"""The ground truth in simulated bags: building, poses and classes. Only the evaluation reads it.

    /truth/pose       nav_msgs/Odometry: T_map_base
    /truth/building   std_msgs/String: GeoJSON of walls, doors and rooms
    /truth/classes    PointCloud2 with stamps, order and frame of a vertical lidar's clouds; its
                      field `truth` is the class of each point, see `algorithms.base.labels.Truth`
    /truth/classes_2  the same of a second vertical lidar, and so on
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_index import read_headers
from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import check_features
from ffmap.loaders.numbered import all_numbered
from ffmap.loaders.pointcloud2 import describe_layout, points_of, stamp_ns
from ffmap.loaders.trajectory_file import read_pose_topic

POSE_TOPIC = "/truth/pose"
CLASSES_TOPIC = "/truth/classes"
BUILDING_TOPIC = "/truth/building"


@dataclass(frozen=True, eq=False)
class Truth:
    """A bag's ground truth; None for parts that the bag lacks.

    trajectory: T_map_base.
    building: GeoJSON FeatureCollection of walls, doors and rooms, metres in the map frame.
    classes: the class of every point of the vertical clouds, lidar by lidar.
    """

    trajectory: Trajectory | None
    building: dict[str, Any] | None
    classes: "tuple[TruthClasses, ...]" = ()

    def classes_topics(self, frames: Sequence[str]) -> list[str | None]:
        """Find the topic of classes of each vertical lidar, by its frame; None without one."""
        topics = {classes.frame_id: classes.topic for classes in self.classes}
        return [topics.get(frame) for frame in frames]


class TruthClasses:
    """The classes of a vertical lidar's points, by the stamps of its clouds, packets or whole."""

    def __init__(self, bag: Bag, topic: str = CLASSES_TOPIC) -> None:
        self.topic = topic
        self._bag = bag
        log_time_ns, stamps, _ = read_headers(bag, topic)
        self._log_time_ns = dict(zip(stamps.tolist(), log_time_ns.tolist(), strict=True))

    def __len__(self) -> int:
        return len(self._log_time_ns)

    @property
    def frame_id(self) -> str:
        """The frame of the lidar."""
        first = self._bag.deserialize(next(self._bag.messages([self.topic])))
        return str(first.header.frame_id).removeprefix("/")

    def at(self, stamp: int, places: int = 0) -> UInt8Array | None:
        """Read the classes (points of the cloud,) uint8; None where there are none for this stamp.

        places: number of points of the whole cloud, whose packets are joined.
        Raises CloudError where the message has no field `truth`.
        """
        log_time_ns = self._log_time_ns.get(stamp)
        if log_time_ns is None:
            return None
        parts: list[UInt8Array] = []
        for own_stamp, classes in self._read(log_time_ns):
            if own_stamp == stamp or parts:
                parts.append(classes)
            if parts and sum(map(len, parts)) >= places:
                break
        return np.concatenate(parts)

    def __iter__(self) -> Iterator[tuple[int, UInt8Array]]:
        """Yield stamp in nanoseconds and classes of each cloud, in the bag's order."""
        return self._read()

    def _read(self, start_ns: int | None = None) -> Iterator[tuple[int, UInt8Array]]:
        for raw in self._bag.messages([self.topic], start_ns):
            message = self._bag.deserialize(raw)
            layout = describe_layout(message, self.topic, needed=("truth",))
            yield stamp_ns(message), points_of(message, layout)["truth"].astype(np.uint8)


def carries_truth(path: BagPath | Path) -> bool:
    """Whether a bag has true poses."""
    with open_bag(path) as bag:
        return POSE_TOPIC in bag.topics and bag.topics[POSE_TOPIC].count > 0


def read_truth(bag: Bag) -> Truth | None:
    """Read the ground truth; None without any. The bag must stay open while classes are read.

    Raises InputError where it is damaged.
    """
    has = {name: topic for name, topic in bag.topics.items() if topic.count}
    classes = tuple(TruthClasses(bag, topic.name) for topic in all_numbered(has, CLASSES_TOPIC))
    if not classes and not has.keys() & {POSE_TOPIC, BUILDING_TOPIC}:
        return None
    return Truth(
        trajectory=read_pose_topic(bag, POSE_TOPIC, base_frame=None) if POSE_TOPIC in has else None,
        building=_building(bag) if BUILDING_TOPIC in has else None,
        classes=classes,
    )


def _building(bag: Bag) -> dict[str, Any]:
    message = bag.deserialize(next(bag.messages([BUILDING_TOPIC])))
    where, advice = f"{bag.path.name}: {BUILDING_TOPIC}", "simulate the bag again"
    try:
        building = json.loads(message.data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where} is no GeoJSON ({error}); {advice}") from error
    if not isinstance(building, dict) or building.get("type") != "FeatureCollection":
        raise InputError(f"{where} is no GeoJSON FeatureCollection; {advice}")
    check_features(building, "building", where, advice)
    return building
