"""Windows, and what was seen through them."""

from collections.abc import Callable
from dataclasses import replace

import numba
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import (
    LENGTH,
    Segment,
    before_line,
    crossing,
    lengthened,
    lengths_m,
    lines_of,
    segments,
)
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import (
    FILLED,
    THROUGH,
    WallCells,
    mean_before_m,
    returns_at_face,
    with_neighbours,
)
from ffmap.algorithms.building.evidence import DEEP, FOOT_ROW, LAYERS_M
from ffmap.algorithms.building.face_columns import TracedFaces, long_runs, on_and_passed, runs
from ffmap.algorithms.building.face_verdicts import SAME_WAY
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_WINDOWS,
    ON_FACE_M,
    Walls,
    Windows,
    cells_in,
    stretches,
)
from ffmap.algorithms.building.openings import (
    OpeningRules,
    deep_rules,
    find_sheet,
    is_open_to_floor,
    is_pane,
    look_for_doors,
    widened,
)
from ffmap.algorithms.building.rays import Rays
from ffmap.algorithms.building.unexplained_lines import unseen_faces
from ffmap.algorithms.scan.summary import Features, select_rays


class WindowsSettings(StepSettings):
    """Finding windows in the faces of walls."""

    height_min_m: float = Field(
        0.3, gt=0, description="Minimum height (m) of a window above a sill, and width of one that shows by a pane alone."
    )
    patch_m: float = Field(
        0.25,
        ge=0,
        description="Height (m) over which the rays are counted together that tell whether a window is there: many pass it and "
        "return from nothing.",
    )
    sill_min_m: float = Field(
        0.2,
        gt=0,
        description="Minimum width (m) of the wall that is seen below its sill, or of a window higher than doors where none is.",
    )
    returns_min: float = Field(
        1.0,
        gt=0,
        description="A column beside a window, with those next to it, belongs to the wall or to the window where each row above "
        "the head and below the sill has this many returns.",
    )
    one_wall_m: float = Field(
        0.1, gt=0, description="Maximum distance (m) between two stretches of a face in which one window shows."
    )
    translucent_min: float = Field(
        0.2,
        gt=0,
        lt=0.5,
        description="Minimum share of a cell's rays that pass a pane which returns others, and of those that return.",
    )
    translucent_depth_m: float = Field(
        0.15, gt=0, description="Maximum distance (m) of such a pane behind the wall's face."
    )
    reveal_max_m: float = Field(0.4, ge=0, description="Maximum width (m) over which a window's reveal shows in it.")
    passed_share: float = Field(
        0.03, ge=0, le=1, description="Minimum share of rays that pass there: a leaf beside a window returns all."
    )


def find_windows(faces: TracedFaces, rules: OpeningRules, settings: WindowsSettings) -> Windows:
    """Stretches of wall that rays pass through glass: above a sill, higher than doors, or where a pane shows itself."""
    windows = NO_WINDOWS
    for own in faces.each():
        face, counts, wall_top_m = own.segment, own.counts, faces.walls.top_m[own.number]
        if len(counts) < 3:
            continue
        columns = look_for_doors(counts, own.top_m, rules)
        least = cells_in(settings.height_min_m)
        # Beside a jamb some rays pass, and others end on the reveal.
        below_blind = long_runs(_closes_below_heads(counts, rules, settings), least, bridge=2)
        opened = [
            *stretches(columns.is_open & columns.has_lintel & ~below_blind, 2),
            *stretches(below_blind, 2),
        ]
        panes = [(first, last) for first, last in opened if is_pane(_up_to_head(counts[first : last + 1]), rules)]
        may_be, is_sill = _above_sill(counts, wall_top_m, rules, settings)
        sill_min = cells_in(settings.sill_min_m)
        sills = [
            (first, last)
            for first, last in stretches(may_be, 4)
            if is_sill[first : last + 1].sum() >= sill_min
            or (last + 1 - first >= sill_min and _is_higher_than_doors(counts[first : last + 1], rules))
        ]
        glazed = [part for part in stretches(_translucent(counts, rules, settings), 2) if part[1] + 1 - part[0] >= least]
        high = counts[:, cells_in(rules.building.knee_m) : cells_in(rules.building.door_height_min_m)].sum(axis=1)
        parts = [(*part, 0.5) for part in panes + sills] + [(*part, settings.translucent_min) for part in glazed]
        for first, last, share_min in parts:
            rows = counts[first : last + 1].sum(axis=0)
            clear = np.flatnonzero(rows[:, THROUGH] > share_min * (rows[:, FILLED] + rows[:, THROUGH]))
            if not len(clear):
                continue
            pane_m = find_pane_m(counts[first : last + 1, clear[0] : clear[-1] + 1], rules)
            shown = slice(first, last + 1)
            first, last = _over_its_pane(high, pane_m, first, last, rules.openings.sheet_m, settings)
            between, highest = (int(clear[0]), int(clear[-1])), int(wall_top_m / CELL_M)
            first, last = _to_its_wall(counts, between, highest, first, last, rules, settings)
            if first == 0 and last == len(counts) - 1:
                continue  # without a jamb it is what stands below something that hangs
            between_m = CELL_M * clear[[0]], CELL_M * (clear[[-1]] + 1)
            for part in _without_doorways(counts, high, pane_m, shown, (first, last + 1), rules, settings):
                ends = face.at(CELL_M * np.array(part))
                windows = windows.append(Windows(ends[None], face.normal[None], *between_m, np.array([pane_m])))
    return join_windows(windows, settings.one_wall_m, settings.height_min_m)


