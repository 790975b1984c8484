"""Which emitter fired each point: from the cloud's ring field, its rows, or the elevation angles.

A pattern that does not repeat has none: what Livox numbers as lines looks everywhere. Slices of elevation stand in for them.

Drivers number rings upwards (Velodyne), downwards (Ouster) or in firing order; here ring 0 is always the lowest. The
model is made once, from clouds all over the bag, and serves every scan, so that rings do not change their numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numba
import numpy as np
from scipy.ndimage import gaussian_filter1d

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray

RingSource = Literal["field", "row", "column", "elevation", "bins"]

_MOST_RINGS = 512
_STANDARD_COUNTS = (8, 16, 32, 40, 64, 80, 128)
_BIN_DEG = 0.01
_SWAP_DEG = 0.2  # Neighbouring rings whose elevations differ by less may be out of order by noise alone
_FEW = 100  # So few returns cannot tell whether a number keeps its elevation
_SLICE_DEG = 0.45  # Of the lidars that are labelled, rings stand 0.3 to 1.6 degrees apart
_NEAR_M = 1.0  # Nearer returns are left out of the estimate: the emitters' offset from the origin turns their elevation


@dataclass(frozen=True, eq=False)
class RingModel:
    """How a point gets its ring.

    source: "field" (the cloud's own numbers), "row" or "column" of an organised cloud, "elevation" (clusters of the
        elevation angle), or "bins" (no clusters to be found, for no emitter keeps its elevation: slices of it).
    elevation_deg: (count,) float64, each ring's elevation, ascending; NaN where it returned nothing.
    lookup: (values,) uint16, from the field's value, the row or the column to the ring; empty for elevations.
    edge_tan: (count - 1,) float64, tangents of the elevations between the rings; empty but for elevations.
    """

    source: RingSource
    elevation_deg: FloatArray
    lookup: IntArray
    edge_tan: FloatArray

    @property
    def count(self) -> int:
        """How many rings there are."""
        return len(self.elevation_deg)

    def rings(self, points_sensor: FloatArray, number: IntArray | None) -> IntArray:
        """Ring (n,) uint16 of points (n, 3); `number` is the field's value, the row or the column of each."""
        if number is not None:
            return _looked_up(self.lookup, number)
        x, y, z = points_sensor.T.astype(np.float64)
        with np.errstate(divide="ignore"):  # on the spin axis
            rings: IntArray = np.searchsorted(self.edge_tan, z / np.hypot(x, y)).astype(np.uint16)
        return rings


@numba.njit(cache=True, nogil=True)
def _looked_up(lookup: IntArray, number: IntArray) -> IntArray:  # pragma: no cover
    """The entry (n,) of each number (n,), of one beyond either end the last entry there."""
    found = np.empty(len(number), lookup.dtype)
    for i in range(len(number)):
        found[i] = lookup[min(max(number[i], 0), len(lookup) - 1)]
    return found


@dataclass(frozen=True)
class RingSample:
    """One cloud to estimate the rings from: valid points (n, 3), their field values, rows and columns (n,)."""

    points_sensor: FloatArray
    field: IntArray | None
    row: IntArray
    column: IntArray
    shape: tuple[int, int]


def estimate_rings(samples: Sequence[RingSample]) -> RingModel:
    """The model that fits these clouds: the ring field if it is filled and each of its numbers keeps an elevation, rows or
    columns, else the elevations.
    """
    numbered = [s for s in samples if s.field is not None and _are_rings(s.field)]
    # One cloud in many may lack the field, or have it filled with anything.
    if 2 * len(numbered) > len(samples):
        elevation, far = _elevations(numbered)
        number = np.concatenate([s.field for s in numbered if s.field is not None])
        if np.count_nonzero(far) < _FEW or _is_constant(number[far], elevation[far]):
            return _by_number("field", _whole_count(int(number.max()) + 1), number[far], elevation[far])
    alike = _of_commonest_shape(samples)
    if 2 * len(alike) > len(samples) and 1 not in alike[0].shape:
        elevation, far = _elevations(alike)
        height, width = alike[0].shape
        places: list[tuple[RingSource, int, IntArray]] = [
            ("row", height, np.concatenate([s.row for s in alike])),
            ("column", width, np.concatenate([s.column for s in alike])),
        ]
        for source, count, number in places:
            if 1 < count <= _MOST_RINGS and _is_constant(number[far], elevation[far]):
                return _by_number(source, count, number[far], elevation[far])
    elevation, far = _elevations(samples)
    return _by_elevation(elevation[far])


def _are_rings(number: IntArray) -> bool:
    return bool(len(number)) and bool(number.min() >= 0) and bool(number.max() < _MOST_RINGS) and bool(number.max() > 0)


def _of_commonest_shape(samples: Sequence[RingSample]) -> list[RingSample]:
    shapes = [s.shape for s in samples]
    return [s for s in samples if s.shape == max(shapes, key=shapes.count)]


