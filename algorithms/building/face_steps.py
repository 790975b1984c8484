"""Where a fused face steps: two parallel surfaces beside each other, which the planes of single scans spanned.

A wall is plane. A face fused of planes that ran from a wall on to the wardrobe beside it, or to a pilaster, lies askew
between the two. The columns of the face vote for pairs of parallel lines, one on either side of a place along it
(Hough, US patent 3,069,654; here in distances before the face).
"""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy import ndimage

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.model import cells_in


class FaceStepsSettings(StepSettings):
    """Cutting fused faces where they step."""

    step_min_m: float = Field(0.05, gt=0, description="Minimum distance (m) between the two parallel surfaces.")
    reach_m: float = Field(0.15, gt=0, description="Maximum distance (m) of either before or behind the fused face.")
    part_min_m: float = Field(0.3, gt=0, description="Minimum length (m) of each of the two.")
    share_min: float = Field(
        0.5,
        ge=0,
        le=1,
        description="Minimum share of the shorter part's columns that two lines explain and no single one does.",
    )
    returns_ratio_min: float = Field(
        0.3,
        ge=0,
        le=1,
        description="Minimum share of the returns above doors, per length, that the other part has: a pane has fewer.",
    )


@dataclass(frozen=True)
class FaceReturns:
    """What returned near a face, one row for each 5 cm cube of space.

    column: (n,) of the face, 5 cm each. before_m: (n,) distance before the face. above: (n,) whether higher than doors.
    count: (n,) how many returns.
    """

    column: IntArray
    before_m: FloatArray
    above: BoolArray
    count: FloatArray

    def between(self, first: int, last: int) -> "FaceReturns":
        """Those in the columns from `first` up to before `last`, which are counted from there."""
        inside = (self.column >= first) & (self.column < last)
        return FaceReturns(self.column[inside] - first, self.before_m[inside], self.above[inside], self.count[inside])


@dataclass(frozen=True)
class FacePart:
    """A plane part of a face: its columns, and (2,) how far before the face it lies at either end, metres."""

    first: int
    last: int
    ends_m: FloatArray


def parts_between_steps(
    columns: int, returns: FaceReturns, at_line_m: float, bin_m: float, settings: FaceStepsSettings
) -> list[FacePart]:
    """The plane parts of a face, in order along it; the whole where it does not step.

    columns: how many the face has. at_line_m: maximum distance of a return from a line that it votes for. bin_m: from one line
    that is tried to the next; both in metres.
    """
    step = _best_step(columns, returns, at_line_m, bin_m, settings)
    if step is None:
        return [FacePart(0, columns, np.zeros(2))]
    parts: list[FacePart] = []
    for own in step:
        within = returns.between(own.first, own.last)
        own_m = _along_m(own, np.arange(own.last - own.first) + 0.5)
        flat = replace(within, before_m=within.before_m - own_m[within.column])
        for part in parts_between_steps(own.last - own.first, flat, at_line_m, bin_m, settings):
            moved_m = _along_m(own, np.array([part.first, part.last], np.float64)) + part.ends_m
            parts.append(FacePart(own.first + part.first, own.first + part.last, moved_m))
    return parts


def _best_step(
    columns: int, returns: FaceReturns, at_line_m: float, bin_m: float, settings: FaceStepsSettings
) -> tuple[FacePart, FacePart] | None:
    """The two parts of the pair of parallel lines with most votes, if they bear out a step."""
    least = cells_in(settings.part_min_m)
    if columns < 2 * least:
        return None
    column, before_m = returns.column[returns.above], returns.before_m[returns.above]
    # Every column has one vote.
    weight = 1 / np.bincount(column, minlength=columns)[column]
    votes = votes_at_distances(columns, column, before_m, weight, 2 * settings.reach_m, bin_m, at_line_m)
    one, two, parts = _most_voted(votes, least, bin_m)
    shorter = min(part.last - part.first for part in parts)
    if abs(_apart_m(*parts)) < settings.step_min_m or two - one < settings.share_min * shorter:
        return None
    often: list[float] = []
    for part, other in (parts, parts[::-1]):
        within = returns.between(part.first, part.last)
        own_m = _along_m(part, within.column + 0.5)
        on, along_other = (
            np.abs(within.before_m - own_m - off_m) < at_line_m for off_m in (0.0, _apart_m(part, other))
        )
        # Below a duct the wall beside it goes on.
        if np.count_nonzero(on & ~within.above) <= np.count_nonzero(along_other & ~within.above):
            return None
        often.append(within.count[on & within.above].sum() / (part.last - part.first))
    # Of a pane, set back in its wall, only some rays return.
    return parts if min(often) > settings.returns_ratio_min * max(often) else None


