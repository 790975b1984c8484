"""Verdicts on faces: which stand, and which are alone, or belong to another house."""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, UInt8Array
from ffmap.algorithms.base.segments import Faces, lengths_m, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.model import Walls

ACROSS = 0.5
"""Cosine of the angle between two faces below which one stands across the other."""
SAME_WAY = 0.9
"""Cosine of the angle between two faces above which they look the same way."""
_ALONG = 0.99
"""Cosine of the angle between a face and the walls along or across which it runs: 8 degrees, by
which the ends of half a metre may be off."""
_CORNER_SINE_MIN = 0.3
"""Minimum sine of the angle between two faces that make a corner."""


class StandingWallsSettings(StepSettings):
    """Telling walls from what only looks like one."""

    corner_m: float = Field(
        0.7, ge=0, description="Maximum distance (m) that a face is extended to a corner."
    )
    corner_reached_m: float = Field(
        0.1, ge=0, description="A face that ends up to this (m) behind a corner ends there."
    )
    scans_few: int = Field(
        10,
        ge=0,
        description="A face that fewer scans saw, and that runs along and across no others, has to "
        "show itself as a wall.",
    )
    direction_share_min: float = Field(
        0.04,
        ge=0,
        le=1,
        description="Minimum share of the faces' length that makes a direction one of the walls'.",
    )


class FaceVerdict(IntEnum):
    """What the rays of all scans say of a face."""

    STANDS = 0
    """Nothing passes it but through openings: a wall."""
    ENDS_LOW = 1
    """Rays pass above it, below the ceiling: a leaf, a cupboard, a partition."""
    HANGS = 2
    """Rays pass below it over a longer stretch than an opening has: a duct, a beam."""
    ALONE = 3
    """Few scans saw it, it runs along and across no others, and does not show as a wall."""
    OUTSIDE = 4
    """Neither floor nor ceiling was seen before it: another house's front, through a window."""


@dataclass(frozen=True)
class JudgedFaces:
    """The faces that stand, and those that do not with the verdict on each."""

    walls: Walls
    refused: Walls
    verdict: UInt8Array

    @property
    def refused_label(self) -> UInt8Array:
        """(R,) what the returns of each refused face are."""
        return _REFUSED_LABELS[self.verdict]

    def refuse(self, more: Walls, verdict: FaceVerdict) -> "JudgedFaces":
        """The same with more refused faces."""
        verdicts = np.concatenate([self.verdict, np.full(len(more), verdict, np.uint8)])
        return replace(self, refused=self.refused.append(more), verdict=verdicts)


_REFUSED_LABELS = np.full(len(FaceVerdict), Label.CLUTTER, np.uint8)
_REFUSED_LABELS[FaceVerdict.OUTSIDE] = Label.OUTSIDE


def join_corners(walls: Walls, others: Walls, settings: StandingWallsSettings) -> Walls:
    """Faces extended to the corners that they make with others, where both end or pass nearby."""
    corner_m = settings.corner_m
    ends = walls.ends.copy()
    across = list(segments(others))
    for w, face in enumerate(segments(walls)):
        best = np.array([corner_m, corner_m])
        for other in across:
            turn = float(face.normal @ other.along)
            if abs(turn) < _CORNER_SINE_MIN:
                continue
            t_other = -float(face.before_m(other.start)) / turn
            if not -corner_m < t_other < other.length_m + corner_m:
                continue
            corner = other.at(np.array([t_other]))[0]
            place = float(face.place_m(corner))
            for end, beyond_m in enumerate((-place, place - face.length_m)):
                if 0 < beyond_m < best[end]:
                    best[end], ends[w, end] = beyond_m, corner
                elif -settings.corner_reached_m < beyond_m <= 0:
                    best[end], ends[w, end] = 0.0, walls.ends[w, end]
    return replace(walls, ends=ends)


def along_others(faces: Faces, walls: Walls, settings: StandingWallsSettings) -> BoolArray:
    """(n,) whether a face runs along or across a good part of the building's walls."""
    directions = wall_directions(walls, settings.direction_share_min)
    if not len(directions):
        return np.ones(len(faces.normal), bool)
    return np.asarray(np.abs(faces.normal @ directions.T).max(axis=1) > _ALONG)


def wall_directions(walls: Walls, share_min: float) -> FloatArray:
    """(k, 2) the normals that walls have, and those across them; the longest walls' first.

    share_min: minimum share of the walls' total length that has a direction.
    """
    length = lengths_m(walls.ends)
    angle = np.degrees(np.arctan2(walls.normal[:, 1], walls.normal[:, 0])) % 90.0
    left = np.ones(len(walls), bool)
    found: list[float] = []
    while left.any():
        longest = int(np.argmax(np.where(left, length, 0.0)))
        turn = (angle - angle[longest] + 45.0) % 90.0 - 45.0
        same = left & (np.abs(turn) < 2.0)
        if length[same].sum() < share_min * length.sum():
            left &= ~same
            continue
        mean = angle[longest] + float(np.average(turn[same], weights=length[same]))
        found += [mean, mean + 90.0]
        left &= ~same
    radians = np.radians(np.array(found))
    return np.stack([np.cos(radians), np.sin(radians)], axis=1)
