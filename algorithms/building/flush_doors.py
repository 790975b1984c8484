"""What the modules share that find closed doors whose leaf lies in the face of its wall."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, BuildingSettings, Doors, Walls
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, THROUGH
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


def flush_doors(
    walls: Walls, shown: Sequence[Picture], openings_in: Callable[[Picture], list[Opening]], known_min: float
) -> tuple[Doors, FloatArray]:
    """The closed doors that the faces' intensities show, and what shows each of them (D,), where that is strongest first.

    shown: see `pictures`. known_min: see `flush_door`.
    """
    doors, shows = NO_DOORS, []
    for w, (face, picture) in enumerate(zip(segments(walls), shown, strict=False)):
        for own in openings_in(picture):
            if picture.is_of(own.first, own.last):
                opening = own.first, own.last
                doors = doors.append(flush_door(face, w, opening, picture.reach, own.head_m, picture.counts, known_min))
                shows.append(own.shows)
    order = np.argsort(-np.abs(shows), kind="stable")
    return doors.select(order), np.array(shows, np.float64)[order]


def flush_door(
    face: Segment, wall: int, opening: tuple[float, float], before: int, head_m: float, counts: FloatArray, known_min: float
) -> Doors:
    """A single closed door whose leaf lies in its wall's face.

    opening: where its jambs stand, in columns of `counts` (c, rows, 4), see `WallCells`; `before` of these columns lie before the
    face's start. known_min: share of a column that has to be seen for it to bear the door out.
    """
    first, last = opening
    inner = counts[round(first) : round(last), FOOT_ROW : int(head_m / CELL_M)]
    on, passed = float(inner[..., FILLED].sum()), float(inner[..., THROUGH].sum())
    seen = float(np.mean((inner[..., FILLED] > 0).mean(axis=1) > known_min))
    return Doors(
        ends=face.at(CELL_M * (np.array([first, last]) - before))[None],
        normal=face.normal[None],
        head_m=np.array([head_m]),
        depth_m=np.zeros(1),
        state=np.array([DoorState.CLOSED], np.uint8),
        confidence=np.array([on / (on + passed) * seen]),
        agreement=np.array([on / (on + passed)]),
        coverage=np.array([seen]),
        lintel=np.ones(1),
        ajar=np.zeros(1, bool),
        ray_count=np.array([(on + passed) / 3], np.int32),
        scan_count=np.zeros(1, np.int32),
        first_scan=np.full(1, -1),
        last_scan=np.full(1, -1),
        crossed=np.zeros(1, bool),
        wall=np.array([wall], np.int32),
        reveal_m=np.full(1, np.nan),
        casing_m=np.full(1, np.nan),
        contrast=np.full(1, np.nan),
        outline=np.full(1, np.nan),
        glazed=np.zeros(1, bool),
    )


def glazed(door: Doors, depth_m: float, agreement: float) -> Doors:
    """A single closed door as one whose leaf is a pane: rays that pass that do not speak against it.

    agreement: share of what returns that is of the leaf.
    """
    agrees = np.array([agreement])
    return replace(
        door, depth_m=np.array([depth_m]), agreement=agrees, confidence=agrees * door.coverage, glazed=np.ones(1, bool)
    )


def is_opaque(inner: FloatArray, building: BuildingSettings) -> bool:
    """Whether rays end on what fills an opening (c, rows, 4), over most of it."""
    on, passed = inner[..., FILLED].sum(), inner[..., THROUGH].sum()
    return bool(on > building.opaque_min * (on + passed) and np.mean(inner[..., FILLED] > 0) > building.known_min)
