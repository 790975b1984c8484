"""The walls that no single scan could tell: returns of all scans in line, where rays end up to the ceiling, or to a duct."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.building.face_columns import (
    SILL_M,
    SMOOTH_COLUMNS,
    Columns,
    Storey,
    column_places,
    count_columns,
    cut_faces,
    long_runs,
    median_m,
    on_and_passed,
    room_before,
    rows_on_and_passed,
    runs,
    visited_columns,
)
from ffmap.algorithms.building.face_verdicts import (
    ACROSS,
    BEFORE_M,
    FURNITURE_M,
    NOISE_M,
    SAME_WAY,
    SCATTERED_RAYS,
    StandingWallsSettings,
    wall_directions,
)
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, Walls, cells_in
from ffmap.algorithms.building.openings import widened
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, WallCells
from ffmap.algorithms.building.votes import VoxelVotes, majority

_AT_CORNER_M = 0.15
_WINDOW_COLUMNS = 60
"""A window is at most so many columns wide."""
_PILLAR_SHARE = 0.8
_BELOW_CEILING_M, _ABOVE_HEADS_M = 0.35, 2.25
"""What is seen neither so close below the ceiling nor so far up is a leaf, or the reveal of a window."""
_UNDERSIDE_MIN_M, _UNDERSIDE_NEAR_M, _UNDERSIDE_CELL_M = 1.8, 0.15, 0.1
"""No duct's underside is lower; so near is it to where its wall ends. It shows in most of the cells of so many metres."""
_DUCT_DEPTH_M, _DUCT_SHARE, _BELOW_DUCT_MIN_M = (0.3, 0.8), 0.7, 0.8
"""How deep ducts are; over how much of a wall below one it hangs, and shows; how long such a wall is at least, in metres."""
_EXPLAINED_M = 0.08
"""What lies so close to a face, and so far beyond its ends, is its own."""


@dataclass(frozen=True)
class HiddenWalls:
    """Walls that no single scan could tell, and what hung before some of them.

    walls: the hidden ones. known: the known faces, without what hangs before a hidden wall. ducts: that.
    """

    walls: Walls
    known: Walls
    ducts: Walls


def find_hidden_walls(
    votes: VoxelVotes,
    storey: Storey,
    walls: Walls,
    refused: Walls,
    path_map: FloatArray,
    trace: Callable[[Walls], WallCells],
    length_min_m: float,
    settings: StandingWallsSettings,
) -> HiddenWalls:
    """Walls that scans saw too little of for a plane: returns of all scans that stand in line with the building's walls.

    Upright columns of returns that belong to no face are looked through for straight lines in the directions that the
    walls have; a line is a wall where rays end on it up to the ceiling and next to none passes, or up to the underside of a
    duct that hides it above. They stand where they were looked for: to a few centimetres.

    votes: of all scans; storey: their floor and ceiling. walls, refused: the faces that explain what returned at them.
    path_map: (n, 2) the robot's places: where it was stands no wall. trace: counts rays against faces; a return more than
    some centimetres behind a face counts as passed, and rays through windows do not count.
    """
    both = _candidates(votes, walls, refused, settings)
    if not len(both):
        return HiddenWalls(NO_WALLS, walls, NO_WALLS)
    before, close_before = (_before_a_face(both, walls, depth_m) for depth_m in (FURNITURE_M, BEFORE_M))
    backs = replace(both, normal=-both.normal)
    cells = trace(both)
    clear_m = storey.clear_m(column_places(both, cells.first), settings.ceiling_near_m)
    free = np.isfinite(clear_m) & ~visited_columns(both, cells, path_map, settings.robot_m)
    columns = count_columns(cells, clear_m, settings.above_door_m)
    kept: list[tuple[int, int, int]] = []
    top_m: list[float] = []
    ducts: list[tuple[int, float, float]] = []
    undersides = _undersides(votes)
    for w in range(len(both)):
        own = slice(int(cells.first[w]), int(cells.first[w + 1]))
        rays = columns.part(own)
        may_be = free[own] & ~_crossed_by(walls, both, w, own.stop - own.start)
        # Between a cupboard and a duct, and over a table, rays pass to the room behind; through a window they leave the building.
        may_have_window = not before[w] and bool(_has_sill(rays, settings).any())
        is_outer = may_have_window and not room_before(backs.select(np.array([w])), storey)[0]
        told = _tell_columns(rays, may_be, is_outer, settings)
        for first, after in _stretches(told, cells.counts[own], settings):
            counts, ceiling_m = cells.counts[own][first:after], median_m(clear_m[own][first:after])
            face = cut_faces(both, cells, [(w, first, after)])
            length_m = (after - first) * CELL_M + _to_corners_m(face, walls)
            duct = _duct_before(face, counts, walls, undersides)
            if (
                length_m >= length_min_m
                and _is_proven(
                    rays.part(slice(first, after)), told.part(slice(first, after)), duct is not None, settings
                )
                and (duct is not None or _reaches_ceiling(counts, ceiling_m, told.window[first:after], close_before[w]))
                and room_before(face, storey)[0]
            ):
                if duct is not None:
                    ducts.append(duct)
                # Beside it a window may go on, of which not more than the sill is seen.
                first, last = widened(told.sill, first, after - 1, _WINDOW_COLUMNS)
                kept.append((w, first, last + 1))
                top_m.append(ceiling_m)
    hidden = cut_faces(both, cells, kept)
    return HiddenWalls(replace(hidden, top_m=np.array(top_m)), *_cut_out(walls, ducts, length_min_m))


