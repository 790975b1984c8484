"""Walls that end below the ceiling: parapets, half-height partitions, and the outsides of a room within a room.

Above them rays pass, as above furniture. But a wall shows both its sides, at a wall's distance from each other, both plane and as
high as each other: what stands against a wall is deeper, screens and leaves are thinner, and a shelf has no back to be seen.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, IntArray
from ffmap.algorithms.base.segments import NORMAL_X, NORMAL_Y, OFFSET, lengths_m, lines_of, segment
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.face_columns import TracedFace, TracedFaces, long_runs, on_and_passed, runs
from ffmap.algorithms.building.face_verdicts import SAME_WAY
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, BuildingSettings, Walls, cells_in
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, depth_moments, with_neighbours
from ffmap.algorithms.building.unexplained_lines import Line, both_sides

_STANDS_MIN = 0.8
"""Share of a side's columns that rays end on."""


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
    """A stretch of a candidate, between two columns, that is plane and that rays end on from the foot up to `top_m`, and to
    `highest_m` somewhere: a window cuts into it."""

    face: Walls
    top_m: float
    highest_m: float


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
    lines = [line for line in lines if float(np.linalg.norm(np.diff(line[0], axis=0))) >= settings.length_min_m]
    pairs = _two_sides(both_sides(lines), walls, settings) if lines else np.zeros((0, 2), np.int64)
    if not len(pairs):
        return NO_WALLS
    asked = np.unique(pairs[:, 0])
    faces = both_sides(lines).select(asked)
    sides = {int(asked[face.number]): list(_sides(face, faces, building, settings)) for face in trace(faces).each()}
    count, found = 2 * len(lines), NO_WALLS
    for own in asked:
        others = pairs[pairs[:, 0] == own, 1]
        for side in sides[int(own)]:
            in_pairs = (_are_two_sides(side, other, settings) for k in others if k < count for other in sides.get(int(k), []))
            of_room = (_is_outside_of(side, walls.one(k - count), settings) for k in others if k >= count)
            if any(in_pairs) or any(of_room):
                found = found.append(side.face)
    return found


def _two_sides(faces: Walls, walls: Walls, settings: LowWallsSettings) -> IntArray:
    """(p, 2) each face with another that looks the other way, a wall's thickness behind it; beyond the faces' number, a wall.

    There is none where a wall that looks the same way lies between: what stands before that is no side of it.
    """
    both = faces.append(walls)
    lines, middles = lines_of(faces), both.ends.mean(axis=1)
    behind_m = lines[:, [OFFSET]] - lines[:, [NORMAL_X, NORMAL_Y]] @ middles.T
    is_wall, looks = np.arange(len(both)) >= len(faces), faces.normal @ both.normal.T
    most_m = np.where(is_wall, settings.room_wall_max_m, settings.thickness_max_m)
    near = (behind_m > settings.thickness_min_m) & (behind_m < most_m) & (looks < -SAME_WAY)
    between = (behind_m > 0.0) & (behind_m < settings.room_wall_max_m) & (looks > SAME_WAY) & is_wall
    pairs: list[tuple[int, int]] = []
    for own in np.flatnonzero(near.any(axis=1)):
        face = segment(faces, own)
        beside = [k for k in np.flatnonzero(near[own] | between[own]) if face.shared_m(both.ends[k]) >= settings.length_min_m]
        first_m = min((behind_m[own, k] for k in beside if between[own, k]), default=np.inf)
        pairs += [(int(own), int(k)) for k in beside if near[own, k] and behind_m[own, k] < first_m]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _sides(
    traced: TracedFace, faces: Walls, building: BuildingSettings, settings: LowWallsSettings
) -> Iterator[_Side]:
    """The stretches of a candidate that may be a low wall's side."""
    on, passed = on_and_passed(with_neighbours(traced.counts))
    opened = (passed > on) & (np.arange(on.shape[1]) >= FOOT_ROW)
    # Where nothing was seen to pass, nothing is known of a top.
    top = np.where(opened.any(axis=1), np.argmax(opened, axis=1), 0)
    below = (np.arange(on.shape[1]) >= FOOT_ROW) & (np.arange(on.shape[1]) < top[:, None])
    on, passed = (on * below).sum(axis=1), (passed * below).sum(axis=1)
    stands = (on >= building.rays_min) & (passed <= settings.passed_max * on)
    for first, after in runs(long_runs(stands, 1, bridge=cells_in(building.gap_m))):
        own = stands[first:after]
        tops = top[first:after][own] * CELL_M
        top_m, highest_m = float(np.median(tops)), float(np.percentile(tops, 90))
        cells = traced.counts[first:after, FOOT_ROW : cells_in(top_m)].sum(axis=1)
        spread_m = float(np.nanmedian(np.sqrt(depth_moments(cells)[1]))) if cells[..., FILLED].any() else np.inf
        is_long = (after - first) * CELL_M >= settings.length_min_m and own.mean() >= _STANDS_MIN
        if is_long and top_m >= settings.height_min_m and spread_m < settings.spread_max_m:
            ends = traced.segment.at(np.array([first, after]) * CELL_M)
            count = np.array([cells[:, FILLED].sum()], np.int64)
            face = replace(
                faces.one(traced.number),
                ends=ends[None],
                top_m=np.array([highest_m]),
                rms_m=np.array([spread_m]),
                sample_count=count,
            )
            yield _Side(face, top_m, highest_m)


def _are_two_sides(side: _Side, other: _Side, settings: LowWallsSettings) -> bool:
    """Whether two sides are of one wall: as high as each other, and beside each other over most of the one."""
    shared_m = segment(side.face, 0).shared_m(other.face.ends[0])
    is_beside = shared_m > 0.5 * float(lengths_m(side.face.ends)[0])
    return bool(is_beside and abs(side.top_m - other.top_m) < settings.level_m)


def _is_outside_of(side: _Side, wall: Walls, settings: LowWallsSettings) -> bool:
    """Whether a side is the outside of a room: as high as the single wall that is seen from within, or higher."""
    shared_m = segment(side.face, 0).shared_m(wall.ends[0])
    is_beside = shared_m > 0.5 * float(lengths_m(side.face.ends)[0])
    return bool(is_beside and side.highest_m > wall.top_m[0] - settings.level_m)


def without_low_walls(refused: Walls, low: Walls, noise_m: float) -> BoolArray:
    """(R,) which refused faces are none of the low walls' sides; noise_m: maximum distance of one that is."""
    kept, middles = np.ones(len(refused), bool), refused.ends.mean(axis=1)
    for k in range(len(low)):
        face = segment(low, k)
        along = (np.abs(face.before_m(middles)) < noise_m) & face.beside(middles)
        kept &= ~(along & (refused.normal @ face.normal > SAME_WAY))
    return kept
