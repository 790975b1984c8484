"""Names of things of which there mostly is one: a bag has `/truth/classes`, and with a second labelled lidar `/truth/classes_2`."""

from collections.abc import Mapping
from itertools import count, takewhile
from typing import TypeVar

T = TypeVar("T")


def numbered(name: str, place: int) -> str:
    """The name of the first thing of its kind (place 0), the second, and so on: name, name_2, name_3."""
    return name if not place else f"{name}_{place + 1}"


def all_numbered(values: Mapping[str, T], name: str) -> list[T]:
    """What a mapping holds under these names, as far as they go on."""
    return [values[own] for own in takewhile(values.__contains__, (numbered(name, place) for place in count()))]