def _candidates(votes: VoxelVotes, walls: Walls, refused: Walls, settings: StandingWallsSettings) -> Walls:
    """Lines of unexplained returns as faces; which side each is seen from is not known yet, so both are tried."""
    place, weight = _unexplained_columns(votes, walls, refused)
    found = _straight_lines(place, weight, wall_directions(walls), settings)
    found += _pillar_sides(place, weight, walls, settings)
    if not found:
        return NO_WALLS
    ends = np.array([e for e, _ in found])
    normal = np.array([n for _, n in found])
    both = Walls(
        np.concatenate([ends, ends[:, ::-1]]),
        np.concatenate([normal, -normal]),
        np.zeros(2 * len(found)),
        np.full(2 * len(found), 5.0),
        np.ones(2 * len(found), np.int32),
        np.zeros(2 * len(found)),
    )
    return both.select(~_before_a_face(both, walls, NOISE_M) & ~_faces_a_face(both, walls, BEFORE_M))


@dataclass(frozen=True)
class _Told:
    """What the columns (c,) of a candidate are.

    proven: wall from floor to ceiling, or up to a window's sill and above its head. window: of these, what may be a window's.
    sill: nothing passes below a sill's height, whatever is above. contradicted: rays pass.
    """

    proven: BoolArray
    window: BoolArray
    sill: BoolArray
    contradicted: BoolArray

    def part(self, columns: slice) -> "_Told":
        return _Told(self.proven[columns], self.window[columns], self.sill[columns], self.contradicted[columns])


def _tell_columns(columns: Columns, may_be: BoolArray, is_outer: bool, settings: StandingWallsSettings) -> _Told:
    """Tell a candidate's columns; may_be: (c,) where a wall may stand. is_outer: whether nothing of the building is known
    behind it, so that it may have windows.
    """
    passed_max = settings.hidden_passed_max
    on, passed = columns.upper_on + columns.lower_on, columns.upper_passed + columns.lower_passed
    solid = (
        (on > 0)
        & (passed <= passed_max * on)
        & (columns.lower_passed <= passed_max * columns.lower_on + SCATTERED_RAYS)
        & (columns.upper_passed <= 0.5 * columns.upper_on)
    )
    sill = may_be & is_outer & _has_sill(columns, settings)
    window = sill & (columns.upper_on > SCATTERED_RAYS) & (columns.crown_passed <= 0.5 * columns.crown_on)
    proven = (solid & may_be) | window
    return _Told(proven, window, sill, ~may_be | ((passed > 2 * SCATTERED_RAYS) & ~proven))


def _has_sill(columns: Columns, settings: StandingWallsSettings) -> BoolArray:
    """(c,) whether rays end on the columns, and next to none passes, up to where windows' sills are."""
    return np.asarray(columns.sill_passed + SCATTERED_RAYS < settings.hidden_passed_max * columns.sill_on)


