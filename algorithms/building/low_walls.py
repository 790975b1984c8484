"""Walls that end below the ceiling: parapets, half-height partitions, and the outsides of a room within a room.

Above them rays pass, as above furniture. But a wall shows both its sides, at a wall's distance from each other, both plane and as
high as each other: what stands against a wall is deeper, screens and leaves are thinner, and a shelf has no back to be seen.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.known import median_known
from ffmap.algorithms.base.scan import BoolArray, IntArray
from ffmap.algorithms.base.segments import lengths_m, segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import FILLED, depth_moments, with_neighbours
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import (
    TracedFace,
    TracedFaces,
    long_runs,
    on_and_passed,
    runs,
)
from ffmap.algorithms.building.face_verdicts import SAME_WAY
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, BuildingSettings, Walls, cells_in
from ffmap.algorithms.building.unexplained_lines import Line, both_sides

_STANDS_MIN = 0.8
"""Share of a side's columns that rays end on."""
_PARALLEL = 0.998
"""Cosine of what the two sides of a wall differ by at most."""


class LowWallsSettings(StepSettings):
    """Telling walls that end below the ceiling from furniture."""

    thickness_min_m: float = Field(
        0.06, gt=0, description="Minimum thickness (m) of a low wall: screens and leaves are thinner."
    )
    thickness_max_m: float = Field(
        0.25, gt=0, description="Maximum thickness (m) of a wall neither side of which reaches a ceiling."
    )
    room_wall_max_m: float = Field(
        0.4, gt=0, description="Maximum thickness (m) of a wall the other side of which reaches its room's ceiling."
    )
    height_min_m: float = Field(0.75, gt=0, description="Minimum height (m) of a low wall.")
    length_min_m: float = Field(0.8, gt=0, description="Minimum length (m) of a low wall.")
    level_m: float = Field(0.15, gt=0, description="Maximum difference (m) in height of a wall's two sides.")
    spread_max_m: float = Field(0.03, gt=0, description="Maximum scatter (m) of a side's returns, column by column.")
    passed_max: float = Field(
        0.2, ge=0, lt=1, description="Maximum rays that pass a column of a side, up to its top, for each that ends there."
    )


@dataclass(frozen=True)
class _Side:
    """A stretch of a candidate that is plane and that rays end on from the foot up.

    face: a single one, as high as rays end on it somewhere. top_m: as high as they do over half of it: a window may cut into it.
    ceiling_m: of the room before it, above the floor; NaN where none was seen.
    """

    face: Walls
    top_m: float
    ceiling_m: float


def find_low_walls(
    lines: list[Line],
    walls: Walls,
    trace: Callable[[Walls], TracedFaces],
    building: BuildingSettings,
    settings: LowWallsSettings,
) -> Walls:
    """The sides of low walls among lines of returns that no wall explains, each as high as rays end on it.

    walls: the known ones, which reach a ceiling.
    """
    long_lines = [line for line in lines if float(np.linalg.norm(np.diff(line[0], axis=0))) >= settings.length_min_m]
    faces = both_sides(long_lines) if long_lines else NO_WALLS
    pairs = _two_sides(faces, walls, settings)
    if not len(pairs):
        return NO_WALLS
    asked = np.unique(pairs[:, 0])
    traced = trace(faces.select(asked))
    sides = {int(asked[face.number]): list(_sides(face, traced, building, settings)) for face in traced.each()}
    found = NO_WALLS
    for own in asked:
        others = pairs[pairs[:, 0] == own, 1]
        for side in sides[int(own)]:
            behind = [other for k in others if k < len(faces) for other in sides.get(int(k), [])]
            within = [walls.one(k - len(faces)) for k in others if k >= len(faces)]
            is_pair = any(_are_two_sides(side, other, settings) for other in behind)
            is_wall = is_pair or any(_is_outside_of(side, wall, settings) for wall in within)
            # A surface that drift has smeared makes several lines.
            if is_wall and not _is_known(side, found, settings):
                found = found.append(side.face)
    return found


