"""Rooms against the ground truth: recall, precision, rooms split and rooms merged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy import ndimage

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray

ENTERED_M = 1.0
"""Minimum length (m) of the path in a room that was entered."""
TOUCHING_M = 0.3
"""Maximum distance (m) of rooms that touch."""
ROOM_MIN_M2 = 0.5
"""Minimum area (m²) of a room in an image."""


@dataclass(frozen=True, eq=False)
class RoomFigures:
    """F found rooms compared with T true rooms.

    recall: (T,) largest overlap with one found room / own area.
    precision: (F,) largest overlap with one true room / own area.
    counted: (T,) whether the mean recall includes the true room.
    split: true rooms that contain most of two or more found rooms that touch.
    merged: pairs of true rooms with most of their mapped parts, and 1 m² or more, in one found
        room.
    """

    recall: FloatArray
    precision: FloatArray
    counted: BoolArray
    split: tuple[int, ...]
    merged: tuple[tuple[int, int], ...]

    @property
    def mean_recall(self) -> float:
        """Over the counted true rooms; NaN if there are none."""
        return float(self.recall[self.counted].mean()) if self.counted.any() else float("nan")

    @property
    def mean_precision(self) -> float:
        """Over all found rooms; NaN if there are none."""
        return float(self.precision.mean()) if len(self.precision) else float("nan")


def compare_rooms(
    true: Sequence[shapely.Polygon],
    found: Sequence[shapely.Polygon],
    path_map: FloatArray | None = None,
) -> RoomFigures:
    """Compare outlines (m) in one frame.

    path_map: (n, 2 or 3) positions of the robot; only rooms that it entered are counted.
    """
    overlap = np.array([[t.intersection(f).area for f in found] for t in true])
    counted = np.ones(len(true), bool)
    if path_map is not None:
        path = shapely.linestrings(path_map[:, :2]) if len(path_map) > 1 else shapely.LineString()
        counted = np.array([path.intersection(t).length >= ENTERED_M for t in true], bool)
    touching = np.array([[a.distance(b) <= TOUCHING_M for a in found] for b in found], bool)
    return _compare(
        overlap.reshape(len(true), len(found)),
        np.array([t.area for t in true]),
        np.array([f.area for f in found]),
        counted,
        touching.reshape(len(found), len(found)),
    )


def compare_room_images(
    true_label: IntArray, found_label: IntArray, free: BoolArray, cell_m: float
) -> RoomFigures:
    """Compare label images, -1 for no room, in the cells that are free in the map."""
    t, f = true_label[free] + 1, found_label[free] + 1
    rows, columns = int(true_label.max(initial=-1)) + 2, int(found_label.max(initial=-1)) + 2
    counts = np.bincount(t.astype(np.int64) * columns + f, minlength=rows * columns)
    areas = counts.reshape(rows, columns) * cell_m**2
    counted, touching = np.ones(rows - 1, bool), np.ones((columns - 1, columns - 1), bool)
    true_m2, found_m2 = areas[1:].sum(axis=1), areas[:, 1:].sum(axis=0)
    return _compare(areas[1:, 1:], true_m2, found_m2, counted, touching)


def rooms_of_image(pixels: IntArray, cell_m: float) -> IntArray:
    """Number the rooms of an image whose white (over 250) areas are parted by lines.

    Returns (rows, columns) from 0, -1 for no room. Rooms are four-connected.
    """
    label, count = ndimage.label(pixels > 250)
    size_m2 = np.bincount(label.ravel(), minlength=count + 1) * cell_m**2
    kept = np.flatnonzero(size_m2 >= ROOM_MIN_M2 - 1e-9)
    number = np.full(count + 1, -1)
    number[kept[kept > 0]] = np.arange(np.count_nonzero(kept))
    return np.asarray(number[label])


def _compare(
    overlap: FloatArray,
    true_m2: FloatArray,
    found_m2: FloatArray,
    counted: BoolArray,
    touching: BoolArray,
) -> RoomFigures:
    """overlap: (T, F) m². touching: (F, F)."""
    if not overlap.size:
        return RoomFigures(np.zeros(len(true_m2)), np.zeros(len(found_m2)), counted, (), ())
    recall = overlap.max(axis=1) / np.maximum(true_m2, 1e-12)
    precision = overlap.max(axis=0) / np.maximum(found_m2, 1e-12)
    mostly_in = overlap > 0.5 * found_m2
    split = [t for t, own in enumerate(mostly_in) if np.triu(touching[np.ix_(own, own)], 1).any()]
    mapped = overlap.sum(axis=1, keepdims=True)
    holds = (overlap > 0.5 * mapped) & (overlap >= 1.0)
    merged = {
        (int(a), int(b)) for own in holds.T for a, b in np.argwhere(np.triu(np.outer(own, own), 1))
    }
    return RoomFigures(recall, precision, counted, tuple(split), tuple(sorted(merged)))