def _stretches(told: _Told, counts: FloatArray, settings: StandingWallsSettings) -> Iterator[tuple[int, int]]:
    """First column, and the one after the last, of what may be one wall; counts: (c, rows, 4)."""
    returned = np.any(counts[..., FILLED] > 0, axis=1)
    on, passed = (rays.sum(axis=1) for rays in on_and_passed(counts))
    bridged = long_runs(told.proven, 1, bridge=cells_in(settings.hidden_gap_m)) & ~told.contradicted
    for first, after in runs(bridged):
        # Columns were told with those beside them: what has no returns itself is too much, and a pillar's outer columns lack.
        own = np.flatnonzero(returned[first:after])
        if len(own):
            begin, last = widened(on > passed, first + int(own[0]), first + int(own[-1]), SMOOTH_COLUMNS)
            yield begin, last + 1


def _is_proven(columns: Columns, told: _Told, below_duct: bool, settings: StandingWallsSettings) -> bool:
    """Whether most columns of a stretch are proven, most are seen above doors unless a duct hides them, and by returns enough."""
    returns = float((columns.upper_on + columns.lower_on).sum()) / (2 * SMOOTH_COLUMNS + 1)
    seen_above, proven = np.mean(columns.upper_on > 0), np.mean(told.proven)
    return bool((seen_above > 0.5 or below_duct) and proven > 0.5 and returns >= settings.hidden_returns_min)


def _reaches_ceiling(counts: FloatArray, ceiling_m: float, window: BoolArray, is_before: bool) -> bool:
    """Whether a stretch of columns is wall all the way up.

    counts: (c, rows, 4). window: (c,) which columns may be a window's. is_before: whether it stands close before a known wall.
    """
    on, passed = rows_on_and_passed(counts, ceiling_m)
    seen = np.flatnonzero(on >= SCATTERED_RAYS)
    if not len(seen) or (FOOT_ROW + seen[-1] + 1) * CELL_M <= min(ceiling_m - _BELOW_CEILING_M, _ABOVE_HEADS_M):
        return False
    # A pillar shows from floor to ceiling; what else stands or hangs before a wall does not.
    if is_before and float(np.mean(on > passed)) <= _PILLAR_SHARE:
        return False
    # A duct's underside and the ceiling next to it are rows of returns, with nothing between them and the floor.
    below_sill = slice(0, cells_in(SILL_M) - FOOT_ROW)
    is_window = np.mean(window) > 0.5 and np.all(on[below_sill] >= passed[below_sill])
    return bool(is_window or np.count_nonzero(on > passed) > np.count_nonzero(passed > on))


def _undersides(votes: VoxelVotes) -> FloatArray:
    """(m, 3) the cubes that may be of a duct's underside: no wall's, higher than heads."""
    position = votes.mean_position[majority(votes.counts) != Label.WALL]
    return np.asarray(position[position[:, 2] > _UNDERSIDE_MIN_M])


def _duct_before(
    face: Walls, counts: FloatArray, walls: Walls, undersides: FloatArray
) -> tuple[int, float, float] | None:
    """The known face that hangs before a stretch as a duct's front, and from where to where; None where none does.

    A duct's underside joins the one to the other, as high as the wall was seen; a lintel's is no deeper than a wall is thick.

    face: of one stretch. counts: (c, rows, 4) of its columns. undersides: (m, 3), see `_undersides`.
    """
    own = next(segments(face))
    on, passed = rows_on_and_passed(counts, _UNDERSIDE_MIN_M)
    if own.length_m < _BELOW_DUCT_MIN_M or not np.all(on > passed):
        return None
    seen = np.flatnonzero(counts[..., FILLED].sum(axis=0) >= SCATTERED_RAYS)
    if not len(seen):
        return None
    undersides = undersides[np.abs(undersides[:, 2] - (seen[-1] + 1) * CELL_M) < _UNDERSIDE_NEAR_M]
    for w, front in enumerate(segments(walls)):
        depth_m = float(own.before_m(front.at(np.array([0.5 * front.length_m])))[0])
        if front.normal @ own.normal < SAME_WAY or not _DUCT_DEPTH_M[0] < depth_m < _DUCT_DEPTH_M[1]:
            continue
        if own.shared_m(walls.ends[w]) < _DUCT_SHARE * own.length_m:
            continue
        place_m, before_m = own.place_m(undersides), own.before_m(undersides)
        between = (place_m > 0) & (place_m < own.length_m) & (before_m > NOISE_M) & (before_m < depth_m)
        cells = np.stack([place_m[between], before_m[between]], axis=1) // _UNDERSIDE_CELL_M
        whole = own.length_m * (depth_m - NOISE_M) / _UNDERSIDE_CELL_M**2
        if len(np.unique(cells, axis=0)) >= _DUCT_SHARE * whole:
            low_m, high_m = np.sort(front.place_m(face.ends[0]))
            return w, max(float(low_m), 0.0), min(float(high_m), front.length_m)
    return None


