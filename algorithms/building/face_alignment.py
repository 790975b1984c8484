"""Fused wall faces laid along the returns of all scans.

Of a short face, as a pillar's side, a scan sees few lines, and its plane may be off by their scatter. Over all scans the cubes
of space hold enough returns to say where the surface is: its columns vote for lines that pass near both ends of the face
(Hough, US patent 3,069,654; here in distances before the ends).
"""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.evidence import first_columns
from ffmap.algorithms.building.face_columns import Storey, above_doors_m, column_places
from ffmap.algorithms.building.face_steps import (
    FaceReturns,
    FaceStepsSettings,
    line_m,
    parts_between_steps,
    votes_at_distances,
)
from ffmap.algorithms.building.face_verdicts import StandingWallsSettings
from ffmap.algorithms.building.model import CELL_M, Walls
from ffmap.algorithms.building.votes import VoxelVotes


class FaceAlignmentSettings(StepSettings):
    """Moving wall faces to where most of their columns return from."""

    reach_m: float = Field(0.05, gt=0, description="Maximum distance (m) that the ends of a face are tried to move.")
    step_m: float = Field(0.005, gt=0, description="Step (m) in which they are tried.")
    at_line_m: float = Field(0.0125, gt=0, description="Maximum distance (m) of a return from a line it votes for.")
    kept_m: float = Field(0.02, gt=0, description="Maximum distance (m) from that line of what it is fitted to.")
    end_m: float = Field(0.03, ge=0, description="Distance (m) from a face's ends within which other faces return.")
    above_share_min: float = Field(
        0.6,
        ge=0,
        le=1,
        description="Where the wall above doors returned from more than this share of a face's columns, nothing below "
        "counts: furniture stands there.",
    )
    rival_share_min: float = Field(
        0.5, ge=0, le=1, description="A line with this share of the most votes may be the wall."
    )
    columns_min: int = Field(3, ge=2, description="Minimum number of columns that tell where a face lies.")
    spread_share_min: float = Field(
        0.5, ge=0, le=1, description="Minimum share of a face that the columns that tell where it lies spread over."
    )


@dataclass(frozen=True)
class AlignedFaces:
    """Faces laid along the returns.

    fused: where they were before. moved_m: (W, 2) distance that each end was moved towards the room, metres. cut: (W,) whether
    it is a part of a fused face that was cut where it steps.
    """

    walls: Walls
    fused: Walls
    moved_m: FloatArray
    cut: BoolArray

    def append(self, more: "AlignedFaces") -> "AlignedFaces":
        """These faces and more."""
        moved_m, cut = np.concatenate([self.moved_m, more.moved_m]), np.concatenate([self.cut, more.cut])
        return AlignedFaces(self.walls.append(more.walls), self.fused.append(more.fused), moved_m, cut)


@dataclass(frozen=True)
class _Cubes:
    """Cubes that may be a wall's, by increasing x: mean_map (m, 3) of their returns, returns (m,) their number."""

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
        beside = (np.abs(face.before_m(part.mean_map)) < margin_m) & face.beside(part.mean_map, -end_m)
        return part.select(beside)

    def select(self, chosen: BoolArray | np.ndarray) -> "_Cubes":
        return _Cubes(self.mean_map[chosen], self.returns[chosen])


def align_faces(
    walls: Walls,
    votes: VoxelVotes,
    storey: Storey,
    standing: StandingWallsSettings,
    settings: FaceAlignmentSettings,
    steps: FaceStepsSettings,
) -> AlignedFaces:
    """Each face where its columns return from, if that is near enough to where it was; others as they were.

    That is where most of them do; of a face that does not show above doors, where the longest surface does. A face that
    steps is cut there first, and each part starts on its own surface.
    """
    cubes = _Cubes.of(votes)
    above_m = _above_doors_m(walls, storey, standing)
    fused, moved_m, cut = _cut_at_steps(walls, cubes, above_m, settings, steps)
    walls = _moved(fused, moved_m)
    if cut.any():
        above_m = _above_doors_m(walls, storey, standing)
    first = first_columns(walls)
    more_m = np.zeros((len(walls), 2))
    for w, face in enumerate(segments(walls)):
        near = cubes.near(face, settings.reach_m + settings.kept_m, settings.end_m)
        more_m[w] = _move_m(face, near, above_m[first[w] : first[w + 1]], settings)
    return AlignedFaces(_moved(walls, more_m), fused, moved_m + more_m, cut)


def _above_doors_m(walls: Walls, storey: Storey, standing: StandingWallsSettings) -> FloatArray:
    """(c,) map z above which walls alone stand, in each column of all faces."""
    places = column_places(walls, first_columns(walls))
    clear_m = storey.clear_m(places, standing.ceiling_near_m)
    return storey.ground_m(places) + above_doors_m(clear_m, standing.above_door_m)


def _moved(walls: Walls, moved_m: FloatArray) -> Walls:
    """The faces with their ends (W, 2) moved towards the room; those that stay keep their normals to the bit."""
    ends, normal = walls.ends + moved_m[..., None] * walls.normal[:, None], walls.normal.copy()
    for w in np.flatnonzero(moved_m.any(axis=1)):
        left = Segment.between(ends[w]).normal
        normal[w] = left if left @ walls.normal[w] > 0 else -left
    return replace(walls, ends=ends, normal=normal)


