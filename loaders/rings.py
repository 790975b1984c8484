"""Which emitter fired each point: from the ring field, rows or columns, or the elevation angles.

A pattern that does not repeat has no rings (Livox's lines look everywhere): slices of elevation
replace them. Drivers number rings upwards (Velodyne), downwards (Ouster) or in firing order; here
ring 0 is the lowest. The model is estimated once, so that rings keep their numbers in every scan.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray

RingSource = Literal["field", "row", "column", "elevation", "bins"]

_RINGS_MAX = 512
_STANDARD_COUNTS = (8, 16, 32, 40, 64, 80, 128)
_BIN_DEG = 0.01
_SWAP_DEG = 0.2  # Noise alone may swap neighbouring rings whose elevations differ by less
_FEW = 100  # So few returns do not show whether a number keeps its elevation
_SLICE_DEG = 0.45  # The spacing of rings is 0.3 to 1.6 degrees
_NEAR_M = 1.0  # The emitters' offset from the origin changes the elevation of nearer returns
_RINGED_SHARE_MIN = 0.75  # Of returns near a ring; by chance it is a half


@dataclass(frozen=True, eq=False)
class RingModel:
    """How a point gets its ring.

    source: "field" (the cloud's own numbers), "row" or "column" of an organised cloud, "elevation"
        (clusters of elevation angles), or "bins" (slices of elevation; there are no clusters).
    elevation_deg: (count,) float64, ascending; NaN of rings without returns.
    lookup: (values,) uint16, the ring of each field value, row or column; empty for elevations.
    edge_tan: (count - 1,) float64, tangents of the elevations between rings; for elevations only.
    """

    source: RingSource
    elevation_deg: FloatArray
    lookup: IntArray
    edge_tan: FloatArray

    @property
    def count(self) -> int:
        return len(self.elevation_deg)

    @property
    def seen_deg(self) -> FloatArray:
        """Elevations of the rings with returns."""
        return self.elevation_deg[np.isfinite(self.elevation_deg)]

    def rings(self, points_sensor: FloatArray, number: IntArray | None) -> IntArray:
        """Return the ring (n,) uint16 of points (n, 3).

        number: (n,) field value, row or column; None for elevations.
        """
        if number is not None:
            return self.lookup.take(number, mode="clip")
        x, y, z = points_sensor.T.astype(np.float64)
        with np.errstate(divide="ignore"):  # On the spin axis
            ring = np.searchsorted(self.edge_tan, z / np.hypot(x, y))
        return np.asarray(ring.astype(np.uint16))


@dataclass(frozen=True)
class RingSample:
    """Valid points (n, 3) of a cloud, with their field values, rows and columns (n,)."""

    points_sensor: FloatArray
    field: IntArray | None
    row: IntArray
    column: IntArray
    shape: tuple[int, int]


def estimate_rings(samples: Sequence[RingSample]) -> RingModel:
    """Estimate the model from some clouds.

    The first of these whose numbers keep their elevation: the ring field, rows, columns; else the
    elevations.
    """
    numbered = [s for s in samples if s.field is not None and _are_rings(s.field)]
    # One cloud in many may lack the field, or have other values in it.
    if 2 * len(numbered) > len(samples):
        elevation, far = _elevations(numbered)
        number = np.concatenate([s.field for s in numbered if s.field is not None])
        if np.count_nonzero(far) < _FEW or _is_constant(number[far], elevation[far]):
            count = _whole_count(int(number.max()) + 1)
            return _by_number("field", count, number[far], elevation[far])
    shape, alike_count = max(
        Counter(s.shape for s in samples).items(), key=lambda item: item[1], default=((1, 1), 0)
    )
    if 2 * alike_count > len(samples) and 1 not in shape:
        alike = [s for s in samples if s.shape == shape]
        elevation, far = _elevations(alike)
        places: list[tuple[RingSource, int, IntArray]] = [
            ("row", shape[0], np.concatenate([s.row for s in alike])),
            ("column", shape[1], np.concatenate([s.column for s in alike])),
        ]
        for source, count, number in places:
            if 1 < count <= _RINGS_MAX and _is_constant(number[far], elevation[far]):
                return _by_number(source, count, number[far], elevation[far])
    elevation, far = _elevations(samples)
    return _by_elevation(elevation[far])


def _are_rings(number: IntArray) -> bool:
    return bool(len(number) and number.min() >= 0 and 0 < number.max() < _RINGS_MAX)


def _elevations(samples: Sequence[RingSample]) -> tuple[FloatArray, BoolArray]:
    """Elevation (n,) in degrees, and whether (n,) the point is far enough to identify its ring."""
    points = np.concatenate([np.zeros((0, 3), np.float32), *(s.points_sensor for s in samples)])
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    far = np.einsum("ij,ij->i", points, points) > _NEAR_M**2
    if np.count_nonzero(far) < 0.2 * len(points):
        far[:] = True
    return elevation.astype(np.float64), far


def _is_constant(number: IntArray, elevation: FloatArray) -> bool:
    """Whether points of one number are at one elevation, compared with the cloud's spread."""
    if len(number) < _FEW:
        return False
    order = np.argsort(number, kind="stable")
    groups = np.split(elevation[order], np.flatnonzero(np.diff(number[order])) + 1)
    spread = [np.subtract(*np.percentile(group, [75, 25])) for group in groups if len(group) >= 5]
    return bool(spread) and float(np.median(spread)) < 0.2 * float(elevation.std())


def _whole_count(seen: int) -> int:
    """Round up to a sensor's number of rings: the topmost may have no returns."""
    return next((count for count in _STANDARD_COUNTS if 0.85 * count <= seen <= count), seen)


def _by_number(
    source: RingSource, count: int, number: IntArray, elevation: FloatArray
) -> RingModel:
    median = np.full(count, np.nan)
    for value in np.unique(number):
        median[value] = np.median(elevation[number == value])
    known = np.flatnonzero(np.isfinite(median))
    steps = np.diff(median[known])
    if not len(steps) or np.mean(steps > -_SWAP_DEG) > 0.9:
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
    """Find rings as peaks of the elevations' histogram, smoothed just enough to separate them."""
    from scipy.signal import find_peaks  # Half a second to load, and few clouds need it

    best_share, best = 0.0, np.zeros(0)
    if len(elevation) >= 200:
        low = np.floor(elevation.min() / _BIN_DEG) * _BIN_DEG - 1.0
        bins = int((elevation.max() + 1.0 - low) / _BIN_DEG) + 1
        place = ((elevation - low) / _BIN_DEG).astype(np.int64)
        counts = np.bincount(place, minlength=bins).astype(np.float64)
        for sigma_deg in (0.02, 0.04, 0.08, 0.15, 0.3):
            smooth = gaussian_filter1d(counts, sigma_deg / _BIN_DEG)
            peaks = find_peaks(smooth)[0]
            if len(peaks):
                # A ring has some share of the points of its neighbours; a ripple has not.
                heights = smooth[peaks]
                prominence = max(0.02 * np.percentile(heights, 75), 0.5 * heights.min())
                peaks = find_peaks(smooth, prominence=prominence)[0]
            if not 1 < len(peaks) <= _RINGS_MAX:
                continue
            centres = low + (peaks + 0.5) * _BIN_DEG
            # A split ring costs its share of points, two rings taken for one cost both shares.
            share = float(np.mean(_near(elevation, centres)))
            if share > best_share:
                best_share, best = share, centres
    source: RingSource = "elevation"
    if best_share < _RINGED_SHARE_MIN:
        source = "bins"
        span = np.percentile(elevation, [0.5, 99.5]) if len(elevation) else np.array([-16.0, 16.0])
        best = np.linspace(span[0], span[1], max(round(np.ptp(span) / _SLICE_DEG), 2))
    edges = np.tan(np.radians((best[1:] + best[:-1]) / 2))
    return RingModel(source, best, np.zeros(0, np.uint16), edges)


def on_rings(points_sensor: FloatArray, rings: RingModel) -> BoolArray:
    """Find (n,) the points (n, 3) within a quarter of the spacing of a ring."""
    x, y, z = points_sensor.T.astype(np.float64)
    return _near(np.degrees(np.arctan2(z, np.hypot(x, y))), np.sort(rings.seen_deg))


def _near(elevation: FloatArray, centres: FloatArray) -> BoolArray:
    edges = (centres[1:] + centres[:-1]) / 2
    nearest = np.searchsorted(edges, elevation)
    gaps = np.diff(centres)
    spacing = np.minimum(np.append(gaps, gaps[-1]), np.append(gaps[0], gaps))
    return np.asarray(np.abs(elevation - centres[nearest]) < spacing[nearest] / 4)