def look_deeper(
    windows: Windows, trace: Callable[[Walls], WallCells], rules: OpeningRules, settings: WindowsSettings
) -> Windows:
    """The windows, with the panes of those whose own lies too deep in its wall to show in the wall's face.

    trace: counts rays against faces.
    """
    unknown = np.flatnonzero(np.isnan(windows.pane_m))
    if not len(unknown):
        return windows
    deep, rules = windows.select(unknown), deep_rules(rules)
    cells = trace(unseen_faces(deep.ends, deep.normal, deep.top_m))
    pane_m = windows.pane_m.copy()
    for k, own in enumerate(unknown):
        rows = slice(cells_in(deep.bottom_m[k]), cells_in(deep.top_m[k]))
        counts = cells.counts[cells.first[k] : cells.first[k + 1], rows].astype(np.float64)
        returned, passed = counts[..., FILLED].sum(), counts[..., THROUGH].sum()
        # Nothing passes what stands behind the wall.
        if passed > settings.translucent_min * (returned + passed):
            pane_m[own] = find_pane_m(counts, rules)
    return replace(windows, pane_m=pane_m)


def join_windows(windows: Windows, one_wall_m: float, sill_m: float) -> Windows:
    """The windows, each once: those that overlap on one wall are one, which its wall's stretches and its panes may show apart.

    A garden door and the window beside it, which has a sill, are two, though their ends may overlap where faces are askew.

    one_wall_m: maximum distance between the faces, or panes, in which two of them show. sill_m: maximum difference of their lower
    edges where they share less than half of the shorter's width.
    """
    joined = NO_WINDOWS
    for own in (windows.one(w) for w in range(len(windows))):
        for k, known in enumerate(segments(joined)):
            if not is_beside(known, own.ends[0], own.normal[0], one_wall_m):
                continue
            place_m = np.concatenate([[0.0, known.length_m], known.place_m(own.ends[0])])
            is_less = known.shared_m(own.ends[0]) < 0.5 * min(known.length_m, float(lengths_m(own.ends)[0]))
            if is_less and abs(joined.bottom_m[k] - own.bottom_m[0]) > sill_m:
                continue
            ends = known.at(np.array([place_m.min(), place_m.max()]))
            one = joined.one(k).append(own)
            own = Windows(
                ends[None],
                known.normal[None],
                one.bottom_m.min(keepdims=True),
                one.top_m.max(keepdims=True),
                np.fmax(one.pane_m[:1], one.pane_m[1:]),
            )
            joined = joined.select(np.arange(len(joined)) != k)
            break
        joined = joined.append(own)
    return joined


def is_in_wall(windows: Windows, walls: Walls, settings: WindowsSettings) -> BoolArray:
    """(N,) which windows lie in a wall that looks the same way."""
    faces, panes = tuple(segments(walls)), zip(windows.ends, windows.normal, strict=True)
    return np.array([any(is_beside(face, *own, settings.one_wall_m) for face in faces) for own in panes], bool)


def widened_in_walls(windows: Windows, walls: Walls, by_m: float, settings: WindowsSettings) -> Windows:
    """The windows with what may be more of their panes on either side of those that lie in a wall, or beside one in line.

    Rays pass freely beside a screen that stands in a room.
    """
    widened = replace(windows, ends=lengthened(windows.ends, by_m))
    in_wall = is_in_wall(widened, walls, settings)
    return replace(windows, ends=np.where(in_wall[:, None, None], widened.ends, windows.ends))