def _cut_out(walls: Walls, ducts: list[tuple[int, float, float]], length_min_m: float) -> tuple[Walls, Walls]:
    """The faces without some stretches, each of a face and from where to where along it; and what was cut out of them.

    A rest that is too short for a face is cut with the stretch beside it.
    """
    rest, cut = walls.select(~np.isin(np.arange(len(walls)), [w for w, _, _ in ducts])), NO_WALLS
    for w in sorted({w for w, _, _ in ducts}):
        own, face = walls.select(np.array([w])), Segment.between(walls.ends[w], walls.normal[w])
        reached_m, cut_from_m = 0.0, 0.0
        taken = sorted((low_m, high_m) for front, low_m, high_m in ducts if front == w)
        for low_m, high_m in [*taken, (face.length_m, face.length_m)]:
            if low_m - reached_m >= length_min_m:
                rest = rest.append(_part(own, face, reached_m, low_m))
                if reached_m > cut_from_m:
                    cut = cut.append(_part(own, face, cut_from_m, reached_m))
                cut_from_m = low_m
            reached_m = max(reached_m, high_m)
        if reached_m > cut_from_m:
            cut = cut.append(_part(own, face, cut_from_m, reached_m))
    return rest, cut


def _part(own: Walls, face: Segment, low_m: float, high_m: float) -> Walls:
    """A stretch of a single face."""
    return replace(own, ends=face.at(np.array([low_m, high_m]))[None])


def _to_corners_m(face: Walls, walls: Walls) -> float:
    """By how much a single face is longer up to known faces that end at its ends: close to these its returns pass for theirs."""
    ends = walls.ends[np.abs(walls.normal @ face.normal[0]) < ACROSS].reshape(-1, 2)
    if not len(ends):
        return 0.0
    nearest_m = np.linalg.norm(face.ends[0][:, None] - ends, axis=2).min(axis=1)
    return float(nearest_m[nearest_m < _AT_CORNER_M].sum())


