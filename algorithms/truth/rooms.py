"""Rooms against the true ones: recall, precision, rooms split and rooms merged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy import ndimage

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class RoomFigures:
    """Found rooms F beside true ones T.

    recall: (T,) largest overlap with one found room / own area. precision: (F,) largest overlap with one true room / own
    area. counted: (T,) true rooms that the mean recall is over.
    split: true rooms in which two or more found rooms that touch one another (within 0.3 m) lie for the most part.
    merged: pairs of true rooms whose mapped part lies for the most part, 1 m² or more, in the same found room.
    """

    recall: FloatArray
    precision: FloatArray
    counted: BoolArray
    split: tuple[int, ...]
    merged: tuple[tuple[int, int], ...]

    @property
    def mean_recall(self) -> float:
        """Over the counted true rooms; NaN where there is none."""
        return float(self.recall[self.counted].mean()) if self.counted.any() else float("nan")

    @property
    def mean_precision(self) -> float:
        """Over all found rooms; NaN where there is none."""
        return float(self.precision.mean()) if len(self.precision) else float("nan")


def compare_rooms(
    true: Sequence[shapely.Polygon], found: Sequence[shapely.Polygon], path_map: FloatArray | None = None
) -> RoomFigures:
    """Outlines in metres of one frame.

    path_map: (n, 2 or more) the robot's places; the recall is counted over the rooms in which 1 m of its way or more lies,
        over all without.
    """
    overlap = np.array([[t.intersection(f).area for f in found] for t in true]).reshape(len(true), len(found))
    counted = np.ones(len(true), bool)
    if path_map is not None:
        path = shapely.linestrings(path_map[:, :2]) if len(path_map) > 1 else shapely.LineString()
        counted = np.array([path.intersection(t).length >= 1.0 for t in true], bool)
    touching = np.array([[a.distance(b) <= 0.3 for a in found] for b in found], bool)
    true_m2, found_m2 = np.array([t.area for t in true]), np.array([f.area for f in found])
    return _figures(overlap, true_m2, found_m2, counted, touching.reshape(len(found), len(found)))


def compare_room_images(true_label: IntArray, found_label: IntArray, free: BoolArray, cell_m: float) -> RoomFigures:
    """Label images of equal shape, -1 where there is no room; only cells that are free in the segmented map count."""
    t, f = true_label[free] + 1, found_label[free] + 1
    rows, columns = int(true_label.max(initial=-1)) + 2, int(found_label.max(initial=-1)) + 2
    counts = np.bincount(t.astype(np.int64) * columns + f, minlength=rows * columns).reshape(rows, columns)
    areas, found = counts * cell_m**2, columns - 1
    counted, touching = np.ones(rows - 1, bool), np.ones((found, found), bool)
    return _figures(areas[1:, 1:], areas[1:].sum(axis=1), areas[:, 1:].sum(axis=0), counted, touching)


def rooms_of_image(pixels: IntArray, cell_m: float) -> IntArray:
    """True rooms (rows, columns) int, -1 where there is none, of an image of rooms parted by lines.

    They are the four-connected regions of pixels over 250 of 0.5 m² or more.
    """
    label, count = ndimage.label(pixels > 250)
    size_m2 = np.bincount(label.ravel(), minlength=count + 1) * cell_m**2
    kept = np.flatnonzero(size_m2 >= 0.5 - 1e-9)
    number = np.full(count + 1, -1)
    number[kept[kept > 0]] = np.arange(np.count_nonzero(kept))
    return np.asarray(number[label])


def _figures(
    overlap: FloatArray, true_m2: FloatArray, found_m2: FloatArray, counted: BoolArray, touching: BoolArray
) -> RoomFigures:
    if not overlap.size:
        empty = np.zeros(len(true_m2)), np.zeros(len(found_m2))
        return RoomFigures(*empty, counted, (), ())
    recall = overlap.max(axis=1) / np.maximum(true_m2, 1e-12)
    precision = overlap.max(axis=0) / np.maximum(found_m2, 1e-12)
    mostly_in = overlap > 0.5 * found_m2
    split = [int(t) for t, own in enumerate(mostly_in) if (np.triu(touching[np.ix_(own, own)], 1)).any()]
    mapped = overlap.sum(axis=1, keepdims=True)
    holds = (overlap > 0.5 * mapped) & (overlap >= 1.0)
    merged = {(int(a), int(b)) for own in holds.T for a, b in np.argwhere(np.triu(np.outer(own, own), 1))}
    return RoomFigures(recall, precision, counted, tuple(split), tuple(sorted(merged)))
