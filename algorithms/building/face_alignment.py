"""Fused wall faces laid along the returns of all scans.

A face that is fused from planes of scans is as true as these: over a long wall to millimetres, but of a pillar's side a scan
sees few lines, and its plane may be off by as much as these scatter over its length, or run from the pillar on to the wall
behind. Over all scans the cubes of space hold returns enough to say where the surface is: its columns vote for lines that
pass near both ends of the face (Hough, US patent 3,069,654; here in distances before the ends).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.building.face_columns import Storey, above_doors_m, column_places
from ffmap.algorithms.building.model import CELL_M, Walls
from ffmap.algorithms.building.ray_evidence import first_columns
from ffmap.algorithms.building.votes import VoxelVotes, majority

_REACH_M, _STEP_M = 0.05, 0.005
"""The ends of a face move at most so far, and are tried at such steps."""
_AT_LINE_M = 0.0125
"""What returns so close to a line is the line's."""
_KEPT_M = 0.02
"""What lies so close to the line found decides where it is in the end."""
_END_M = 0.03
"""Closer to its ends than this other faces return."""
_ABOVE_SHARE = 0.6
"""Where the wall above doors returned from so many of its columns, nothing below is asked: things stand there."""
_COLUMN_ON = 0.5
"""A column is a line's where such a share of what returned from it is."""
_RIVAL_SHARE, _AS_LONG_COLUMNS = 0.5, 1
"""A line with such a share of the most votes may be the wall's; one that is shorter by no more columns is as long."""
_ROUNDS = 3
"""So often what lies at the line is fitted anew."""
_FEWEST_COLUMNS, _SPREAD_SHARE = 3, 0.5
"""So many columns tell where a face lies, if they spread over such a share of it."""


@dataclass(frozen=True)
class AlignedFaces:
    """Faces laid along the returns.

    fused: where they were before. moved_m: (W, 2) how far each of their ends was moved, metres towards the room.
    """

    walls: Walls
    fused: Walls
    moved_m: FloatArray

    def append(self, more: "AlignedFaces") -> "AlignedFaces":
        """These faces and more."""
        moved_m = np.concatenate([self.moved_m, more.moved_m])
        return AlignedFaces(self.walls.append(more.walls), self.fused.append(more.fused), moved_m)


@dataclass(frozen=True)
class _Cubes:
    """Cubes that may be a wall's: mean_map (m, 3) where they returned from, returns (m,) how often; by increasing x."""

    mean_map: FloatArray
    returns: FloatArray

    @classmethod
    def of(cls, votes: VoxelVotes) -> "_Cubes":
        label = majority(votes.counts)
        mean_map = votes.mean_position
        chosen = np.flatnonzero((label != Label.FLOOR) & (label != Label.CEILING))
        chosen = chosen[np.argsort(mean_map[chosen, 0], kind="stable")]
        return cls(mean_map[chosen], votes.point_count[chosen].astype(np.float64))

    def near(self, face: Segment, margin_m: float) -> "_Cubes":
        """Those between the face's ends and so close to it."""
        x = np.sort([face.start[0], face.start[0] + face.length_m * face.along[0]])
        first, after = np.searchsorted(self.mean_map[:, 0], [x[0] - margin_m, x[1] + margin_m])
        part = self.select(np.arange(first, after))
        beside = (np.abs(face.before_m(part.mean_map)) < margin_m) & face.beside(part.mean_map, -_END_M)
        return part.select(beside)

    def select(self, chosen: BoolArray | np.ndarray) -> "_Cubes":
        return _Cubes(self.mean_map[chosen], self.returns[chosen])


def align_faces(
    walls: Walls, votes: VoxelVotes, storey: Storey, above_door_m: float, ceiling_near_m: float
) -> AlignedFaces:
    """Each face where its columns return from, if that is at most 7 cm from where it was; others as they were.

    That is where most of them do; of a face that does not show above doors, where the longest surface does.

    votes: of the labels that scans gave; storey: the floor and the ceiling among them. above_door_m: higher than leaves and
    cupboards. ceiling_near_m: how near a face's ceiling is looked for.
    """
    cubes = _Cubes.of(votes)
    ends, normal, moved_m = walls.ends.copy(), walls.normal.copy(), np.zeros((len(walls), 2))
    first = first_columns(walls)
    places = column_places(walls, first)
    above_m = storey.ground_m(places) + above_doors_m(storey.clear_m(places, ceiling_near_m), above_door_m)
    for w, face in enumerate(segments(walls)):
        moved_m[w] = _move_m(face, cubes.near(face, _REACH_M + _KEPT_M), above_m[first[w] : first[w + 1]])
        if moved_m[w].any():
            ends[w] += moved_m[w, :, None] * face.normal
            left = Segment.between(ends[w]).normal
            normal[w] = left if left @ face.normal > 0 else -left
    return AlignedFaces(replace(walls, ends=ends, normal=normal), walls, moved_m)


