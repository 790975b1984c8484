"""The sensors whose messages are read, a module for each maker.

To add one, add a module with a subclass of `Sensor`.
"""

from importlib import import_module
from pkgutil import iter_modules

from ffmap.loaders.bag import Bag, Topic
from ffmap.loaders.sensors.sensor import Sensor

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
SENSORS = tuple(kind() for kind in Sensor.__subclasses__())
*_MOST, _LAST = sorted(sensor.messages for sensor in SENSORS if sensor.messages)
CLOUDS_WANTED = f"{', '.join(_MOST)} or {_LAST}"
"""What a user records, in words."""


def sensor_of(topic: Topic) -> Sensor | None:
    """Find the sensor whose messages a topic holds; None where they are of no known lidar."""
    return next((sensor for sensor in SENSORS if sensor.matches(topic)), None)


def unread_topics(bag: Bag) -> dict[str, str]:
    """Find topics of lidars that are not read: why not, and what to do, one line each."""
    reasons = {}
    for topic in bag.topics.values():
        sensor = sensor_of(topic) if topic.count else None
        if sensor and (reason := sensor.unread_reason(bag, topic)):
            reasons[topic.name] = reason
    return reasons
