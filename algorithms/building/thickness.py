"""How thick the walls are: behind which face lies its wall's other side (paper, Fig. 9a)."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.model import Doors, Walls
from ffmap.algorithms.scan.doors import DoorState


class WallThicknessSettings(StepSettings):
    """Finding the other side of a wall."""

    least_m: float = Field(
        0.03, gt=0, description="Thinnest wall in metres; two faces nearer than this are one."
    )
    most_m: float = Field(
        0.6, gt=0, description="Thickest wall in metres: faces farther apart belong to two walls."
    )
    angle_deg: float = Field(
        3.0, gt=0, le=20, description="The two sides of a wall are parallel to this many degrees."
    )
    unseen_m: float = Field(
        0.15,
        gt=0,
        description="Thickness in metres where no wall of the building was seen from both sides.",
    )
    beyond_face_m: float = Field(
        0.1,
        ge=0,
        description="Greatest distance (m) of a reveal's end beyond its wall's other face.",
    )


@dataclass(frozen=True)
class WallParts:
    """The faces of `Walls`, cut where the thickness behind them changes.

    wall: (P,) the face that each part belongs to. ends: (P, 2, 2) its stretch of that face.
    thickness_m: (P,) metres, NaN where the wall's other side was not seen.
    """

    wall: IntArray
    ends: FloatArray
    thickness_m: FloatArray


def part_walls(walls: Walls, settings: WallThicknessSettings) -> WallParts:
    """Each face cut where another of those begins or ends that look the other way behind it."""
    wall, ends, thickness = [], [], []
    cos_angle = np.cos(np.radians(settings.angle_deg))
    for w, face in enumerate(segments(walls)):
        behind = []
        for o in np.flatnonzero(walls.normal @ face.normal < -cos_angle).tolist():
            place, depth_m = face.place_m(walls.ends[o]), -face.before_m(walls.ends[o])
            low, high = max(float(place.min()), 0.0), min(float(place.max()), face.length_m)
            if high - low < 0.02:  # the rounding of a face's ends
                continue
            # Depth where the two overlap, for faces are parallel to some degrees only.
            slope = (depth_m[1] - depth_m[0]) / (place[1] - place[0])
            depth = float(depth_m[0] + slope * (0.5 * (low + high) - place[0]))
            if settings.least_m <= depth <= settings.most_m:
                behind.append((low, high, depth))
        edges = np.unique(
            [0.0, face.length_m, *(edge for low, high, _ in behind for edge in (low, high))]
        )
        for low, high in pairwise(edges.tolist()):
            middle = 0.5 * (low + high)
            wall.append(w)
            ends.append(face.at(np.array([low, high])))
            thickness.append(
                min(
                    (depth for first, last, depth in behind if first <= middle <= last),
                    default=np.nan,
                )
            )
    return WallParts(
        np.array(wall, np.int64),
        np.array(ends, float).reshape(-1, 2, 2),
        np.array(thickness, float),
    )


def face_thickness(walls: Walls, parts: WallParts) -> FloatArray:
    """(W,) the median, by length, along each face; NaN where the other side was not seen."""
    thickness_m = np.empty(len(walls))
    for w in range(len(walls)):
        own = (parts.wall == w) & np.isfinite(parts.thickness_m)
        thickness_m[w] = _median_by_length(
            parts.thickness_m[own], lengths_m(parts.ends[own]), float("nan")
        )
    return thickness_m


def usual_thickness(parts: WallParts, unknown_m: float) -> float:
    """The median, by length, of what was measured; `unknown_m` where nothing was."""
    measured = np.isfinite(parts.thickness_m)
    return _median_by_length(
        parts.thickness_m[measured], lengths_m(parts.ends[measured]), unknown_m
    )


def door_depths(
    doors: Doors,
    walls: Walls,
    parts: WallParts,
    settings: WallThicknessSettings,
    unknown_m: float,
    through_m: FloatArray,
) -> FloatArray:
    """(D,) how far each doorway reaches behind its sill: as far as its wall is thick.

    Of an open door the lintel's underside tells, which single scans measure, rather than the wall's
    two faces, between which lies the poses' drift. A closed leaf hides it: there the open doors in
    the same face tell, else the wall's faces, else the building's open doors, else its usual
    thickness.

    doors: their `reveal_m` is a measurement, or NaN. unknown_m: the depth where nothing of the
        building tells. through_m: (D,) how far behind each the other face of its wall shows it, or
        NaN: a frame in the middle of a thick wall ends the lintel's underside before that.
    """
    usual_m, thickness_m = (
        usual_thickness(parts, unknown_m),
        face_thickness(walls, parts)[doors.wall],
    )
    # Beyond the wall's other face goes on what hangs there as high as the lintel.
    most_m = np.where(np.isfinite(thickness_m), thickness_m + settings.beyond_face_m, np.inf)
    reveal_m = np.minimum(doors.reveal_m, most_m)
    reveal_m = np.where(through_m > reveal_m + settings.beyond_face_m, through_m, reveal_m)
    told = (doors.state == DoorState.OPEN) & (reveal_m >= settings.least_m)
    depth_m = np.where(
        np.isfinite(thickness_m), thickness_m, np.median(reveal_m[told]) if told.any() else usual_m
    )
    for wall in np.unique(doors.wall[told]):
        own = doors.wall == wall
        depth_m[own] = np.median(reveal_m[told & own])
    return np.where(told, reveal_m, np.fmax(depth_m, reveal_m))


def _median_by_length(values: FloatArray, length_m: FloatArray, otherwise: float) -> float:
    if not len(values):
        return otherwise
    order = np.argsort(values)
    covered = np.cumsum(length_m[order])
    return float(values[order][np.searchsorted(covered, 0.5 * covered[-1])])