def _move_m(face: Segment, cubes: _Cubes, above_m: FloatArray) -> FloatArray:
    """(2,) how far each end of the face is to move towards the room; above_m: (c,) where in each column walls alone stand."""
    columns = len(above_m)
    column = (face.place_m(cubes.mean_map) / CELL_M).astype(np.int64)
    above = cubes.mean_map[:, 2] > above_m[column]
    shows_above = len(np.unique(column[above])) > _ABOVE_SHARE * columns
    if shows_above:
        cubes, column = cubes.select(above), column[above]
    if len(np.unique(column)) < _FEWEST_COLUMNS or np.ptp(column) < _SPREAD_SHARE * columns:
        return np.zeros(2)
    # Every column has one vote, however often it was seen.
    weight = cubes.returns / np.bincount(column, cubes.returns)[column]
    share, before_m = face.place_m(cubes.mean_map) / face.length_m, face.before_m(cubes.mean_map)
    move_m = _most_voted_m(column, before_m, weight, columns, longest_first=not shows_above)
    for _ in range(_ROUNDS):
        own = np.abs(before_m - _line_m(share, move_m)) < _KEPT_M
        fitted_m = _least_squares_m(share[own], before_m[own], weight[own])
        if not np.all(np.abs(fitted_m) < _REACH_M + _KEPT_M):
            return np.zeros(2)
        move_m = fitted_m
    return move_m


def _most_voted_m(
    column: np.ndarray, before_m: FloatArray, weight: FloatArray, columns: int, longest_first: bool
) -> FloatArray:
    """(2,) the distances before the face's ends between which the line runs that most columns return from.

    longest_first: of the lines with half as many votes the longest; of equally long ones that with most.
    """
    tried_m = np.arange(-_REACH_M, _REACH_M + _STEP_M / 2, _STEP_M)
    low_m = -_REACH_M - _KEPT_M - _STEP_M / 2
    bins = round(-2 * low_m / _STEP_M)
    histogram = np.zeros((columns, bins))
    np.add.at(histogram, (column, np.clip(((before_m - low_m) / _STEP_M).astype(np.int64), 0, bins - 1)), weight)
    window = np.ones(2 * int(_AT_LINE_M / _STEP_M) + 1)
    histogram = ndimage.convolve1d(histogram, window, axis=1, mode="constant")
    share = (np.arange(columns) + 0.5) / columns
    at_start, at_end = (axis.ravel() for axis in np.meshgrid(tried_m, tried_m, indexing="ij"))
    lines_m = _line_m(share, np.array([at_start[:, None], at_end[:, None]]))
    of_columns = histogram[np.arange(columns), ((lines_m - low_m) / _STEP_M).astype(np.int64)]
    votes = of_columns.sum(axis=1)
    longest = np.ones(len(votes), bool)
    if longest_first:
        # A leaf may be broader than what is seen of its wall, and so may a shelf: the wall shows on both sides of either.
        on = of_columns > _COLUMN_ON
        extent = np.where(on.any(axis=1), columns - on.argmax(axis=1) - on[:, ::-1].argmax(axis=1), 0)
        extent[votes < _RIVAL_SHARE * votes.max()] = 0
        longest = extent >= extent.max() - _AS_LONG_COLUMNS
    # Of lines with as many votes the one that is nearest to the face.
    best = np.lexsort((np.abs(at_start) + np.abs(at_end), -votes.round(6), ~longest))[0]
    return np.array([at_start[best], at_end[best]])


def _line_m(share: FloatArray, ends_m: FloatArray) -> FloatArray:
    """(…, n) the distances of lines between their two ends' (2, …), at shares (n,) of their length."""
    return np.asarray(ends_m[0] * (1 - share) + ends_m[1] * share)


def _least_squares_m(share: FloatArray, before_m: FloatArray, weight: FloatArray) -> FloatArray:
    """(2,) the distances at the ends of the line that fits best; NaN where all lie at one place."""
    root = np.sqrt(weight)
    design = np.stack([1 - share, share], axis=1) * root[:, None]
    solution, _, rank, _ = np.linalg.lstsq(design, before_m * root, rcond=1e-6)
    return np.asarray(solution) if rank == 2 else np.full(2, np.nan)
