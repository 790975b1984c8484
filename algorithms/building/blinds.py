"""Blinds and shutters that hang in windows, above what rays pass of them.

A lintel is of its wall: it lies in the wall's face, and returns as much of a beam. What closes a window's upper part, and lies
farther back or returns more or less than the wall, hangs in it, unless it is no higher than a frame is wide.
"""

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.door_contrasts import response_by_angle, shades
from ffmap.algorithms.building.face_columns import runs
from ffmap.algorithms.building.model import CELL_M, NO_BLINDS, Blinds, BuildingSettings, Walls, Windows, cells_in
from ffmap.algorithms.building.ray_evidence import (
    FILLED,
    THROUGH,
    WallCells,
    depth_moments,
    returns_at_face,
    with_neighbours,
)
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


def find_blinds(
    windows: Windows, walls: Walls, cells: WallCells, building: BuildingSettings, settings: BlindsSettings
) -> Blinds:
    """What hangs in the windows above their clear part, at most one in each.

    cells: of the walls, with all rays.
    """
    response = response_by_angle(cells.light)
    places = [wall_of(windows, k, walls) for k in range(len(windows))]
    blinds = NO_BLINDS
    for k, (w, first, after) in enumerate(places):
        if w < 0:
            continue
        own, within, top = cells.of(w), slice(first, after), cells_in(windows.top_m[k])
        # A face of many windows may be that of their blinds.
        beside = np.ones(len(own.counts), bool)
        for other, first_beside, after_beside in places:
            beside[first_beside:after_beside] &= other != w
        closed, behind_face_m = _closed(own, building, settings)
        behind_m = behind_face_m - np.nan_to_num(_median(behind_face_m[closed & beside[:, None]]))
        contrast = _contrast(own, response, beside)
        hangs = closed & ((behind_m > building.recess_min_m) | (np.abs(contrast) > settings.contrast_min))
        covered, is_wall = (part[within].mean(axis=0) >= settings.width_share_min for part in (hangs, closed & ~hangs))
        least = cells_in(settings.height_min_m)
        low, high = next(((top + low, top + high) for low, high in runs(covered[top:]) if high - low >= least), (top, top))
        if low == high or is_wall[top:low].any():
            continue  # what lies above the lintel is not in the window
        part = hangs[within, low:high]
        told = [_median(values[within, low:high][part]) for values in (behind_m, contrast)]
        row = (CELL_M * low, CELL_M * high, max(told[0], 0.0), told[1])
        blinds = blinds.append(Blinds(windows.ends[[k]], windows.normal[[k]], *(np.array([value]) for value in row)))
    return blinds


def _closed(cells: WallCells, building: BuildingSettings, settings: BlindsSettings) -> tuple[BoolArray, FloatArray]:
    """(c, rows) each, of a single face: in which cells rays end as on a wall, and how far behind the face.

    As many of them as on the wall itself, and all at one depth: glass returns but few, the underside of a lintel at all depths.
    """
    near = with_neighbours(cells.counts.astype(np.float64))
    mean_m, variance_m2 = depth_moments(near)
    at_face = returns_at_face(near)
    on_wall = np.where(at_face > near[..., THROUGH], at_face, np.nan)
    usual = np.nan_to_num([_median(row) for row in on_wall.T])
    closed = (near[..., FILLED] > near[..., THROUGH]) & (near[..., FILLED] > settings.returns_share_min * usual)
    return closed & (variance_m2 < building.pane_spread_m**2), -mean_m


def _contrast(cells: WallCells, response: FloatArray, beside: BoolArray) -> FloatArray:
    """(c, rows) by which share of the intensity of most cells of a single face's columns `beside` windows each one's differs.

    NaN where it is unknown.
    """
    if not len(cells.light):
        return np.full(cells.counts.shape[:2], np.nan)
    shade = shades(cells.light, response)
    return np.asarray(shade / _median(shade[beside]) - 1.0)


def _median(values: FloatArray) -> float:
    """Of the known ones; NaN of none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