def _two_sides(faces: Walls, walls: Walls, settings: LowWallsSettings) -> IntArray:
    """(p, 2) each face with another that looks the other way, a wall's thickness behind it: the second number is a face's, or
    the number of faces plus a wall's.

    There is none where a wall that looks the same way lies between: what stands before that is no side of it.
    """
    both, pairs = faces.append(walls), list[tuple[int, int]]()
    is_wall = np.arange(len(both)) >= len(faces)
    most_m = np.where(is_wall, settings.room_wall_max_m, settings.thickness_max_m)
    for own, face in enumerate(segments(faces)):
        looks, place_m = both.normal @ face.normal, face.place_m(both.ends)
        within_m = np.clip(place_m, 0.0, face.length_m)
        beside = np.flatnonzero((np.abs(looks) > _PARALLEL) & (np.ptp(within_m, axis=1) >= settings.length_min_m))
        # In the middle of what is beside: a long wall that is askew lies elsewhere by its own.
        share = (within_m[beside].mean(axis=1) - place_m[beside, 0]) / np.diff(place_m[beside])[:, 0]
        first_m, last_m = -face.before_m(both.ends[beside]).T
        behind_m, opposite = first_m + share * (last_m - first_m), looks[beside] < 0.0
        nearest_m = behind_m[is_wall[beside] & ~opposite & (behind_m > 0.0)].min(initial=np.inf)
        near = opposite & (behind_m > settings.thickness_min_m) & (behind_m < np.minimum(most_m[beside], nearest_m))
        pairs += [(own, int(k)) for k in beside[near]]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _sides(
    traced: TracedFace, faces: TracedFaces, building: BuildingSettings, settings: LowWallsSettings
) -> Iterator[_Side]:
    """The stretches of a candidate that may be a low wall's side."""
    on, passed = on_and_passed(with_neighbours(traced.counts))
    opened = (passed > on) & (np.arange(on.shape[1]) >= FOOT_ROW)
    # Where nothing was seen to pass, nothing is known of a top.
    top = np.where(opened.any(axis=1), np.argmax(opened, axis=1), 0)
    below = (np.arange(on.shape[1]) >= FOOT_ROW) & (np.arange(on.shape[1]) < top[:, None])
    # A seat, or a bed, hides the foot of its back: what shows above it alone is no wall.
    shown = np.count_nonzero((on > 0) & below, axis=1) >= building.known_min * np.count_nonzero(below, axis=1)
    on, passed = (on * below).sum(axis=1), (passed * below).sum(axis=1)
    stands = shown & (on >= building.rays_min) & (passed <= settings.passed_max * on)
    for first, after in runs(long_runs(stands, 1, bridge=cells_in(building.gap_m))):
        own = stands[first:after]
        tops = top[first:after][own] * CELL_M
        top_m, highest_m = float(np.median(tops)), float(np.percentile(tops, 90))
        cells = traced.counts[first:after, FOOT_ROW : cells_in(top_m)].sum(axis=1)
        spread_m = float(np.nanmedian(np.sqrt(depth_moments(cells)[1]))) if cells[..., FILLED].any() else np.inf
        is_long = (after - first) * CELL_M >= settings.length_min_m and own.mean() >= _STANDS_MIN
        if is_long and top_m >= settings.height_min_m and spread_m < settings.spread_max_m:
            face = replace(
                faces.cut([(traced.number, first, after)]),
                top_m=np.array([highest_m]),
                rms_m=np.array([spread_m]),
                sample_count=np.array([cells[:, FILLED].sum()], np.int64),
            )
            yield _Side(face, top_m, median_known(faces.clear_m[traced.columns][first:after]))


def _are_two_sides(side: _Side, other: _Side, settings: LowWallsSettings) -> bool:
    """Whether two sides are of one wall: as high as each other, and beside each other."""
    return _is_beside(side, other.face) and abs(side.top_m - other.top_m) < settings.level_m


def _is_outside_of(side: _Side, wall: Walls, settings: LowWallsSettings) -> bool:
    """Whether a side is the outside of a room: as high as a single wall that is seen from within, and in a room that is higher.

    What stands against that wall in a room as high as the one behind hides it, and is furniture.
    """
    is_as_high = side.face.top_m[0] > wall.top_m[0] - settings.level_m
    return _is_beside(side, wall) and bool(is_as_high and side.ceiling_m > wall.top_m[0] + settings.level_m)


def _is_beside(side: _Side, other: Walls) -> bool:
    """Whether a single face lies beside most of a side."""
    face = segment(side.face, 0)
    return face.shared_m(other.ends[0]) > 0.5 * face.length_m


def _is_known(side: _Side, found: Walls, settings: LowWallsSettings) -> bool:
    """Whether one of some sides is the same, or what is smeared of it."""
    face = segment(side.face, 0)
    return any(
        face.normal @ other.normal > _PARALLEL
        and np.abs(face.before_m(found.ends[k])).max() < settings.thickness_min_m
        and _is_beside(side, found.one(k))
        for k, other in enumerate(segments(found))
    )


def without_low_walls(refused: Walls, low: Walls, noise_m: float) -> BoolArray:
    """(R,) which refused faces are none of the low walls' sides: most of one that is lies along these, within `noise_m`."""
    along_m = np.zeros(len(refused))
    for face in segments(low):
        for r in np.flatnonzero(refused.normal @ face.normal > SAME_WAY):
            if np.abs(face.before_m(refused.ends[r])).max() < noise_m:
                along_m[r] += max(face.shared_m(refused.ends[r]), 0.0)
    return np.asarray(along_m <= 0.5 * lengths_m(refused.ends))