def _cut_at_steps(
    walls: Walls, cubes: _Cubes, above_m: FloatArray, settings: FaceAlignmentSettings, steps: FaceStepsSettings
) -> tuple[Walls, FloatArray, BoolArray]:
    """The faces cut where they step, still in their places, and (W, 2) the distances that their surfaces lie before them.

    Last, (W,) which are parts of one that was cut.
    """
    first = first_columns(walls)
    face_of: list[int] = []
    cut: list[bool] = []
    ends: list[FloatArray] = []
    before_m: list[FloatArray] = []
    for w, face in enumerate(segments(walls)):
        near = cubes.near(face, steps.reach_m, settings.end_m)
        column = (face.place_m(near.mean_map) / CELL_M).astype(np.int64)
        above = near.mean_map[:, 2] > above_m[first[w] : first[w + 1]][column]
        returns = FaceReturns(column, face.before_m(near.mean_map), above, near.returns)
        columns = int(first[w + 1] - first[w])
        for part in parts_between_steps(columns, returns, settings.at_line_m, settings.step_m, steps):
            cut.append(part.last - part.first < columns)
            place_m = np.minimum(np.array([part.first, part.last]) * CELL_M, face.length_m)
            face_of.append(w)
            ends.append(face.at(place_m) if cut[-1] else walls.ends[w])
            before_m.append(part.ends_m)
    if not any(cut):
        return walls, np.zeros((len(walls), 2)), np.zeros(len(walls), bool)
    return replace(walls.select(np.array(face_of)), ends=np.array(ends)), np.array(before_m), np.array(cut)


def _move_m(face: Segment, cubes: _Cubes, above_m: FloatArray, settings: FaceAlignmentSettings) -> FloatArray:
    """(2,) distance that each end of the face is to move towards the room.

    above_m: (c,) map z above which walls alone stand in each column.
    """
    columns = len(above_m)
    column = (face.place_m(cubes.mean_map) / CELL_M).astype(np.int64)
    above = cubes.mean_map[:, 2] > above_m[column]
    shows_above = len(np.unique(column[above])) > settings.above_share_min * columns
    if shows_above:
        cubes, column = cubes.select(above), column[above]
    if len(np.unique(column)) < settings.columns_min or np.ptp(column) < settings.spread_share_min * columns:
        return np.zeros(2)
    # Every column has one vote, however often it was seen.
    weight = cubes.returns / np.bincount(column, cubes.returns)[column]
    share, before_m = face.place_m(cubes.mean_map) / face.length_m, face.before_m(cubes.mean_map)
    votes = _line_votes(column, before_m, weight, columns, settings)
    move_m = votes.most_voted_m() if shows_above else votes.longest_m(settings.rival_share_min)
    for _ in range(3):
        close = np.abs(before_m - line_m(share, move_m)) < settings.kept_m
        fitted_m = _least_squares_m(share[close], before_m[close], weight[close])
        if not np.all(np.abs(fitted_m) < settings.reach_m + settings.kept_m):
            return np.zeros(2)
        move_m = fitted_m
    return move_m


@dataclass(frozen=True)
class _LineVotes:
    """The lines that were tried: ends_m (k, 2) their distances before the face's ends, of_columns (k, c) each column's votes."""

    ends_m: FloatArray
    of_columns: FloatArray

    def most_voted_m(self, among: BoolArray | None = None) -> FloatArray:
        """(2,) the line with most votes, of those with equal votes the nearest to the face; among: (k,) which may be it."""
        votes = self.of_columns.sum(axis=1)
        excluded = np.zeros(len(votes), bool) if among is None else ~among
        return np.asarray(self.ends_m[np.lexsort((np.abs(self.ends_m).sum(axis=1), -votes.round(6), excluded))[0]])

    def longest_m(self, share_min: float) -> FloatArray:
        """(2,) the longest line of those with this share of the most votes; of equally long ones that with most.

        A leaf or a shelf may be broader than what is seen of its wall, but the wall shows on both sides of it.
        """
        votes, columns = self.of_columns.sum(axis=1), self.of_columns.shape[1]
        on = self.of_columns > 0.5
        extent = np.where(on.any(axis=1), columns - on.argmax(axis=1) - on[:, ::-1].argmax(axis=1), 0)
        extent[votes < share_min * votes.max()] = 0
        return self.most_voted_m(extent >= extent.max() - 1)


def _line_votes(
    column: np.ndarray, before_m: FloatArray, weight: FloatArray, columns: int, settings: FaceAlignmentSettings
) -> _LineVotes:
    """The votes of returns, each in a column and at a distance before the face, for the lines between its ends."""
    reach_m, step_m, wide_m = settings.reach_m, settings.step_m, settings.reach_m + settings.kept_m
    tried_m = np.arange(-reach_m, reach_m + step_m / 2, step_m)
    votes = votes_at_distances(columns, column, before_m, weight, wide_m, step_m, settings.at_line_m)
    ends_m = np.stack(np.meshgrid(tried_m, tried_m, indexing="ij"), axis=-1).reshape(-1, 2)
    lines_m = line_m((np.arange(columns) + 0.5) / columns, ends_m.T[..., None])
    at = np.round(lines_m / step_m).astype(np.int64) + votes.shape[1] // 2
    return _LineVotes(ends_m, votes[np.arange(columns), at])


def _least_squares_m(share: FloatArray, before_m: FloatArray, weight: FloatArray) -> FloatArray:
    """(2,) the distances at the ends of the line that fits best; NaN where all lie in one place."""
    root = np.sqrt(weight)
    design = np.stack([1 - share, share], axis=1) * root[:, None]
    solution, _, rank, _ = np.linalg.lstsq(design, before_m * root, rcond=1e-6)
    return np.asarray(solution) if rank == 2 else np.full(2, np.nan)
