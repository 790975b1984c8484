"""The classes of points (paper, III.C and Fig. 8; "outside" is not in the paper)."""

from enum import IntEnum

NO_RETURN = 255  # the label where the sensor returned nothing (NaN or zero)


class Label(IntEnum):
    CLUTTER = 0
    FLOOR = 1
    CEILING = 2
    WALL = 3
    DOOR = 4
    OUTSIDE = 5  # seen through glass, or mirrored


class Truth(IntEnum):
    """The classes of a bag's ground truth; the first six are those of `Label`."""

    CLUTTER = 0
    FLOOR = 1
    CEILING = 2
    WALL = 3
    DOOR = 4
    OUTSIDE = 5
    GLASS = 6
    OPEN_LEAF = 7
    FULL_HEIGHT_CABINET = 8
    BOARD_ON_WALL = 9
    PERSON = 10


class Verdict(IntEnum):
    """Whether a label is right, and the kind of error if not."""

    RIGHT = 0
    FALSE_WALL = 1
    MISSED_WALL = 2
    FALSE_DOOR = 3
    MISSED_DOOR = 4
    OTHER = 5
