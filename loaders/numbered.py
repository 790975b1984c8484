"""Numbered names: a bag has `/truth/classes`, and for a second vertical lidar a `…_2`."""

from collections.abc import Mapping
from itertools import count, takewhile
from typing import TypeVar

T = TypeVar("T")


def numbered(name: str, place: int) -> str:
    """Number a name by its place from 0: name, name_2, name_3."""
    return f"{name}_{place + 1}" if place else name


def all_numbered(values: Mapping[str, T], name: str) -> list[T]:
    """Return the values under name, name_2, and so on, as far as they continue."""
    names = (numbered(name, place) for place in count())
    return [values[own] for own in takewhile(values.__contains__, names)]
