"""How strongly each part of a wall's face reflects: the mean intensity of its cells, as seen at right angles.

Intensities fall with the angle of incidence in a way that depends on the sensor. Cells that were seen at several angles tell
how, whatever they are made of.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.segments import Segment
from ffmap.algorithms.building.cells import FILLED, THROUGH, mean_before_m
from ffmap.algorithms.building.face_columns import TracedFace, TracedFaces
from ffmap.algorithms.building.model import CELL_M, ON_FACE_M, BuildingSettings, cells_in

_RETURNS_MIN = 2  # Of a cell, for its mean to count
_OF_FACE = 0.4  # Minimum share
_ONE_DIRECTION = 0.998  # Cosine of what faces of one wall differ by at most


class Picture(NamedTuple):
    """The cells of a face, and of others that its wall goes on in beyond its ends.

    shade: (c, rows) mean intensity. before_m: (c, rows) how far what returns stands out of the face. Both NaN where too little is
    known, where what returns lies in another plane, and where rays pass: that is neither wall nor leaf. counts: (c, rows, 4), see
    `WallCells`. face: as it is seen from above. reach: how many of its columns lie before the face's start, and as many behind its
    end.
    """

    shade: FloatArray
    before_m: FloatArray
    counts: FloatArray
    face: Segment
    reach: int = 0

    def is_of(self, first: float, last: float) -> bool:
        """Whether enough of what lies between two columns is of the face itself; else it is rather another's."""
        shared = min(last, len(self.shade) - self.reach) - max(first, self.reach)
        return shared >= _OF_FACE * (last - first)


def pictures(faces: TracedFaces, building: BuildingSettings) -> list[Picture]:
    """Of each face, with as many columns more at each end as doors are wide, as far as others of its wall go on there: a door may
    lie in two. None where no scan has intensities.
    """
    light = faces.cells.light
    if not len(light):
        return []
    response = response_by_angle(light)
    own = [_picture(face, light[face.columns], response) for face in faces.each()]
    return [_continued(picture, own, cells_in(building.door_width_max_m), building.in_line_m) for picture in own]


def _picture(face: TracedFace, light: FloatArray, response: FloatArray) -> Picture:
    before_m = mean_before_m(face.counts)
    off = (np.abs(before_m) > ON_FACE_M) | (face.counts[..., THROUGH] > 0.5 * face.counts[..., FILLED])
    shade = shades(light, response)
    return Picture(np.where(off, np.nan, shade), np.where(off, np.nan, before_m), face.counts, face.segment)


def _continued(own: Picture, pictures: Sequence[Picture], reach: int, in_line_m: float) -> Picture:
    size, face = len(own.shade), own.face
    unknown = np.full((size + 2 * reach, own.shade.shape[1]), np.nan)
    longer = Picture(unknown, unknown.copy(), np.zeros((*unknown.shape, 4)), face, reach)
    for column, known in zip(longer[:3], own[:3], strict=True):
        column[reach : reach + size] = known
    for picture in pictures:
        other = picture.face
        ends = np.stack([other.start, other.at(np.array([other.length_m]))[0]])
        if picture is own or other.normal @ face.normal < _ONE_DIRECTION or np.abs(face.before_m(ends)).max() > in_line_m:
            continue
        places = face.place_m(other.at(CELL_M * (np.arange(len(picture.shade)) + 0.5)))
        at = np.floor(places / CELL_M).astype(np.int64) + reach
        beyond = (at >= 0) & (at < len(longer.shade)) & ((at < reach) | (at >= reach + size))
        for column, known in zip(longer[:3], picture[:3], strict=True):
            column[at[beyond]] = known[beyond]
    return longer


def response_by_angle(light: FloatArray) -> FloatArray:
    """(angles,) how intensities fall with the angle of incidence, 1 at right angles, by the cells that were seen at two of them.

    light: see `WallCells`.
    """
    response = np.ones(light.shape[2])
    count, total = light[..., 0].astype(np.float64), light[..., 1].astype(np.float64)
    for k in range(1, len(response)):
        both = np.minimum(count[..., k - 1], count[..., k])
        seen = (both >= _RETURNS_MIN) & (total[..., k - 1] > 0.0) & (total[..., k] > 0.0)
        ratio = total[seen, k] / count[seen, k] * count[seen, k - 1] / total[seen, k - 1]
        response[k] = response[k - 1] * (_weighted_median(ratio, both[seen]) if len(ratio) else 1.0)
    return response


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def shades(light: FloatArray, response: FloatArray) -> FloatArray:
    """(columns, rows) mean intensity of each cell as it is at right angles, NaN where too few returns tell.

    light: see `WallCells`. response: (angles,) see `response_by_angle`.
    """
    count = light[..., 0].sum(axis=-1)
    total = (light[..., 1].astype(np.float64) / response).sum(axis=-1)
    return np.where(count >= _RETURNS_MIN, total / np.maximum(count, 1.0), np.nan)


def peaks(values: FloatArray, least: float) -> IntArray:
    """(k,) where values (c,) are at least `least` from 0, and no nearer to it than the two before and behind; NaN counts as 0."""
    size = np.nan_to_num(np.abs(values))
    padded = np.pad(size, 2)
    farthest = np.max([padded[k : k + len(size)] for k in range(5)], axis=0)
    return np.flatnonzero((size > 0.0) & (size >= least) & (size == farthest))
