"""The sensors whose messages are read, a module for each maker."""

from ffmap.loaders.bag import Bag, Topic
from ffmap.loaders.sensors.livox import Livox
from ffmap.loaders.sensors.ouster import Ouster
from ffmap.loaders.sensors.ros import PointCloud2
from ffmap.loaders.sensors.sensor import Sensor
from ffmap.loaders.sensors.unread import CompressedPointCloud2, UnreadPackets
from ffmap.loaders.sensors.velodyne import Velodyne

SENSORS: tuple[Sensor, ...] = (
    PointCloud2(),
    Livox(),
    Ouster(),
    Velodyne(),
    CompressedPointCloud2(),
    UnreadPackets(),
)
*_MOST, _LAST = sorted(sensor.messages for sensor in SENSORS if sensor.messages)
CLOUDS_WANTED = f"{', '.join(_MOST)} or {_LAST}"
"""The messages that can be read, for error messages."""


def sensor_of(topic: Topic) -> Sensor | None:
    """Find the sensor whose messages a topic contains; None for other messages."""
    return next((sensor for sensor in SENSORS if sensor.matches(topic)), None)


def unread_topics(bag: Bag) -> dict[str, str]:
    """Find topics of lidars that are not read, with the reason and the fix, one line each."""
    reasons = {}
    for topic in bag.topics.values():
        sensor = sensor_of(topic) if topic.count else None
        if sensor and (reason := sensor.unread_reason(bag, topic)):
            reasons[topic.name] = reason
    return reasons


def cloud_topics(bag: Bag) -> list[str]:
    """List topics with clouds or packets of a lidar that are read, without the ground truth."""
    unread = unread_topics(bag)
    filled = (t for t in bag.topics.values() if t.count and not t.name.startswith("/truth/"))
    return [t.name for t in filled if sensor_of(t) and t.name not in unread]


def cloud_hint(bag: Bag) -> str:
    """Make the end of an error message that lists the topics with clouds."""
    topics = cloud_topics(bag)
    known = f"the bag's clouds are on: {', '.join(topics)}" if topics else "the bag has no clouds"
    return "; ".join([known, *unread_topics(bag).values()])