def votes_at_distances(
    columns: int,
    column: IntArray,
    before_m: FloatArray,
    weight: FloatArray,
    reach_m: float,
    bin_m: float,
    at_line_m: float,
) -> FloatArray:
    """(c, 2k + 1) the weight (n,) of each column's returns near distances before the face from -reach_m to reach_m.

    bin_m: from one distance to the next. at_line_m: maximum distance of a return from one that it votes for.
    """
    half = round(reach_m / bin_m)
    at = np.round(before_m / bin_m).astype(np.int64) + half
    within = (at >= 0) & (at <= 2 * half)
    votes = np.zeros((columns, 2 * half + 1))
    np.add.at(votes, (column[within], at[within]), weight[within])
    window = np.ones(2 * int(at_line_m / bin_m) + 1)
    return np.asarray(ndimage.convolve1d(votes, window, axis=1, mode="constant"))


def line_m(share: FloatArray, ends_m: FloatArray) -> FloatArray:
    """(…, n) the distances of lines, given at their two ends (2, …), at shares (n,) of their length."""
    return np.asarray(ends_m[0] * (1 - share) + ends_m[1] * share)


def _most_voted(votes: FloatArray, least: int, bin_m: float) -> tuple[float, float, tuple[FacePart, FacePart]]:
    """The votes of the best single line, of the best pair, and its parts, each `least` columns or longer.

    votes: (c, b) of each column for the distances, twice as far as a line may lie in the middle of the face.
    """
    columns, bins = votes.shape
    half = bins // 4
    place = (np.arange(columns) + 0.5) / columns - 0.5
    one, two, best = 0.0, -1.0, (0, 0, 0, 0)
    cuts = np.arange(least, columns - least + 1)
    for turn in range(-2 * half, 2 * half + 1):
        # The line's bin at each column, for every bin that it may have in the middle.
        line = np.arange(half, bins - half) + np.round(turn * place).astype(np.int64)[:, None]
        sum_before = np.cumsum(np.take_along_axis(votes, line, axis=1), axis=0)
        before, after = sum_before[cuts - 1], sum_before[-1] - sum_before[cuts - 1]
        one = max(one, sum_before[-1].max())
        pair = before.max(axis=1) + after.max(axis=1)
        k = int(np.argmax(pair))
        if pair[k] > two:
            two, best = float(pair[k]), (turn, int(cuts[k]), int(before[k].argmax()), int(after[k].argmax()))
    turn, cut, left, right = best

    def part(first: int, last: int, middle: int) -> FacePart:
        ends = (middle - half) + turn * (np.array([first, last]) / columns - 0.5)
        return FacePart(first, last, ends * bin_m)

    return one, two, (part(0, cut, left), part(cut, columns, right))


def _apart_m(one: FacePart, other: FacePart) -> float:
    """How far the other of two parts beside each other lies before the first."""
    at_one, at_other = (1, 0) if one.first < other.first else (0, 1)
    return float(other.ends_m[at_other] - one.ends_m[at_one])


def _along_m(part: FacePart, column: FloatArray) -> FloatArray:
    """How far before the face the part lies, at places counted in columns from its first."""
    return line_m(column / (part.last - part.first), part.ends_m)
