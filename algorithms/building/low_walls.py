"""Walls that end below the ceiling: parapets, half-height partitions, a room within a room.

Above them rays pass, as above furniture. But a wall shows both its sides, at a wall's distance from
each other and as high as each other: what stands against a wall is deeper, screens and leaves are
thinner, and a shelf has no back to be seen.
"""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.known import median_known
from ffmap.algorithms.base.scan import BoolArray
from ffmap.algorithms.base.segments import lengths_m, segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.evidence import ON
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, Walls
from ffmap.algorithms.building.parse import Kind, Stretch
from ffmap.algorithms.building.settle import ParsedFaces
from ffmap.algorithms.building.verdicts import SAME_WAY

_PARALLEL = 0.998
"""Cosine of what the two sides of a wall differ by at most."""


class LowWallsSettings(StepSettings):
    """Telling walls that end below the ceiling from furniture."""

    thickness_m: tuple[float, float] = Field(
        (0.06, 0.25), description="Thickness (m) of a wall neither side of which reaches a ceiling."
    )
    room_wall_max_m: float = Field(
        0.4, gt=0, description="Maximum thickness (m) of a wall whose other side reaches a ceiling."
    )
    height_min_m: float = Field(0.75, gt=0, description="Minimum height (m) of a low wall.")
    length_min_m: float = Field(0.8, gt=0, description="Minimum length (m) of a low wall.")
    level_m: float = Field(
        0.15, gt=0, description="Maximum difference (m) in height of a wall's two sides."
    )
    odds_min: float = Field(
        3.0, ge=0, description="Least odds (nats) of each side for ending low, against all else."
    )


@dataclass(frozen=True)
class _Side:
    """A stretch that ends low, as a single face. ceiling_m: before it, above the floor."""

    face: Walls
    ceiling_m: float

    @property
    def top_m(self) -> float:
        return float(self.face.top_m[0])


def find_low_walls(parsed: ParsedFaces, walls: Walls, settings: LowWallsSettings) -> Walls:
    """The sides of low walls among parsed lines of returns that no wall explains.

    walls: the known ones, which reach a ceiling.
    """
    sides = [side for w in range(len(parsed.stretches)) for side in _sides(parsed, w, settings)]
    found: list[Walls] = []
    for side in sides:
        is_wall = any(_are_two_sides(side, other, settings) for other in sides)
        is_wall = is_wall or _is_outside_of_a_room(side, walls, settings)
        # A surface that drift has smeared makes several lines.
        if is_wall and not any(_is_same(side.face, other, settings) for other in found):
            found.append(side.face)
    return reduce(Walls.append, found, NO_WALLS)


def _sides(parsed: ParsedFaces, w: int, settings: LowWallsSettings) -> list[_Side]:
    """The stretches of a line that end low: next to each other they are one."""
    faces, runs = parsed.faces, list[list[Stretch]]()
    for own in parsed.stretches[w]:
        if own.kind != Kind.LOW:
            continue
        last = runs[-1][-1] if runs else None
        alike = last is not None and abs(last.sill - own.sill) * CELL_M <= settings.level_m
        if last is not None and last.after == own.first and alike:
            runs[-1].append(own)
        else:
            runs.append([own])
    sides = []
    for run in runs:
        first, after = run[0].first, run[-1].after
        columns = slice(faces.columns(w).start + first, faces.columns(w).start + after)
        on = faces.evidence.ended[columns, :, ON]
        shown = bool((on.sum(axis=1) > 0).mean() > 0.5)
        top_m = max(own.sill for own in run) * CELL_M
        odds = sum(own.odds for own in run)
        long = (after - first) * CELL_M >= settings.length_min_m
        if shown and long and odds >= settings.odds_min and top_m >= settings.height_min_m:
            face = replace(parsed.cut([(w, first, after)]), top_m=np.array([top_m]))
            returns = np.array([on.sum()], np.int64)
            face = replace(face, sample_count=returns, rms_m=np.array([np.nan]))
            sides.append(_Side(face, median_known(faces.clear_m[columns])))
    return sides


def _are_two_sides(side: _Side, other: _Side, settings: LowWallsSettings) -> bool:
    """Whether two sides are of one wall: beside each other, and as high."""
    level = abs(side.top_m - other.top_m) < settings.level_m
    return level and _is_behind(side.face, other.face, settings.thickness_m[1], settings)


def _is_outside_of_a_room(side: _Side, walls: Walls, settings: LowWallsSettings) -> bool:
    """Whether a side is a room's outside: as high as a wall seen from within, in a higher room."""
    for w in range(len(walls)):
        wall, top_m = walls.one(w), float(walls.top_m[w])
        is_as_high = side.top_m > top_m - settings.level_m
        is_lower = side.ceiling_m > top_m + settings.level_m
        near = _is_behind(side.face, wall, settings.room_wall_max_m, settings)
        if is_as_high and is_lower and near:
            return True
    return False


def _is_behind(face: Walls, other: Walls, most_m: float, settings: LowWallsSettings) -> bool:
    """Whether another single face looks the other way, a wall's thickness behind most of one."""
    own = segment(face, 0)
    if other.normal[0] @ own.normal > -_PARALLEL:
        return False
    behind_m = -float(own.before_m(other.ends[0].mean(axis=0)))
    beside = own.shared_m(other.ends[0]) > 0.5 * own.length_m
    return beside and settings.thickness_m[0] < behind_m < most_m


def _is_same(face: Walls, other: Walls, settings: LowWallsSettings) -> bool:
    """Whether two single faces show one surface."""
    own = segment(face, 0)
    off_m = np.abs(own.before_m(other.ends[0])).max()
    looks = own.normal @ other.normal[0] > _PARALLEL
    beside = own.shared_m(other.ends[0]) > 0.5 * own.length_m
    return bool(looks and beside and off_m < settings.thickness_m[0])


def along_low_walls(refused: Walls, low: Walls, noise_m: float) -> BoolArray:
    """(R,) which refused faces are mostly the low walls' sides, to within `noise_m`."""
    along_m = np.zeros(len(refused))
    for face in segments(low):
        for r in np.flatnonzero(refused.normal @ face.normal > SAME_WAY):
            if np.abs(face.before_m(refused.ends[r])).max() < noise_m:
                along_m[r] += max(face.shared_m(refused.ends[r]), 0.0)
    return np.asarray(along_m > 0.5 * lengths_m(refused.ends))
