"""What the modules share that find closed doors, most of whose leaves lie in the face of their wall."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment
from ffmap.algorithms.building.cells import FILLED, THROUGH
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, BuildingSettings, Doors, one_door
from ffmap.algorithms.building.shades import Picture
from ffmap.algorithms.scan.doors import DoorState


class Opening(NamedTuple):
    """The opening of a closed door in the cells of a face.

    strength: by which the one of several over another stands. shows: what tells of it, as `Doors` has it: a casing's relief, a
    leaf's contrast, an outline. first, last: where its jambs stand, in columns. head_m: above the floor.
    """

    strength: float
    shows: float
    first: float
    last: float
    head_m: float


def none_over_another(openings: Iterable[Opening]) -> list[Opening]:
    """The strongest of those that overlap, the strongest of all first."""
    kept: list[Opening] = []
    for own in sorted(openings, key=lambda opening: -opening.strength):
        if not any(own.first < other.last and other.first < own.last for other in kept):
            kept.append(own)
    return kept


def shows_from_the_floor(parts: FloatArray, shows: BoolArray, parts_min: float) -> bool:
    """Whether a jamb shows over at least a share of its height, and in the lowest part of it that was seen: it reaches the floor.

    parts: (p,) what was measured of each part, from the floor up; NaN of one that was not seen. shows: (p,) whether as a jamb does.
    """
    known = np.flatnonzero(np.isfinite(parts))
    if not len(known) or known[0] > 1 or not shows[known[0]]:
        return False
    return bool(shows.sum() >= parts_min * len(parts))


def doors_in_pictures(
    shown: Iterable[Picture], openings_in: Callable[[Picture], list[Opening]], known_min: float
) -> tuple[Doors, FloatArray]:
    """The closed doors that the faces' intensities show, and what shows each of them (D,), where that is strongest first.

    shown: see `pictures`. known_min: see `closed_door`.
    """
    doors, shows = NO_DOORS, []
    for w, picture in enumerate(shown):
        for own in openings_in(picture):
            if picture.is_of(own.first, own.last):
                opening = own.first, own.last
                door = closed_door(picture.face, opening, picture.counts, own.head_m, known_min, reach=picture.reach, wall=w)
                doors = doors.append(door)
                shows.append(own.shows)
    order = np.argsort(-np.abs(shows), kind="stable")
    return doors.select(order), np.array(shows, np.float64)[order]


def closed_door(
    face: Segment,
    opening: tuple[float, float],
    counts: FloatArray,
    head_m: float,
    known_min: float,
    reach: int = 0,
    **told: ArrayLike,
) -> Doors:
    """A single closed door, whose leaf lies in its wall's face unless told otherwise.

    opening: where its jambs stand, in columns of `counts` (c, rows, 4), see `WallCells`; `reach` of these columns lie before the
    face's start. known_min: share of a column that has to be seen for it to bear the door out. told: see `one_door`.
    """
    first, last = opening
    inner = counts[round(first) : round(last), FOOT_ROW : int(head_m / CELL_M)]
    on, passed = float(inner[..., FILLED].sum()), float(inner[..., THROUGH].sum())
    by_rays: dict[str, ArrayLike] = {
        "depth_m": 0.0,
        "agreement": on / (on + passed),
        "coverage": np.mean((inner[..., FILLED] > 0).mean(axis=1) > known_min),
        "ray_count": (on + passed) / 3,
    }
    ends = face.at(CELL_M * (np.array([first, last]) - reach))
    return one_door(ends=ends, normal=face.normal, head_m=head_m, state=DoorState.CLOSED, **by_rays | told)


def is_opaque(inner: FloatArray, building: BuildingSettings) -> bool:
    """Whether rays end on what fills an opening (c, rows, 4), over most of it."""
    on, passed = inner[..., FILLED].sum(), inner[..., THROUGH].sum()
    return bool(on > building.opaque_min * (on + passed) and np.mean(inner[..., FILLED] > 0) > building.known_min)