def wall_of(windows: Windows, k: int, walls: Walls) -> tuple[int, int, int]:
    """The wall in whose face most of a window lies, -1 where none has, its first column there and the one after the last."""
    best_m, found = 0.5 * float(np.linalg.norm(windows.ends[k, 1] - windows.ends[k, 0])), (-1, 0, 0)
    for w, face in enumerate(segments(walls)):
        if face.normal @ windows.normal[k] > SAME_WAY and np.abs(face.before_m(windows.ends[k])).max() < ON_FACE_M:
            shared_m = face.shared_m(windows.ends[k])
            if shared_m > best_m:
                low, high = np.sort(face.place_m(windows.ends[k])) / CELL_M
                columns = int(np.ceil(face.length_m / CELL_M))
                best_m, found = shared_m, (w, max(round(low), 0), min(round(high), columns))
    return found


def is_beside(face: Segment, ends: FloatArray, normal: FloatArray, one_wall_m: float) -> bool:
    """Whether a window with these ends (2, 2) and normal (2,) overlaps a face that looks the same way, at most `one_wall_m` off."""
    off_m = np.abs(face.before_m(ends)).max()
    return bool(face.normal @ normal > 0.0 and off_m < one_wall_m and face.shared_m(ends) > 0.0)


def _above_sill(
    counts: FloatArray, top_m: float, rules: OpeningRules, settings: WindowsSettings
) -> tuple[BoolArray, BoolArray]:
    """Columns (c,) that rays pass, but not at the foot, and those of them (c,) whose foot is seen to be wall: a sill, however low.

    What stands before a window hides its sill, and a window is as wide as it is all the same.
    """
    top = max(int(max(top_m - 0.2, 0.0) / CELL_M), FOOT_ROW + 1)
    near = with_neighbours(counts[:, :top])[..., [FILLED, THROUGH]]
    aside = cells_in(settings.patch_m) // 2
    padded = np.pad(near, ((0, 0), (aside, aside), (0, 0)))
    filled, passed = np.moveaxis(sliding_window_view(padded, 2 * aside + 1, axis=1).sum(axis=-1), 2, 0)
    clear = (passed > filled) & (passed >= 0.5 * rules.building.rays_min)
    clear[:, 0] = False
    lowest = np.argmax(clear, axis=1)
    below = counts[:, :top] * ((np.arange(top) > 0) & (np.arange(top) < lowest[:, None]))[..., None]
    filled, passed = below[..., FILLED].sum(axis=1), below[..., THROUGH].sum(axis=1)
    may_be = (clear.sum(axis=1) >= settings.height_min_m / CELL_M) & (lowest > FOOT_ROW) & (passed <= 0.1 * filled)
    foot = with_neighbours(returns_at_face(below).sum(axis=1))
    return may_be, may_be & (foot >= rules.building.rays_min)


def _translucent(counts: FloatArray, rules: OpeningRules, settings: WindowsSettings) -> BoolArray:
    """Columns (c,) in whose cells some rays pass and others return from close behind the face, over a window's height.

    Glass does both; a leaf lets no ray pass, and an open doorway returns none. What stands farther behind an opening is passed by
    rays that cross the same cell at a slant.
    """
    near = with_neighbours(counts)
    rays = near[..., FILLED] + near[..., THROUGH]
    behind_m = -mean_before_m(near)
    with np.errstate(invalid="ignore", divide="ignore"):
        passed = near[..., THROUGH] / rays
    both = (rays >= rules.building.rays_min) & (np.abs(passed - 0.5) < 0.5 - settings.translucent_min)
    both &= (behind_m > rules.building.recess_min_m) & (behind_m < settings.translucent_depth_m)
    return _shows(both[:, FOOT_ROW:], cells_in(settings.height_min_m) - 1)


def _closes_below_heads(counts: FloatArray, rules: OpeningRules, settings: WindowsSettings) -> BoolArray:
    """Columns (c,) that most rays pass at the foot, and few at the lowest doors' heads: a blind is let down before a window."""
    near, high = with_neighbours(counts), cells_in(rules.building.door_height_min_m)
    foot = near[:, FOOT_ROW : FOOT_ROW + cells_in(settings.height_min_m)].sum(axis=1)
    head = near[:, high - cells_in(settings.height_min_m) : high].sum(axis=1)
    return np.asarray((foot[:, THROUGH] > foot[:, FILLED]) & (head[:, FILLED] > head[:, THROUGH]))