def _crossed_by(walls: Walls, candidates: Walls, w: int, count: int) -> BoolArray:
    """(count,) the columns of one candidate at which it crosses a known face: beyond it another wall goes on, or a reveal."""
    crossed = np.zeros(count, bool)
    candidate = Segment.between(candidates.ends[w], candidates.normal[w])
    for face in segments(walls):
        if abs(face.normal @ candidate.normal) > ACROSS:
            continue
        column = int(-face.before_m(candidate.start) / (candidate.along @ face.normal) // CELL_M)
        place = candidate.at(np.array([(column + 0.5) * CELL_M]))
        if 0 <= column < count and face.beside(place)[0]:
            crossed[column] = True
    return crossed


def _before_a_face(candidates: Walls, walls: Walls, before_m: float) -> BoolArray:
    """(k,) whether a known face that looks the same way lies so close behind each candidate, or before it."""
    before = np.zeros(len(candidates), bool)
    middle = candidates.ends.mean(axis=1)
    for face in segments(walls):
        same_way = candidates.normal @ face.normal > SAME_WAY
        before |= same_way & face.beside(middle) & (np.abs(face.before_m(middle)) < before_m)
    return before


def _faces_a_face(candidates: Walls, walls: Walls, apart_m: float) -> BoolArray:
    """(k,) whether a known face looks at each candidate from so near: nobody sees the one from before the other."""
    faces = np.zeros(len(candidates), bool)
    middle = candidates.ends.mean(axis=1)
    for face in segments(walls):
        distance_m = face.before_m(middle)
        opposite = candidates.normal @ face.normal < -SAME_WAY
        faces |= opposite & face.beside(middle) & (distance_m > 0) & (distance_m < apart_m)
    return faces


def _unexplained_columns(votes: VoxelVotes, walls: Walls, refused: Walls) -> tuple[FloatArray, FloatArray]:
    """Upright columns of cubes that no face explains: x and y (m, 2), and how many cubes stand in each (m,)."""
    label = majority(votes.counts)
    unexplained = ((label == Label.CLUTTER) | (label == Label.WALL)) & (votes.counts.max(axis=1, initial=0) > 0)
    position, count = votes.mean_position[unexplained], votes.point_count[unexplained]
    free = np.ones(len(position), bool)
    for faces in (walls, refused):
        for face in segments(faces):
            free &= ~((np.abs(face.before_m(position)) < _EXPLAINED_M) & face.beside(position, _EXPLAINED_M))
    position, count = position[free], count[free]
    cell = np.floor(position[:, :2] / CELL_M).astype(np.int64)
    _, column = np.unique(cell, axis=0, return_inverse=True)
    column = column.ravel()
    columns = int(column.max(initial=-1)) + 1
    weight = np.bincount(column, count, columns)
    place = np.stack([np.bincount(column, count * position[:, axis], columns) / weight for axis in (0, 1)], axis=1)
    cubes = np.bincount(column, minlength=columns)
    stands = cubes >= 3
    return place[stands], np.minimum(cubes[stands], 20).astype(np.float64)


def _straight_lines(
    place: FloatArray, weight: FloatArray, normals: FloatArray, settings: StandingWallsSettings
) -> list[tuple[FloatArray, FloatArray]]:
    """Stretches of columns in line, the strongest first, each column in one: ends (2, 2) and normal (2,)."""
    bin_m = 0.5 * settings.hidden_distance_m
    left = np.ones(len(place), bool)
    across = [place @ normal for normal in normals]
    along = [place @ np.array([-normal[1], normal[0]]) for normal in normals]
    bins = [np.floor((a - a.min(initial=0.0)) / bin_m).astype(np.int64) for a in across]
    dead = [np.zeros(int(b.max(initial=0)) + 3, bool) for b in bins]
    found: list[tuple[FloatArray, FloatArray]] = []
    while len(normals) and left.any():
        best, direction, at = 0.0, 0, 0
        for d in range(len(normals)):
            strength = np.bincount(bins[d][left], weight[left], len(dead[d]))
            strength = np.where(dead[d], 0.0, np.convolve(strength, np.ones(3), "same"))
            if strength.max() > best:
                best, direction, at = float(strength.max()), d, int(np.argmax(strength))
        if best < 9.0:
            break
        centre = float(across[direction].min(initial=0.0)) + (at + 0.5) * bin_m
        near = np.flatnonzero(left & (np.abs(across[direction] - centre) < settings.hidden_distance_m))
        near = near[np.argsort(along[direction][near])]
        breaks = np.flatnonzero(np.diff(along[direction][near]) > settings.hidden_gap_m) + 1
        parts = [p for p in np.split(near, breaks) if len(p) >= 3 and np.ptp(along[direction][p]) > 3 * CELL_M]
        if not parts:
            dead[direction][at] = True
            continue
        part = max(parts, key=lambda p: float(weight[p].sum()))
        left[part] = False
        normal = normals[direction]
        offset = float(np.average(across[direction][part], weights=weight[part]))
        reach = along[direction][part][[0, -1]] + np.array([-0.5, 0.5]) * CELL_M
        found.append((normal * offset + reach[:, None] * np.array([-normal[1], normal[0]]), normal))
    return found


def _pillar_sides(
    place: FloatArray, weight: FloatArray, walls: Walls, settings: StandingWallsSettings
) -> list[tuple[FloatArray, FloatArray]]:
    """The sides of what stands before a known face and is a known face itself: ends (2, 2) and normal (2,).

    A pillar's side is short, and most of it lies so close to either face that it passes for their own.

    place: (m, 2) of the columns, weight: (m,).
    """
    found: list[tuple[FloatArray, FloatArray]] = []
    faces = list(segments(walls))
    for back in faces:
        before_m, place_m = back.before_m(place), back.place_m(place)
        for front in faces:
            depth_m = float(back.before_m(front.at(np.array([0.5 * front.length_m])))[0])
            if front.normal @ back.normal < SAME_WAY or not NOISE_M < depth_m < FURNITURE_M:
                continue
            for end_m in back.place_m(front.at(np.array([0.0, front.length_m]))):
                near = (before_m > 0) & (before_m < depth_m) & (np.abs(place_m - end_m) < _AT_CORNER_M)
                if not 0 < end_m < back.length_m or not near.any():
                    continue
                off_m = np.abs(place_m[near][:, None] - place_m[near])
                strength = (off_m < settings.hidden_distance_m) @ weight[near]
                side = off_m[np.argmax(strength)] < settings.hidden_distance_m
                foot = back.at(np.array([np.average(place_m[near][side], weights=weight[near][side])]))[0]
                found.append((np.stack([foot, foot + depth_m * back.normal]), back.along))
    return found
