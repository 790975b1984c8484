"""Upright faces seen from above: where places lie along one, and how far before it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from algorithms.scan import BoolArray, FloatArray


class Faces(Protocol):
    """Walls, doors or windows: ends (k, 2, 2) x and y in metres, normal (k, 2) unit vectors."""

    @property
    def ends(self) -> FloatArray: ...

    @property
    def normal(self) -> FloatArray: ...


@dataclass(frozen=True)
class Segment:
    """One face.

    start: (2,) x and y of its first end. along, normal: (2,) unit vectors, towards its other end and to the side that it is
    seen from. length_m: how long it is.
    """

    start: FloatArray
    along: FloatArray
    normal: FloatArray
    length_m: float

    @classmethod
    def between(cls, ends: FloatArray, normal: FloatArray | None = None) -> "Segment":
        """From its ends (2, 2) and its normal (2,), which is to the left where none is given."""
        length_m = float(np.linalg.norm(ends[1] - ends[0]))
        along = (ends[1] - ends[0]) / max(length_m, 1e-9)
        return cls(ends[0], along, np.array([-along[1], along[0]]) if normal is None else normal, length_m)

    def place_m(self, points: FloatArray) -> FloatArray:
        """(…,) how far along it points (…, 2 or 3) lie from its first end."""
        return np.asarray((points[..., :2] - self.start) @ self.along)

    def before_m(self, points: FloatArray) -> FloatArray:
        """(…,) how far before it points (…, 2 or 3) lie; negative behind."""
        return np.asarray((points[..., :2] - self.start) @ self.normal)

    def at(self, place_m: FloatArray) -> FloatArray:
        """(k, 2) the points on it so far (k,) from its first end."""
        return np.asarray(self.start + place_m[:, None] * self.along)

    def beside(self, points: FloatArray, margin_m: float = 0.0) -> BoolArray:
        """(…,) whether points lie between its ends, or at most so far beyond them."""
        place_m = self.place_m(points)
        return np.asarray((place_m > -margin_m) & (place_m < self.length_m + margin_m))

    def shared_m(self, ends: FloatArray) -> float:
        """Over how much of it another face with these ends (2, 2) lies beside it; negative where they do not meet."""
        low, high = np.sort(self.place_m(ends))
        return float(min(high, self.length_m) - max(low, 0.0))


def lengths_m(ends: FloatArray) -> FloatArray:
    """(k,) how long faces, sills or other lines with these ends (k, 2, 2) are."""
    return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))


def segments(faces: Faces) -> Iterator[Segment]:
    """Each of the faces by itself."""
    for ends, normal in zip(faces.ends, faces.normal, strict=True):
        yield Segment.between(ends, normal)