def _up_to_head(counts: FloatArray) -> FloatArray:
    """The cells (c, rows, 4) of an opening without those above the rows that most rays pass: a sheet there is no pane."""
    rows = counts.sum(axis=0)
    clear = np.flatnonzero(rows[:, THROUGH] > rows[:, FILLED])
    return np.asarray(counts * (np.arange(len(rows)) <= clear.max(initial=-1))[:, None])


def _is_higher_than_doors(counts: FloatArray, rules: OpeningRules) -> bool:
    """Whether rays pass an opening (c, rows, 4) higher than doors are: it is a window, though its sill is hidden."""
    clear = np.flatnonzero(counts[..., THROUGH].sum(axis=0) > counts[..., FILLED].sum(axis=0))
    return bool(len(clear) and clear[-1] * CELL_M > rules.building.door_height_max_m)


def _over_its_pane(
    high: FloatArray, pane_m: float, first: int, last: int, sheet_m: float, settings: WindowsSettings
) -> tuple[int, int]:
    """A window's columns, with those beside it that return from the same pane: glass that is met straight on returns most rays.

    high: (columns, 4) of the whole face, between knee and head. pane_m: how far behind the face it stands; NaN if unknown.
    """
    near = with_neighbours(high)
    on_pane = np.abs(mean_before_m(high) + pane_m) < sheet_m
    passed = near[:, THROUGH] > settings.passed_share * (near[:, THROUGH] + near[:, FILLED])
    return widened(on_pane & passed, first, last, len(high))


def _without_doorways(
    counts: FloatArray,
    high: FloatArray,
    pane_m: float,
    shown: slice,
    whole: tuple[int, int],
    rules: OpeningRules,
    settings: WindowsSettings,
) -> list[tuple[int, int]]:
    """A window's columns without those of open doorways: the first of each part and the one after its last.

    Where its pane would have returned rays and none came, over a door's width and down to the floor, a door stands open. There is
    no part where most of the window is silent so: what returned there was a leaf, or the reveal.

    counts: (columns, rows, 4) of the whole face; high: (columns, 4) of these between knee and head. pane_m: how far behind it the
    pane stands; NaN if unknown. shown: the columns in which it shows. whole: the window's first column and the one after the last.
    """
    building, near = rules.building, with_neighbours(high)
    rays = near[:, FILLED] + near[:, THROUGH]
    on_pane = np.abs(mean_before_m(near) + pane_m) < rules.openings.sheet_m
    share = np.sum(near[shown, FILLED] * on_pane[shown]) / max(float(rays[shown].sum()), 1.0)
    window = np.zeros(len(counts), bool)
    window[slice(*whole)] = True
    tells = window & (share * rays >= rules.openings.expected_min)
    silent = tells & (near[:, FILLED] == 0)
    if np.count_nonzero(silent) > 0.5 * np.count_nonzero(tells):
        return []
    # A stray return tells in its own column and in the two beside it.
    for start, stop in runs(long_runs(silent, cells_in(building.door_width_min_m), bridge=3)):
        is_narrow = stop - start <= cells_in(building.door_width_max_m)
        rows = counts[start:stop, FOOT_ROW : cells_in(building.knee_m)].sum(axis=0)
        has_sill = bool(np.any(rows[:, FILLED] > rows[:, THROUGH]))
        window[start:stop] = has_sill or not (is_narrow and is_open_to_floor(counts[start:stop], rules))
    parts = runs(window)
    # Beside a doorway slivers are left that are no panes.
    least = cells_in(settings.height_min_m) if len(parts) > 1 else 1
    return [(start, stop) for start, stop in parts if stop - start >= least]


