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
from ffmap.algorithms.building.model import CELL_M, Walls


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
    extent_share_min: float = Field(
        0.75, ge=0, le=1, description="A wall shows over this share of the longest surface."
    )


_SHOWN_MIN = 0.2
"""Share of a column's returns from a surface that shows in it."""
_RIVAL_SHARE_MIN = 0.5
"""A surface that shows in this share of the columns of another may be the wall."""
_FITS = 6
"""Fits of a line by least squares, each to what is near the one before."""
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


def align_faces(walls: Walls, votes: VoxelVotes, settings: FaceAlignmentSettings) -> AlignedFaces:
    """Each face where its columns return from, if near enough to where it was; others as they were.

    Of several surfaces as long as it, it is laid along the one farthest back: what is before that,
    from panelling to a soffit, is fixed to a wall or stands against it.
    """
    cubes = _Cubes.of(votes)
    moved_m = np.zeros((len(walls), 2))
    for w, face in enumerate(segments(walls)):
        near = cubes.near(face, settings.reach_m + settings.kept_m, settings.end_m)
        moved_m[w] = _move_m(face, near, settings)
    return AlignedFaces(_moved(walls, moved_m), walls, moved_m)


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


def _move_m(face: Segment, cubes: _Cubes, settings: FaceAlignmentSettings) -> FloatArray:
    """(2,) distance that each end of the face is to move towards the room."""
    columns = int(np.ceil(face.length_m / CELL_M))
    column = (face.place_m(cubes.mean_map) / CELL_M).astype(np.int64)
    too_few = len(np.unique(column)) < _COLUMNS_MIN
    if too_few or np.ptp(column) < _SPREAD_SHARE_MIN * columns:
        return np.zeros(2)
    # Every column has one vote, however often it was seen.
    weight = cubes.returns / np.bincount(column, cubes.returns)[column]
    share, before_m = face.place_m(cubes.mean_map) / face.length_m, face.before_m(cubes.mean_map)
    move_m = np.full(2, _farthest_back_m(column, before_m, weight, columns, settings))
    for _ in range(_FITS):
        close = np.abs(before_m - line_m(share, move_m)) < settings.kept_m
        fitted_m = _least_squares_m(share[close], before_m[close], weight[close])
        if not np.all(np.abs(fitted_m) < settings.reach_m + settings.kept_m):
            return np.zeros(2)
        move_m = fitted_m
    return move_m


def _farthest_back_m(
    column: IntArray,
    before_m: FloatArray,
    weight: FloatArray,
    columns: int,
    settings: FaceAlignmentSettings,
) -> float:
    """Distance before the face of the surface farthest back, of those that are long.

    A leaf or a shelf may be broader than what is seen of its wall, but the wall shows on both sides
    of it. column, before_m, weight: of returns.
    """
    reach, kept = (round(m / settings.step_m) for m in (settings.reach_m, settings.kept_m))
    at_bin = np.round(before_m / settings.step_m).astype(np.int64) + reach + kept
    within = (at_bin >= 0) & (at_bin <= 2 * (reach + kept))
    votes = np.zeros((columns, 2 * (reach + kept) + 1))
    np.add.at(votes, (column[within], at_bin[within]), weight[within])
    window = np.ones(2 * int(settings.at_line_m / settings.step_m) + 1)
    votes = ndimage.convolve1d(votes, window, axis=1, mode="constant")
    shows = votes[:, kept : kept + 2 * reach + 1] > _SHOWN_MIN
    count = shows.sum(axis=0)
    extent = columns - shows.argmax(axis=0) - shows[::-1].argmax(axis=0)
    extent[count < _RIVAL_SHARE_MIN * count.max()] = 0
    is_long = extent >= settings.extent_share_min * extent.max()
    return float(settings.step_m * (np.flatnonzero(is_long)[0] - reach))


def line_m(share: FloatArray, ends_m: FloatArray) -> FloatArray:
    """(…, n) the distances of lines, given at their ends (2, …), at shares (n,) of their length."""
    return np.asarray(ends_m[0] * (1 - share) + ends_m[1] * share)


def _least_squares_m(share: FloatArray, before_m: FloatArray, weight: FloatArray) -> FloatArray:
    """(2,) the distances at the ends of the line that fits best; NaN where all lie in one place."""
    root = np.sqrt(weight)
    design = np.stack([1 - share, share], axis=1) * root[:, None]
    solution, _, rank, _ = np.linalg.lstsq(design, before_m * root, rcond=1e-6)
    return np.asarray(solution) if rank == 2 else np.full(2, np.nan)
