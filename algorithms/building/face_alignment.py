"""Fused wall faces laid along the returns of all scans.

Of a short face, as a pillar's side, a scan sees few lines, and its plane may be off by their
scatter. Over all scans the voxels hold enough returns to say where the surface is: its columns vote
for lines that pass near both ends of the face (Hough, US patent 3,069,654; here in distances before
the ends).
"""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.evidence import first_columns
from ffmap.algorithms.building.model import CELL_M, Walls
from ffmap.algorithms.building.storey import (
    CEILING_NEAR_M,
    Storey,
    above_doors_m,
    column_places,
)


class FaceAlignmentSettings(StepSettings):
    """Moving wall faces to where most of their columns return from."""

    reach_m: float = Field(
        0.05, gt=0, description="Maximum distance (m) that the ends of a face are tried to move."
    )
    step_m: float = Field(0.005, gt=0, description="Step (m) in which they are tried.")
    at_line_m: float = Field(
        0.0125, gt=0, description="Maximum distance (m) of a return from a line it votes for."
    )
    kept_m: float = Field(
        0.02, gt=0, description="Maximum distance (m) from that line of what it is fitted to."
    )
    end_m: float = Field(
        0.03, ge=0, description="Distance (m) from a face's ends within which other faces return."
    )
    above_share_min: float = Field(
        0.6,
        ge=0,
        le=1,
        description="Where the wall above doors returned from more than this share of a face's "
        "columns, nothing below counts: furniture stands there.",
    )


_RIVAL_SHARE_MIN = 0.5
"""A line with this share of the most votes may be the wall."""
_COLUMNS_MIN, _SPREAD_SHARE_MIN = 3, 0.5
"""Least number of columns that tell where a face lies, and share of it that they spread over."""


@dataclass(frozen=True)
class AlignedFaces:
    """Faces laid along the returns.

    fused: where they were before. moved_m: (W, 2) distance (m) that each end was moved towards the
    room.
    """

    walls: Walls
    fused: Walls
    moved_m: FloatArray


@dataclass(frozen=True)
class _Cubes:
    """Voxels that may be a wall's, by increasing x.

    mean_map: (m, 3) of their returns. returns: (m,) their number.
    """

    mean_map: FloatArray
    returns: FloatArray

    @classmethod
    def of(cls, votes: VoxelVotes) -> "_Cubes":
        label = votes.label
        mean_map = votes.mean_position
        chosen = np.flatnonzero((label != Label.FLOOR) & (label != Label.CEILING))
        chosen = chosen[np.argsort(mean_map[chosen, 0], kind="stable")]
        return cls(mean_map[chosen], votes.point_count[chosen].astype(np.float64))

    def near(self, face: Segment, margin_m: float, end_m: float) -> "_Cubes":
        """Those closer to the face than `margin_m`, between its ends and not close to these."""
        x = np.sort([face.start[0], face.start[0] + face.length_m * face.along[0]])
        first, after = np.searchsorted(self.mean_map[:, 0], [x[0] - margin_m, x[1] + margin_m])
        part = self.select(np.arange(first, after))
        beside = face.beside(part.mean_map, -end_m)
        return part.select(beside & (np.abs(face.before_m(part.mean_map)) < margin_m))

    def select(self, chosen: BoolArray | IntArray) -> "_Cubes":
        return _Cubes(self.mean_map[chosen], self.returns[chosen])


def align_faces(
    walls: Walls, votes: VoxelVotes, storey: Storey, settings: FaceAlignmentSettings
) -> AlignedFaces:
    """Each face where its columns return from, if near enough to where it was; others as they were.

    That is where most of them do; of a face that does not show above doors, where the longest
    surface does.
    """
    cubes = _Cubes.of(votes)
    above_m = _above_doors_m(walls, storey)
    first = first_columns(walls)
    moved_m = np.zeros((len(walls), 2))
    for w, face in enumerate(segments(walls)):
        near = cubes.near(face, settings.reach_m + settings.kept_m, settings.end_m)
        moved_m[w] = _move_m(face, near, above_m[first[w] : first[w + 1]], settings)
    return AlignedFaces(_moved(walls, moved_m), walls, moved_m)


def _above_doors_m(walls: Walls, storey: Storey) -> FloatArray:
    """(c,) map z above which walls alone stand, in each column of all faces."""
    places = column_places(walls, first_columns(walls))
    return storey.ground_m(places) + above_doors_m(storey.clear_m(places, CEILING_NEAR_M))


def _moved(walls: Walls, moved_m: FloatArray) -> Walls:
    """The faces with their ends (W, 2) moved towards the room.

    Those that stay keep their normals to the bit.
    """
    ends = walls.ends + moved_m[..., None] * walls.normal[:, None]
    normal = walls.normal.copy()
    for w in np.flatnonzero(moved_m.any(axis=1)):
        left = Segment.between(ends[w]).normal
        normal[w] = left if left @ walls.normal[w] > 0 else -left
    return replace(walls, ends=ends, normal=normal)


