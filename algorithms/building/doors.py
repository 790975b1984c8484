"""Doors of the building: each once, and none that is doubtful."""

from dataclasses import replace

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import lengths_m, segments
from ffmap.algorithms.building.model import AT_FACE_M, CELL_M, NO_DOORS, BuildingSettings, Doors
from ffmap.algorithms.building.verdicts import SAME_WAY
from ffmap.algorithms.scan.doors import DoorState

_DOORWAY_MAX_M = 1.0
"""Maximum depth (m) of a doorway: a corridor with the walls on its sides is wider."""


def each_once(seen: Doors, settings: BuildingSettings) -> Doors:
    """The doors without doubtful ones, each once: of several that show one door the first stands.

    A door that is doubtful as one face shows it may be beyond doubt in the other: hence it is
    dropped first. What is seen in the other face of a door's wall tells how far its doorway reaches
    (`reveal_m`).
    """
    doors, sure = NO_DOORS, drop_doubtful(seen, settings)
    for door in (sure.one(d) for d in range(len(sure))):
        through_m = _through_m(door, doors)
        if np.isfinite(through_m).any():
            doors = replace(doors, reveal_m=np.fmax(doors.reveal_m, through_m))
            continue
        apart_m = np.linalg.norm(door.ends.mean(axis=1) - doors.ends.mean(axis=1), axis=1)
        across = np.abs(doors.normal @ door.normal[0]) < 0.8
        if np.all((apart_m > 0.6) | across):
            doors = doors.append(door)
    return doors


def _through_m(door: Doors, doors: Doors) -> FloatArray:
    """(D,) how far behind each door a single one is seen in the wall's other face, or NaN."""
    (own,) = segments(door)
    middle, through_m = door.ends[0].mean(axis=0), np.full(len(doors), np.nan)
    for d, other in enumerate(segments(doors)):
        behind_m = -float(other.before_m(middle))
        shared_m = other.shared_m(door.ends[0])
        beside = shared_m > 0.5 * min(own.length_m, other.length_m)
        if other.normal @ own.normal < -SAME_WAY and beside:
            through_m[d] = behind_m if 0.0 < behind_m < _DOORWAY_MAX_M else np.nan
    return through_m


def are_passages(doors: Doors, settings: BuildingSettings) -> BoolArray:
    """(D,) which openings are no doors: wider than the widest pair of leaves, or higher."""
    wide = lengths_m(doors.ends) > settings.door_width_max_m + CELL_M
    return np.asarray(wide | (doors.head_m > settings.door_height_max_m + CELL_M))


def drop_doubtful(doors: Doors, settings: BuildingSettings) -> Doors:
    """The doors without what is too narrow or unsure, and without closed ones that are rather wall.

    A leaf's recess of centimetres shows from nearby only: at least `scans_min` scans have to have
    seen it so, unless it is deeper than noise and the poses' errors displace returns.
    """
    width_m = lengths_m(doors.ends)
    lowest_m, highest_m = settings.door_height_min_m - CELL_M, settings.door_height_max_m + CELL_M
    doubtful = (
        ((doors.scan_count < settings.scans_min) & (doors.depth_m < AT_FACE_M))
        | (doors.head_m < lowest_m)
        | (doors.head_m > highest_m)
        | (doors.agreement < settings.opaque_min)
    )
    unsure = width_m < settings.door_width_min_m - CELL_M
    unsure |= doors.confidence < settings.confidence_min
    return doors.select(~unsure & ~(doubtful & (doors.state == DoorState.CLOSED)))


def prove_crossed(doors: Doors, path_map: FloatArray) -> Doors:
    """The doors, of which those that the robot drove through are open beyond doubt.

    path_map: (n, 2) the robot's places in their order.
    """
    crossed = np.zeros(len(doors), bool)
    for d, door in enumerate(segments(doors)):
        side_m, place_m = door.before_m(path_map), door.place_m(path_map)
        change = np.flatnonzero(np.diff(side_m > 0))
        t = side_m[change] / (side_m[change] - side_m[change + 1])
        at_m = place_m[change] + t * (place_m[change + 1] - place_m[change])
        crossed[d] = bool(np.any((at_m > 0) & (at_m < door.length_m)))
    return replace(
        doors,
        crossed=crossed,
        state=np.where(crossed, np.uint8(DoorState.OPEN), doors.state),
        depth_m=np.where(crossed, np.nan, doors.depth_m),
    )
