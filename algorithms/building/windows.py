"""Windows, and what was seen through them."""

from dataclasses import replace

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import LENGTH, Segment, before_line, crossing, lines_of, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.model import CELL_M, NO_WINDOWS, Walls, Windows, cells_in, stretches
from ffmap.algorithms.building.openings import (
    OpeningRules,
    find_sheet,
    is_pane,
    look_for_doors,
    to_jambs,
    tops_m,
    widened,
)
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, SUM, THROUGH, Rays, WallCells, with_neighbours
from ffmap.algorithms.scan.summary import Features


class WindowsSettings(StepSettings):
    """Finding windows in the faces of walls."""

    height_min_m: float = Field(0.3, gt=0, description="Minimum height (m) of a window above a sill.")
    sill_min_m: float = Field(0.2, gt=0, description="Minimum width (m) of the wall that is seen below its sill.")
    empty_max_m: float = Field(
        1.0, ge=0, description="Maximum width (m) by which a window goes on beside it where next to nothing returns."
    )
    empty_share: float = Field(
        0.2, ge=0, le=1, description="Maximum share of the returns below the sill that return there."
    )
    at_pane_m: float = Field(
        0.02, gt=0, description="Maximum distance (m) from the pane of the returns that widen a window."
    )
    passed_share: float = Field(
        0.03, ge=0, le=1, description="Minimum share of rays that pass there: a leaf beside a window returns all."
    )
    reveal_hides_m: float = Field(
        0.15, ge=0, description="Maximum width (m) of an opening that its reveal hides, seen at a slant."
    )


def find_windows(
    walls: Walls, cells: WallCells, clear_m: FloatArray, rules: OpeningRules, settings: WindowsSettings
) -> Windows:
    """Stretches of wall that rays pass through glass: above a sill, or down to the floor where a pane shows itself.

    clear_m: (columns,) from the floor to the ceiling before each column of the faces; NaN where none was seen.
    """
    standing_m = tops_m(walls, cells, clear_m)
    windows = NO_WINDOWS
    for w in range(len(walls)):
        counts = cells.counts[cells.first[w] : cells.first[w + 1]].astype(np.float64)
        if len(counts) < 3:
            continue
        face = Segment.between(walls.ends[w], walls.normal[w])
        columns = look_for_doors(counts, standing_m[cells.first[w] : cells.first[w + 1]], rules)
        opened = stretches(columns.is_open & columns.has_lintel, 2)
        panes = [(first, last) for first, last in opened if is_pane(counts[first : last + 1], rules)]
        may_be, is_sill = _above_sill(counts, walls.top_m[w], rules, settings)
        sill_min = cells_in(settings.sill_min_m)
        sills = [(first, last) for first, last in stretches(may_be, 4) if is_sill[first : last + 1].sum() >= sill_min]
        high = counts[:, cells_in(rules.building.knee_m) : cells_in(rules.building.door_height_min_m)].sum(axis=1)
        for first, last in panes + sills:
            rows = counts[first : last + 1].sum(axis=0)
            clear = np.flatnonzero(rows[:, THROUGH] > rows[:, FILLED])
            if not len(clear):
                continue
            pane_m = _pane_m(counts[first : last + 1, clear[0] : clear[-1] + 1], rules)
            first, last = _over_its_pane(high, pane_m, first, last, settings)
            first, last = to_jambs(high, first, last, settings.reveal_hides_m)
            first, last = _over_empty_columns(counts[:, : clear[-1] + 1], clear[0], first, last, settings)
            ends = face.at(CELL_M * np.array([first, last + 1]))
            between_m = CELL_M * clear[[0]], CELL_M * (clear[[-1]] + 1)
            windows = windows.append(Windows(ends[None], face.normal[None], *between_m, np.array([pane_m])))
    return windows


def _above_sill(
    counts: FloatArray, top_m: float, rules: OpeningRules, settings: WindowsSettings
) -> tuple[BoolArray, BoolArray]:
    """Columns (c,) that rays pass above the knee and not below it, and those of them (c,) whose foot is seen to be wall.

    What stands before a window hides its sill, and a window is as wide as it is all the same.
    """
    foot, knee, top = FOOT_ROW, cells_in(rules.building.knee_m), int(max(top_m - 0.2, 0.0) / CELL_M)
    below = counts[:, foot:knee].sum(axis=1)
    near = with_neighbours(np.swapaxes(with_neighbours(counts), 0, 1)).swapaxes(0, 1)
    clear = (near[..., THROUGH] > near[..., FILLED]) & (near[..., THROUGH] >= 0.5 * rules.building.rays_min)
    passed = clear[:, knee:top].sum(axis=1) >= settings.height_min_m / CELL_M
    may_be = passed & (below[:, THROUGH] <= 0.1 * below[:, FILLED])
    return may_be, may_be & (below[:, FILLED] >= rules.building.rays_min)


