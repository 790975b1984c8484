"""Upright faces seen from above: positions along and before them, ray crossings, runs of flags."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np
from scipy.ndimage import gaussian_filter1d

from ffmap.algorithms.base.scan import BoolArray, FloatArray


class Faces(Protocol):
    """Walls, doors or windows: ends (k, 2, 2) x and y in metres, normal (k, 2) unit vectors."""

    @property
    def ends(self) -> FloatArray: ...

    @property
    def normal(self) -> FloatArray: ...


@dataclass(frozen=True)
class Segment:
    """One face.

    start: (2,) x and y of its first end. along, normal: (2,) unit vectors, towards the other end
    and to the side that it is seen from. length_m: its length.
    """

    start: FloatArray
    along: FloatArray
    normal: FloatArray
    length_m: float

    @classmethod
    def between(cls, ends: FloatArray, normal: FloatArray | None = None) -> "Segment":
        """From its ends (2, 2) and its normal (2,), by default to the left."""
        length_m = float(np.linalg.norm(ends[1] - ends[0]))
        along = (ends[1] - ends[0]) / max(length_m, 1e-9)
        normal = np.array([-along[1], along[0]]) if normal is None else normal
        return cls(ends[0], along, normal, length_m)

    def place_m(self, points: FloatArray) -> FloatArray:
        """(…,) positions of points (…, 2 or 3) along the face, from its first end."""
        return np.asarray((points[..., :2] - self.start) @ self.along)

    def before_m(self, points: FloatArray) -> FloatArray:
        """(…,) signed distances of points (…, 2 or 3) before the face; negative behind."""
        return np.asarray((points[..., :2] - self.start) @ self.normal)

    def at(self, place_m: FloatArray) -> FloatArray:
        """(k, 2) the points at these positions (k,) along the face."""
        return np.asarray(self.start + place_m[:, None] * self.along)

    def beside(self, points: FloatArray, margin_m: float = 0.0) -> BoolArray:
        """(…,) whether points project between the ends, or at most `margin_m` beyond them."""
        place_m = self.place_m(points)
        return np.asarray((place_m > -margin_m) & (place_m < self.length_m + margin_m))

    def shared_m(self, ends: FloatArray) -> float:
        """Overlap with the projection of a face with these ends (2, 2); negative: a distance."""
        low, high = np.sort(self.place_m(ends))
        return float(min(high, self.length_m) - max(low, 0.0))


ALONG_X, ALONG_Y, START, NORMAL_X, NORMAL_Y, OFFSET, LENGTH = range(7)
"""The columns of `lines_of`."""


def lines_of(faces: Faces) -> FloatArray:
    """(k, 7) for compiled code: direction, first end along it, normal, offset along it, length."""
    length = lengths_m(faces.ends)[:, None]
    along = (faces.ends[:, 1] - faces.ends[:, 0]) / np.maximum(length, 1e-9)
    axes = (along, faces.normal)
    start, offset = (np.sum(axis * faces.ends[:, 0], axis=1, keepdims=True) for axis in axes)
    columns = np.concatenate([along, start, faces.normal, offset, length], axis=1)
    return np.ascontiguousarray(columns, np.float64)


@numba.njit(cache=True, nogil=True, forceinline=True)
def before_line(lines: FloatArray, k: int, x: float, y: float) -> float:
    """Signed distance (m) of a point before the k-th face; negative behind it."""
    return float(lines[k, NORMAL_X] * x + lines[k, NORMAL_Y] * y - lines[k, OFFSET])


@numba.njit(cache=True, nogil=True, forceinline=True)
def along_line(lines: FloatArray, k: int, x: float, y: float) -> float:
    """Position (m) of a point along the k-th face, from its first end."""
    return float(lines[k, ALONG_X] * x + lines[k, ALONG_Y] * y - lines[k, START])


def along_lines_m(lines: FloatArray, places: FloatArray) -> FloatArray:
    """(n,) the same of points (n, 2), each along its own face (n, 7)."""
    return np.asarray((lines[:, [ALONG_X, ALONG_Y]] * places).sum(axis=1) - lines[:, START])


@numba.njit(cache=True, nogil=True, forceinline=True)
def crossing(
    lines: FloatArray,
    k: int,
    behind_m: float,
    x: float,
    y: float,
    origin: FloatArray,
    grazing_sine: float,
) -> tuple[float, float]:
    """Intersect a ray from origin to (x, y) with the k-th face moved back by `behind_m`.

    Returns the share of the ray's length, and the position along the face. NaN where the ray does
    not come from before the face, or meets it at an angle with a smaller sine than `grazing_sine`.
    """
    before = before_line(lines, k, origin[0], origin[1]) + behind_m
    approach = before - (before_line(lines, k, x, y) + behind_m)
    dx, dy = x - origin[0], y - origin[1]
    if before <= 0.0 or approach <= 0.0 or approach < grazing_sine * np.hypot(dx, dy):
        return np.nan, np.nan
    share = before / approach
    return share, along_line(lines, k, origin[0] + share * dx, origin[1] + share * dy)


def lengthened(ends: FloatArray, by_m: float) -> FloatArray:
    """(k, 2, 2) the same lines, longer by `by_m` at either end."""
    along = ends[:, 1] - ends[:, 0]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9) * by_m
    return np.asarray(np.stack([ends[:, 0] - along, ends[:, 1] + along], axis=1))


def moved(ends: FloatArray, normal: FloatArray, by_m: FloatArray) -> FloatArray:
    """(k, 2, 2) the same lines, each moved by `by_m` (k,) along its normal (k, 2)."""
    return np.asarray(ends + (by_m[:, None] * normal)[:, None])


def lengths_m(ends: FloatArray) -> FloatArray:
    """(k,) lengths of lines (k, 2, 2)."""
    return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))


def main_direction_deg(ends: FloatArray) -> float:
    """The commonest angle of lines (k, 2, 2) with the x axis, in [-45, 45); 0 without lines.

    Lines at right angles count as one direction, each by its length. The mode and not the mean: a
    wing at another angle does not turn it.
    """
    along = ends[:, 1] - ends[:, 0]
    length_m = lengths_m(ends)
    if not length_m.sum() > 0:
        return 0.0
    bin_deg, sigma_deg, askew_max_deg = 0.05, 1.0, 3.0
    angle_deg = np.degrees(np.arctan2(along[:, 1], along[:, 0])) % 90.0
    bins = round(90.0 / bin_deg)
    count = np.bincount((angle_deg / bin_deg).astype(int) % bins, length_m, bins)
    smooth = gaussian_filter1d(count, sigma_deg / bin_deg, mode="wrap")
    peak_deg = (int(np.argmax(smooth)) + 0.5) * bin_deg
    askew_deg = (angle_deg - peak_deg + 45.0) % 90.0 - 45.0
    near = np.abs(askew_deg) < askew_max_deg
    direction_deg = peak_deg + float(np.average(askew_deg[near], weights=length_m[near]))
    return (direction_deg + 45.0) % 90.0 - 45.0


def turned(places: FloatArray, by_deg: float) -> FloatArray:
    """Rotate points or directions (…, 2) about the origin, counter-clockwise."""
    c, s = np.cos(np.radians(by_deg)), np.sin(np.radians(by_deg))
    return np.asarray(places @ np.array([[c, s], [-s, c]]))


def segment(faces: Faces, k: int | np.intp) -> Segment:
    """The k-th of the faces."""
    return Segment.between(faces.ends[k], faces.normal[k])


def segments(faces: Faces) -> Iterator[Segment]:
    """Iterate over the faces."""
    for ends, normal in zip(faces.ends, faces.normal, strict=True):
        yield Segment.between(ends, normal)


def stretches(flags: BoolArray, bridge: int = 0) -> list[tuple[int, int]]:
    """First and last index, inclusive, of the runs of True; gaps of up to `bridge` are bridged."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    runs: list[tuple[int, int]] = []
    for first, after in edges.reshape(-1, 2).tolist():
        if runs and first - runs[-1][1] - 1 <= bridge:
            runs[-1] = (runs[-1][0], after - 1)
        else:
            runs.append((first, after - 1))
    return runs
