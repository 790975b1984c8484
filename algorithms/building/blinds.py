"""Blinds and shutters that hang in windows, above what rays pass of them.

A lintel is of its wall: it lies in the wall's face, and returns as much of a beam. What closes a window's upper part, and lies
farther back or returns more or less than the wall, hangs in it, unless it is no higher than a frame is wide.
"""

from typing import NamedTuple

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.known import median_known
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import (
    FILLED,
    THROUGH,
    WallCells,
    depth_moments,
    returns_at_face,
    with_neighbours,
)
from ffmap.algorithms.building.face_columns import TracedFaces, runs
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_BLINDS,
    Blinds,
    BuildingSettings,
    Windows,
    cells_in,
)
from ffmap.algorithms.building.shades import response_by_angle, shades
from ffmap.algorithms.building.windows import wall_of


class BlindsSettings(StepSettings):
    """Telling what hangs in a window from the wall above it."""

    height_min_m: float = Field(
        0.2, gt=0, description="Minimum height (m) of what hangs in a window: frames and transoms are narrower."
    )
    contrast_min: float = Field(
        0.25, gt=0, lt=1, description="Minimum difference of its intensity from the wall's, as a share of that."
    )
    returns_share_min: float = Field(
        0.3, gt=0, description="Minimum returns of one of its cells, as a share of those of the wall as high up: glass has fewer."
    )
    width_share_min: float = Field(
        0.5, gt=0, le=1, description="Minimum share of a window's width that it covers in each row: a frame has two stiles."
    )


class _Picture(NamedTuple):
    """The cells (c, rows) of one face.

    closed: whether rays end there as on a wall. behind_m: how far behind the wall beside its windows. contrast: by which share of
    that wall's intensity its own differs; NaN where unknown.
    """

    closed: BoolArray
    behind_m: FloatArray
    contrast: FloatArray


def find_blinds(windows: Windows, faces: TracedFaces, building: BuildingSettings, settings: BlindsSettings) -> Blinds:
    """What hangs in the windows above their clear part, at most one in each. faces: with all rays."""
    walls, cells = faces.walls, faces.cells
    response, least = response_by_angle(cells.light), cells_in(settings.height_min_m)
    places = [wall_of(windows, k, walls) for k in range(len(windows))]
    beside = np.ones(int(cells.first[-1]), bool)
    for w, first, after in places:
        if w >= 0:
            beside[cells.first[w] + first : cells.first[w] + after] = False
    pictures = {
        w: _picture(cells.of(w), beside[cells.first[w] : cells.first[w + 1]], response, building, settings)
        for w in {place[0] for place in places} - {-1}
    }
    blinds = NO_BLINDS
    for k, (w, first, after) in enumerate(places):
        if w < 0:
            continue
        picture, own, top = pictures[w], slice(first, after), cells_in(windows.top_m[k])
        closed, behind_m, contrast = picture.closed[own], picture.behind_m[own], picture.contrast[own]
        hangs = closed & ((behind_m > building.recess_min_m) | (np.abs(contrast) > settings.contrast_min))
        covered, is_wall = (part.mean(axis=0) >= settings.width_share_min for part in (hangs, closed & ~hangs))
        low, high = next(((top + low, top + high) for low, high in runs(covered[top:]) if high - low >= least), (top, top))
        if low == high or is_wall[top:low].any():
            continue  # what lies above the lintel is not in the window
        part = hangs[:, low:high]
        told = [median_known(values[:, low:high][part]) for values in (behind_m, contrast)]
        row = (CELL_M * low, CELL_M * high, max(told[0], 0.0), told[1])
        blinds = blinds.append(Blinds(windows.ends[[k]], windows.normal[[k]], *(np.array([value]) for value in row)))
    return blinds


def _picture(
    cells: WallCells, beside: BoolArray, response: FloatArray, building: BuildingSettings, settings: BlindsSettings
) -> _Picture:
    """Of a single face; a face of many windows may be that of their blinds, hence the wall beside them tells.

    beside: (c,) the columns without a window. response: see `response_by_angle`.
    """
    near = with_neighbours(cells.counts.astype(np.float64))
    mean_m, variance_m2 = depth_moments(near)
    # As many rays as on the wall itself, and all at one depth: glass returns but few, the underside of a lintel at all depths.
    at_face = returns_at_face(near)
    on_wall = np.where(at_face > near[..., THROUGH], at_face, np.nan)
    usual = np.nan_to_num([median_known(row) for row in on_wall.T])
    closed = (near[..., FILLED] > near[..., THROUGH]) & (near[..., FILLED] > settings.returns_share_min * usual)
    closed &= variance_m2 < building.pane_spread_m**2
    contrast = np.full(closed.shape, np.nan)
    if len(cells.light):
        shade = shades(cells.light, response)
        contrast = shade / median_known(shade[beside]) - 1.0
    return _Picture(closed, np.nan_to_num(median_known(mean_m[closed & beside[:, None]])) - mean_m, contrast)