def _elevations(samples: Sequence[RingSample]) -> tuple[FloatArray, BoolArray]:
    """Elevation (n,) of each point in degrees, and whether (n,) it is far enough from the sensor for that to tell its ring."""
    points = np.concatenate([s.points_sensor for s in samples]) if samples else np.zeros((0, 3), np.float32)
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))).astype(np.float64)
    far = np.einsum("ij,ij->i", points, points) > _NEAR_M**2
    if np.count_nonzero(far) < 0.2 * len(points):
        far[:] = True
    return elevation, far


def _is_constant(number: IntArray, elevation: FloatArray) -> bool:
    """Whether points of one row (or column) lie at one elevation, compared with the whole cloud's spread."""
    if len(number) < _FEW:
        return False
    order = np.argsort(number, kind="stable")
    groups = np.split(elevation[order], np.flatnonzero(np.diff(number[order])) + 1)
    spread = [np.subtract(*np.percentile(group, [75, 25])) for group in groups if len(group) >= 5]
    return bool(spread) and float(np.median(spread)) < 0.2 * float(elevation.std())


def _whole_count(seen: int) -> int:
    """A sensor's number of rings: its topmost may have seen nothing."""
    return next((count for count in _STANDARD_COUNTS if 0.85 * count <= seen <= count), seen)


def _by_number(source: RingSource, count: int, number: IntArray, elevation: FloatArray) -> RingModel:
    median = np.full(count, np.nan)
    order = np.argsort(number, kind="stable")
    values, first = np.unique(number[order], return_index=True)
    for value, group in zip(values, np.split(elevation[order], first[1:]), strict=False):
        median[value] = np.median(group)
    known = np.flatnonzero(np.isfinite(median))
    steps = np.diff(median[known])
    if np.mean(steps > -_SWAP_DEG) > 0.9 if len(steps) else True:
        rank = np.arange(count)
    elif np.mean(steps < _SWAP_DEG) > 0.9:
        rank = np.arange(count)[::-1]
    else:
        filled = np.interp(np.arange(count), known, median[known])
        rank = np.argsort(np.argsort(filled, kind="stable"), kind="stable")
    ascending = np.full(count, np.nan)
    ascending[rank] = median
    return RingModel(source, ascending, rank.astype(np.uint16), np.zeros(0))


def _by_elevation(elevation: FloatArray) -> RingModel:
    """Rings as the peaks of the elevations' histogram, smoothed just enough for its peaks to stand apart."""
    best_share, best = 0.0, np.zeros(0)
    if len(elevation) >= 200:
        low = np.floor(elevation.min() / _BIN_DEG) * _BIN_DEG - 1.0
        bins = int((elevation.max() + 1.0 - low) / _BIN_DEG) + 1
        counts = np.bincount(((elevation - low) / _BIN_DEG).astype(np.int64), minlength=bins).astype(np.float64)
        for sigma_deg in (0.02, 0.04, 0.08, 0.15, 0.3):
            smooth = gaussian_filter1d(counts, sigma_deg / _BIN_DEG)
            peaks = _true_peaks(smooth)
            if not 1 < len(peaks) <= _MOST_RINGS:
                continue
            centres = low + (peaks + 0.5) * _BIN_DEG
            share = _share_near(elevation, centres)
            # A ring split in two costs its share of points, two rings taken for one cost both of theirs.
            if share > best_share:
                best_share, best = share, centres
    if best_share < 0.75:
        span = np.percentile(elevation, [0.5, 99.5]) if len(elevation) else np.array([-16.0, 16.0])
        best = np.linspace(span[0], span[1], max(round(np.ptp(span) / _SLICE_DEG), 2))
    edges = np.tan(np.radians((best[1:] + best[:-1]) / 2))
    return RingModel("bins" if best_share < 0.75 else "elevation", best, np.zeros(0, np.uint16), edges)


def _true_peaks(smooth: FloatArray) -> IntArray:
    """Peaks that are no ripple: a ring has some share of what its neighbours have."""
    from scipy.signal import find_peaks  # half a second to load, and few clouds need it

    peaks: IntArray = find_peaks(smooth)[0]
    if not len(peaks):
        return peaks
    heights = smooth[peaks]
    typical = float(np.percentile(heights, 75))
    kept: IntArray = find_peaks(smooth, prominence=max(0.02 * typical, 0.5 * float(heights.min())))[0]
    return kept


def on_rings(points_sensor: FloatArray, rings: RingModel) -> BoolArray:
    """Which (n,) of the points (n, 3) are within a quarter of the spacing of a ring."""
    x, y, z = points_sensor.T.astype(np.float64)
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    return _near(elevation, np.sort(rings.elevation_deg[np.isfinite(rings.elevation_deg)]))


def _share_near(elevation: FloatArray, centres: FloatArray) -> float:
    """The share of points within a quarter of the spacing of a centre; 0.5 would be chance."""
    return float(np.mean(_near(elevation, centres)))


def _near(elevation: FloatArray, centres: FloatArray) -> BoolArray:
    edges = (centres[1:] + centres[:-1]) / 2
    nearest = np.searchsorted(edges, elevation)
    gaps = np.diff(centres)
    spacing = np.minimum(np.append(gaps, gaps[-1]), np.append(gaps[0], gaps))
    return np.asarray(np.abs(elevation - centres[nearest]) < spacing[nearest] / 4)
