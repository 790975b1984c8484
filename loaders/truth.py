"""The ground truth in simulated bags: building, poses and classes. Only the evaluation reads it.

    /truth/pose       nav_msgs/Odometry: T_map_base
    /truth/building   std_msgs/String: GeoJSON of walls, doors and rooms
    /truth/classes    PointCloud2 with stamps, order and frame of a vertical lidar's clouds; its
                      field `truth` is the class of each point, see `algorithms.base.labels.Truth`
    /truth/classes_2  the same of a second vertical lidar, and so on
"""

import json
from collections.abc import Mapping
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
    classes: by the frame of a vertical lidar, the topic with the classes of its points.
    """

    trajectory: Trajectory | None
    building: dict[str, Any] | None
    classes: Mapping[str, str]


class TruthClasses:
    """The classes of a vertical lidar's points, by the stamps of its clouds, packets or whole."""

    def __init__(self, bag: Bag, topic: str = CLASSES_TOPIC) -> None:
        self._bag, self._topic = bag, topic
        log_time_ns, stamps, _ = read_headers(bag, topic)
        self._log_time_ns = dict(zip(stamps.tolist(), log_time_ns.tolist(), strict=True))

    def at(self, stamp: int, places: int = 0) -> UInt8Array | None:
        """Read the classes (points of the cloud,) uint8; None where there are none for this stamp.

        places: number of points of the whole cloud, whose packets are joined.
        Raises CloudError where the message has no field `truth`.
        """
        log_time_ns = self._log_time_ns.get(stamp)
        if log_time_ns is None:
            return None
        parts: list[UInt8Array] = []
        for raw in self._bag.messages([self._topic], log_time_ns):
            message = self._bag.deserialize(raw)
            if stamp_ns(message) == stamp or parts:
                layout = describe_layout(message, self._topic, needed=("truth",))
                parts.append(points_of(message, layout)["truth"].astype(np.uint8))
            if parts and sum(map(len, parts)) >= places:
                break
        return np.concatenate(parts)


def carries_truth(path: BagPath | Path) -> bool:
    """Whether a bag has true poses."""
    with open_bag(path) as bag:
        return POSE_TOPIC in bag.topics and bag.topics[POSE_TOPIC].count > 0


def read_truth(bag: Bag) -> Truth | None:
    """Read the ground truth; None without any.

    Raises InputError where it is damaged.
    """
    has = {name: topic for name, topic in bag.topics.items() if topic.count}
    classes = {}
    for topic in all_numbered(has, CLASSES_TOPIC):
        first = bag.deserialize(next(bag.messages([topic.name])))
        classes[str(first.header.frame_id).removeprefix("/")] = topic.name
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