def _over_its_pane(
    high: FloatArray, pane_m: float, first: int, last: int, settings: WindowsSettings
) -> tuple[int, int]:
    """A window's columns, with those beside it that return from the same pane: glass that is met straight on returns most rays.

    high: (columns, 4) of the whole face, between knee and head. pane_m: how far behind the face it stands; NaN if unknown.
    """
    near = with_neighbours(high)
    with np.errstate(invalid="ignore", divide="ignore"):
        on_pane = np.abs(-high[:, SUM] / high[:, FILLED] - pane_m) < settings.at_pane_m
        passed = near[:, THROUGH] > settings.passed_share * (near[:, THROUGH] + near[:, FILLED])
    return widened(on_pane & passed, first, last, len(high))


def _over_empty_columns(
    counts: FloatArray, bottom: int, first: int, last: int, settings: WindowsSettings
) -> tuple[int, int]:
    """A window's columns, with those beside it that return only below its sill: glass met at a slant sends rays elsewhere.

    counts: (columns, rows, 4) of the whole face, up to the window's head; bottom: the window's lowest row.
    """
    below = counts[:, FOOT_ROW:bottom, FILLED]
    usual = below.mean(axis=1) if below.shape[1] else np.zeros(len(counts))
    empty = counts[:, bottom:, FILLED].mean(axis=1) < settings.empty_share * usual
    return widened(empty, first, last, cells_in(settings.empty_max_m))


def _pane_m(counts: FloatArray, rules: OpeningRules) -> float:
    """How far behind the face a window's pane stands, by what it returns away from reveals, sill and head."""
    columns, rows = (min(cells_in(rules.openings.jamb_m), (size - 1) // 2) for size in counts.shape[:2])
    inner = counts[columns : counts.shape[0] - columns, rows : counts.shape[1] - rows]
    sheet = find_sheet(inner, rules)
    return sheet.behind_m if sheet is not None and sheet.behind_m > 0 else float("nan")


def seen_through(windows: Windows, features: Features) -> BoolArray:
    """(p,) whether each plane of the scans was seen through a window: it is no wall of this building."""
    origin = features.origin_map[features.plane_scan, :2]
    outside = np.zeros(len(origin), bool)
    start, along = features.plane_ends_map[:, 0], np.diff(features.plane_ends_map, axis=1)[:, 0]
    for window in segments(windows):
        before_m = window.before_m(origin)
        for part in (0.0, 0.5, 1.0):
            place = start + part * along
            behind_m = window.before_m(place)
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing = origin + (before_m / (before_m - behind_m))[:, None] * (place - origin)
            outside |= (before_m > 0) & (behind_m < -CELL_M) & window.beside(crossing)
    return outside


def without_rays_through(windows: Windows, features: Features) -> Features:
    """The same scans without the rays that ended beyond a window."""
    passed = _rays_through(lines_of(windows), Rays.of(features))
    return replace(
        features,
        ray_count=np.bincount(features.ray_scan[~passed], minlength=len(features.scan)),
        ray_end_map=features.ray_end_map[~passed],
        ray_label=features.ray_label[~passed],
    )


@numba.njit(cache=True, nogil=True)
def _rays_through(panes: FloatArray, rays: Rays) -> BoolArray:  # pragma: no cover
    origin, starts, end = rays.origin, rays.starts, rays.end
    passed = np.zeros(len(end), np.bool_)
    for w in range(len(panes)):
        for s in range(len(origin)):
            if before_line(panes, w, origin[s, 0], origin[s, 1]) <= 0.0:
                continue
            for r in range(starts[s], starts[s + 1]):
                x, y = np.float64(end[r, 0]), np.float64(end[r, 1])
                if before_line(panes, w, x, y) <= -CELL_M:
                    _, u = crossing(panes, w, 0.0, x, y, origin[s], 0.0)
                    passed[r] |= 0.0 < u < panes[w, LENGTH]
    return passed