def _move_m(
    face: Segment, cubes: _Cubes, above_m: FloatArray, settings: FaceAlignmentSettings
) -> FloatArray:
    """(2,) distance that each end of the face is to move towards the room.

    above_m: (c,) map z above which walls alone stand in each column.
    """
    columns = len(above_m)
    column = (face.place_m(cubes.mean_map) / CELL_M).astype(np.int64)
    above = cubes.mean_map[:, 2] > above_m[column]
    shows_above = len(np.unique(column[above])) > settings.above_share_min * columns
    if shows_above:
        cubes, column = cubes.select(above), column[above]
    too_few = len(np.unique(column)) < _COLUMNS_MIN
    if too_few or np.ptp(column) < _SPREAD_SHARE_MIN * columns:
        return np.zeros(2)
    # Every column has one vote, however often it was seen.
    weight = cubes.returns / np.bincount(column, cubes.returns)[column]
    share, before_m = face.place_m(cubes.mean_map) / face.length_m, face.before_m(cubes.mean_map)
    votes = _line_votes(column, before_m, weight, columns, settings)
    move_m = votes.most_voted_m() if shows_above else votes.longest_m(_RIVAL_SHARE_MIN)
    for _ in range(3):
        close = np.abs(before_m - line_m(share, move_m)) < settings.kept_m
        fitted_m = _least_squares_m(share[close], before_m[close], weight[close])
        if not np.all(np.abs(fitted_m) < settings.reach_m + settings.kept_m):
            return np.zeros(2)
        move_m = fitted_m
    return move_m


@dataclass(frozen=True)
class _LineVotes:
    """The lines that were tried.

    ends_m: (k, 2) their distances before the face's ends. of_columns: (k, c) each column's votes.
    """

    ends_m: FloatArray
    of_columns: FloatArray

    def most_voted_m(self, among: BoolArray | None = None) -> FloatArray:
        """(2,) the line with most votes, of equals the nearest to the face.

        among: (k,) which may be it.
        """
        votes, off_m = self.of_columns.sum(axis=1), np.abs(self.ends_m).sum(axis=1)
        excluded = np.zeros(len(votes), bool) if among is None else ~among
        return np.asarray(self.ends_m[np.lexsort((off_m, -votes.round(6), excluded))[0]])

    def longest_m(self, share_min: float) -> FloatArray:
        """(2,) the longest line of those with this share of the most votes.

        A leaf or a shelf may be broader than what is seen of its wall, but the wall shows on both
        sides of it.
        """
        votes, columns = self.of_columns.sum(axis=1), self.of_columns.shape[1]
        on = self.of_columns > 0.5
        extent = columns - on.argmax(axis=1) - on[:, ::-1].argmax(axis=1)
        extent[~on.any(axis=1)] = 0
        extent[votes < share_min * votes.max()] = 0
        return self.most_voted_m(extent >= extent.max() - 1)


def _line_votes(
    column: IntArray,
    before_m: FloatArray,
    weight: FloatArray,
    columns: int,
    settings: FaceAlignmentSettings,
) -> _LineVotes:
    """The votes of returns in columns, at distances before a face, for lines between its ends."""
    reach_m, step_m = settings.reach_m, settings.step_m
    tried_m = np.arange(-reach_m, reach_m + step_m / 2, step_m)
    half = round((reach_m + settings.kept_m) / step_m)
    at_bin = np.round(before_m / step_m).astype(np.int64) + half
    within = (at_bin >= 0) & (at_bin <= 2 * half)
    votes = np.zeros((columns, 2 * half + 1))
    np.add.at(votes, (column[within], at_bin[within]), weight[within])
    window = np.ones(2 * int(settings.at_line_m / step_m) + 1)
    votes = ndimage.convolve1d(votes, window, axis=1, mode="constant")
    ends_m = np.stack(np.meshgrid(tried_m, tried_m, indexing="ij"), axis=-1).reshape(-1, 2)
    lines_m = line_m((np.arange(columns) + 0.5) / columns, ends_m.T[..., None])
    at = np.round(lines_m / step_m).astype(np.int64) + votes.shape[1] // 2
    return _LineVotes(ends_m, votes[np.arange(columns), at])


def line_m(share: FloatArray, ends_m: FloatArray) -> FloatArray:
    """(…, n) the distances of lines, given at their ends (2, …), at shares (n,) of their length."""
    return np.asarray(ends_m[0] * (1 - share) + ends_m[1] * share)


def _least_squares_m(share: FloatArray, before_m: FloatArray, weight: FloatArray) -> FloatArray:
    """(2,) the distances at the ends of the line that fits best; NaN where all lie in one place."""
    root = np.sqrt(weight)
    design = np.stack([1 - share, share], axis=1) * root[:, None]
    solution, _, rank, _ = np.linalg.lstsq(design, before_m * root, rcond=1e-6)
    return np.asarray(solution) if rank == 2 else np.full(2, np.nan)