def _to_its_wall(
    counts: FloatArray,
    between: tuple[int, int],
    highest: int,
    first: int,
    last: int,
    rules: OpeningRules,
    settings: WindowsSettings,
) -> tuple[int, int]:
    """A window's columns up to those in which its wall shows between the sill and the head.

    A sweep that meets the wall above a window, or below it, meets the wall between too, if there is one: where it shows no more
    than a bar, there is glass met at a slant, or the reveal hides it. Glass down to the floor goes on beyond a bar only
    where rays pass down there too: else a garden door ends, and the window beside it has a sill.

    counts: (columns, rows, 4) of the whole face; between: the window's lowest and highest row; highest: the face's.
    """
    (bottom, top), bar = between, cells_in(rules.openings.bar_max_m)
    if top + 1 - bottom <= bar:
        return first, last  # too low for a wall to show in it
    near = with_neighbours(counts)
    on = returns_at_face(near)
    inner, passed = near[:, bottom : top + 1], near[:, bottom : top + 1, THROUGH]
    flush, returns = _shows(on[:, bottom : top + 1] > passed, bar), _shows(inner[..., FILLED] > passed, bar)
    # What returns behind the face is its reveal, or a leaf beside it, which is wider.
    shows = flush | long_runs(returns & ~flush, cells_in(settings.reveal_max_m), 0)
    foot = slice(FOOT_ROW, max(bottom, FOOT_ROW))
    around = np.concatenate([on[:, foot], on[:, top + 2 : highest]], axis=1)
    is_met = around.mean(axis=1) >= settings.returns_min if around.shape[1] else np.zeros(len(on), bool)
    # A doorway is open at its foot, or above what closes the window.
    over = slice(top + 1, cells_in(rules.building.door_height_min_m))
    is_doorway = np.zeros(len(on), bool)
    for rows in (foot, over):
        is_doorway |= near[:, rows, THROUGH].sum(axis=1) > on[:, rows].sum(axis=1)
    goes_on = is_met & ~shows & ~is_doorway
    if bottom <= FOOT_ROW:
        first, last = widened(goes_on, first, last, len(on))
        low = near[:, FOOT_ROW : FOOT_ROW + cells_in(settings.height_min_m)].sum(axis=1)
        goes_on &= low[:, THROUGH] > low[:, FILLED]
    for start, stop in stretches(goes_on, bar):
        if start <= last and stop >= first:
            first, last = min(start, first), max(stop, last)
    return first, last


def _shows(cells: BoolArray, most: int) -> BoolArray:
    """(c,) in which columns (c, rows) of cells more than `most` rows on end are true."""
    return np.array([any(last - first >= most for first, last in stretches(column, 1)) for column in cells], bool)


def find_pane_m(counts: FloatArray, rules: OpeningRules) -> float:
    """How far behind the face a window's pane stands, by what it returns away from reveals, bars, sill and head; NaN if unknown."""
    columns, rows = (min(cells_in(rules.openings.jamb_m), (size - 1) // 2) for size in counts.shape[:2])
    inner = counts[columns : counts.shape[0] - columns, rows : counts.shape[1] - rows]
    # A transom or a mullion, which returns all rays, is no pane.
    bars = [inner.sum(axis=axis, keepdims=True) for axis in (0, 1)]
    is_bar = np.logical_or(*(returns_at_face(bar) > bar[..., THROUGH] for bar in bars))
    sheet = find_sheet(inner * ~is_bar[..., None], rules)
    # A pane shows all over; what few rows show is the edge of a sill or of a head.
    if sheet is None or sheet.behind_m <= 0 or sheet.rows < 0.25 * min(inner.shape[1], sheet.returns):
        return float("nan")
    return sheet.behind_m


def without_panes(faces: TracedFaces, windows: Windows) -> TracedFaces:
    """The faces without the rays that count as passed within known windows: what glass, bars or posters return there is not beyond
    the wall.
    """
    if not len(windows):
        return faces
    ended, near_m = faces.evidence.ended.copy(), -LAYERS_M[DEEP + 1]
    for w, face in enumerate(segments(faces.walls)):
        own = faces.columns(w)
        for k in range(len(windows)):
            if is_beside(face, windows.ends[k], windows.normal[k], near_m):
                low, high = np.clip(np.sort(face.place_m(windows.ends[k])), 0.0, face.length_m)
                columns = slice(own.start + int(low / CELL_M), own.start + int(np.ceil(high / CELL_M)))
                rows = slice(cells_in(windows.bottom_m[k]), cells_in(windows.top_m[k]))
                on, passed = on_and_passed(faces.cells.counts[columns, rows])
                # A curtain before the pane stays.
                ended[columns, rows][passed > on] = 0.0
    return replace(faces, evidence=replace(faces.evidence, ended=ended))


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


def rays_through(windows: Windows, features: Features) -> Features:
    """The same scans with the rays alone that ended beyond a window."""
    return select_rays(features, _rays_through(lines_of(windows), Rays.of(features)))


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
