"""Glazed fronts: panes that no wall's face tells of, as they reach from wall to wall, or their wall was seen by no scan.

Glass returns a small share of the rays that meet it, all over and from one sheet, and lets the others pass. An open passage
returns none, and what stands behind one returns all of them in some places and none in others.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from ffmap.algorithms.base.plan_index import pairs_near
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, lengthened, lengths_m, moved, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import FILLED, SUM, THROUGH, WallCells, with_neighbours
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import column_places, long_runs, runs, visited
from ffmap.algorithms.building.face_verdicts import (
    SAME_WAY,
    JudgedFaces,
    StandingWallsSettings,
    wall_directions,
)
from ffmap.algorithms.building.missed_walls import MissedWallsSettings
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, NO_WINDOWS, Walls, Windows, cells_in
from ffmap.algorithms.building.openings import OpeningRules, deepest_sheet_m, lies_on_sheet
from ffmap.algorithms.building.unexplained_lines import (
    both_sides,
    from_behind,
    straight_lines,
    unexplained_columns,
    unseen_faces,
)
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.building.windows import is_beside, join_windows


class GlassFrontsSettings(StepSettings):
    """Panes that no wall's face tells of."""

    width_min_m: float = Field(0.5, gt=0, description="Minimum width (m) of a pane that no wall's face tells of.")
    share_min: float = Field(
        0.01, gt=0, lt=0.5, description="Minimum share of the rays that meet it which such a pane returns."
    )
    share_max: float = Field(
        0.25,
        gt=0,
        le=0.5,
        description="Maximum share of the rays that meet it which such a pane returns; a grating or a rack returns more.",
    )
    patch_m: float = Field(0.2, gt=0, description="Height (m) of the patches of a pane of which each has to return some rays.")
    shown_min: float = Field(
        0.8, gt=0, le=1, description="Minimum share of the patches that tell in a pane's column which returned any."
    )
    pure_min: float = Field(
        0.7, gt=0, le=1, description="Minimum share of the returns from where most rays pass that lie on the pane's sheet."
    )
    patches_min: int = Field(2, ge=1, description="Minimum number of patches that tell in a pane's column.")
    at_once_max: float = Field(
        0.45,
        ge=0,
        le=1,
        description="Maximum share of a pane's returns from patches of which one scan returned most of the rays that met them: "
        "people return all.",
    )
    bridge_m: float = Field(0.4, ge=0, description="Maximum width (m) of a stretch of a pane in which too few rays met it to tell.")
    beyond_m: float = Field(
        0.5, ge=0, description="Length (m) beyond the ends of a line of returns over which a pane is looked for."
    )
    reveal_m: float = Field(
        0.5, ge=0, description="Maximum distance (m) of a pane behind the wall that it stands in, and from that wall along it."
    )
    bars_ratio: float = Field(
        4.0, gt=1, description="Ratio of the shares that neighbouring columns of a railing return: of a bar to a gap."
    )
    bars_apart_max_m: float = Field(
        0.3, gt=0, description="A railing's bars are less than this (m) apart in the mean; a window's are farther."
    )
    bars_sigma: float = Field(
        4.0, gt=0, description="Standard deviations by which they have to differ more than by the chance of single rays."
    )
    shelf_m: float = Field(
        0.6,
        ge=0,
        description="Maximum depth (m) of shelves: nobody glazes a wall, and a sheet this close before one is their boards' edges.",
    )
    other_pane_m: float = Field(
        0.6, gt=0, description="Maximum distance (m) from a known window of a pane that is taken for the same."
    )


@dataclass(frozen=True)
class GlassRules:
    """By what glazed fronts are told."""

    openings: OpeningRules
    standing: StandingWallsSettings
    fronts: GlassFrontsSettings
    missed: MissedWallsSettings


@dataclass(frozen=True)
class AllRays:
    """What all scans show together.

    path_map: (n, 2) the robot's places. trace: counts rays against faces, without those that ended beyond some windows; a return
    more than some centimetres behind a face counts as passed. scans: the same for all rays, scan by scan; those that meet
    no face may be left out.
    """

    votes: VoxelVotes
    path_map: FloatArray
    trace: Callable[[Walls, Windows], WallCells]
    scans: Callable[[Walls], Iterable[WallCells]]


@dataclass(frozen=True)
class _Pane:
    """A stretch of a face, as a single one, the window that it shows, and how far that is behind it."""

    face: Walls
    window: Windows
    behind_m: float


def find_glass_fronts(whole: Walls, judged: JudgedFaces, windows: Windows, rays: AllRays, rules: GlassRules) -> Windows:
    """The panes that no known window has: on lines of returns that no wall explains, and in faces that rays speak against.

    A pane returns some rays whenever they meet it; who walked by has left returns too, but all at once. Of panes that stand close
    together the one nearest to the robot's way counts. Behind a pane stands what it mirrors, of which it returns as small a share:
    what is seen through another pane has to be one without that. The windows lie on their panes.

    whole: the faces before they were judged.
    """
    standing, way = rules.standing, cKDTree(rays.path_map)
    place, weight, _ = unexplained_columns(rays.votes, judged.walls, judged.refused, rules.missed.explained_m)
    directions, gap_m = wall_directions(judged.walls, standing.direction_share_min), rules.openings.building.gap_m
    lines = straight_lines(place, weight, directions, rules.missed.half_thickness_m, gap_m)
    # Of a face that was cut, a part may be too short to tell, and the pane goes on where the face passes for a wall.
    in_faces = judged.refused.append(whole)
    candidates = both_sides(lines).append(in_faces).append(from_behind(in_faces))
    candidates = candidates.select(lengths_m(candidates.ends) >= rules.fronts.width_min_m)

    def panes(faces: Walls, known: Windows) -> list[_Pane]:
        if not len(faces):
            return []
        cells = rays.trace(faces, known)
        places = column_places(faces, cells.first, 0.0)
        # Where the robot drove no pane is, and the returns at a wall's face are that wall's, or a mullion's.
        of_walls = np.zeros(len(places), bool)
        of_walls[pairs_near(judged.walls, places, rules.missed.explained_m)[0]] = True
        return list(_panes(faces, cells, visited(places, rays.path_map, standing.robot_m), of_walls, rules))

    shown = panes(replace(candidates, ends=lengthened(candidates.ends, rules.fronts.beyond_m)), windows)
    # What shows at the edge of what is looked at is asked again where it lies: a pane behind its frame, or a wall at a slant.
    deepest_m = deepest_sheet_m(rules.openings)
    at_edge = [replace(pane.face, ends=pane.window.ends) for pane in shown if pane.behind_m >= deepest_m]
    shown = [pane for pane in shown if pane.behind_m < deepest_m]
    shown += panes(reduce(Walls.append, at_edge, NO_WALLS), windows)
    found: list[_Pane] = []
    for pane in sorted(shown, key=lambda p: float(way.query(p.face.ends[0].mean(axis=0))[0])):
        known = _concatenated([windows, *(p.window for p in found)])
        if len(new_fronts(pane.window, known, rules.fronts)) and not _is_shelf(pane.window, judged.walls, rules.fronts):
            found.append(pane)
    fronts = []
    for pane in found:
        others = _concatenated([p.window for p in found if p is not pane])
        hidden = any(_is_seen_through(front, rays.path_map, pane.window) for front in segments(others))
        if not hidden or panes(pane.face, windows.append(others)):
            fronts.append(pane.window)
    return _as_wide_as_seen(_lets_pass_always(_concatenated(fronts), rays, rules), shown, rules.missed.explained_m)


def _as_wide_as_seen(fronts: Windows, panes: list[_Pane], near_m: float) -> Windows:
    """The fronts with what other lines, or faces, show of them: each line ends where its own returns do."""
    more = [
        pane.window
        for pane in panes
        if any(is_beside(front, pane.window.ends[0], pane.window.normal[0], near_m) for front in segments(fronts))
    ]
    return join_windows(_concatenated([fronts, *more]), near_m, sill_m=np.inf)


def _concatenated(windows: Iterable[Windows]) -> Windows:
    return reduce(Windows.append, windows, NO_WINDOWS)


def _lets_pass_always(fronts: Windows, rays: AllRays, rules: GlassRules) -> Windows:
    """The fronts that return few of the rays that meet a patch at once: of who stood there for a while all returned, or none."""
    if not len(fronts):
        return fronts
    settings = rules.fronts
    faces = unseen_faces(fronts.ends, fronts.normal, fronts.top_m)
    high = slice(FOOT_ROW, cells_in(rules.openings.building.door_height_min_m))
    total = rays.trace(faces, NO_WINDOWS)
    clear = (total.counts[:, high, THROUGH] > total.counts[:, high, FILLED])[..., None]
    returned, at_once = np.zeros(len(fronts)), np.zeros(len(fronts))
    size = cells_in(settings.patch_m)
    for cells in rays.scans(faces):
        met = cells.counts[:, high, [FILLED, THROUGH]] * clear
        for k in range(len(fronts)):
            own = met[cells.first[k] : cells.first[k + 1]]
            columns, rows = own.shape[0] // size, own.shape[1] // size
            patches = own[: columns * size, : rows * size].reshape(columns, size, rows, size, 2).sum(axis=(1, 3))
            filled, passed = np.moveaxis(patches, 2, 0)
            tells = filled + passed >= rules.openings.openings.expected_min
            returned[k] += filled[tells].sum()
            at_once[k] += filled[tells & (filled > passed)].sum()
    return fronts.select(at_once <= settings.at_once_max * returned)


def _is_seen_through(front: Segment, path_map: FloatArray, window: Windows) -> bool:
    """Whether a single window is seen through a front from anywhere on the robot's way (n, 2)."""
    middle = window.ends[0].mean(axis=0)
    before_m, behind_m = front.before_m(path_map), float(front.before_m(middle))
    if behind_m >= -CELL_M:
        return False
    origin, before_m = path_map[before_m > 0.0], before_m[before_m > 0.0, None]
    return bool(front.beside(origin + before_m / (before_m - behind_m) * (middle - origin)).any())


def _is_shelf(front: Windows, walls: Walls, settings: GlassFrontsSettings) -> bool:
    """Whether most of a single front has a wall close behind it, seen from the same side."""
    (own,) = segments(front)
    return any(
        0.0 < -own.before_m(ends.mean(axis=0)) < settings.shelf_m and own.shared_m(ends) > 0.5 * own.length_m
        for ends in walls.ends[walls.normal @ own.normal > SAME_WAY]
    )


def _panes(faces: Walls, cells: WallCells, driven: BoolArray, of_walls: BoolArray, rules: GlassRules) -> Iterator[_Pane]:
    """The stretches of faces that are panes. driven, of_walls: (columns,) where none can be; see `_sheets`."""
    for w, face in enumerate(segments(faces)):
        own = slice(int(cells.first[w]), int(cells.first[w + 1]))
        counts = cells.counts[own].astype(np.float64)
        for first, after, behind_m in _sheets(counts, driven[own], of_walls[own], rules):
            ends = face.at(CELL_M * np.array([first, after]))
            rows = counts[first:after].sum(axis=0)
            clear = np.flatnonzero(rows[:, THROUGH] > rows[:, FILLED])
            if not len(clear):
                continue  # its bars return more rays than it lets pass
            on_pane, between_m = ends - behind_m * face.normal, (CELL_M * clear[[0]], CELL_M * (clear[[-1]] + 1))
            window = Windows(on_pane[None], face.normal[None], *between_m, np.zeros(1))
            yield _Pane(replace(faces.one(w), ends=ends[None]), window, behind_m)


def _sheets(
    counts: FloatArray, driven: BoolArray, of_walls: BoolArray, rules: GlassRules
) -> Iterator[tuple[int, int, float]]:
    """The first column of each pane in a face, the one after its last, and how far it stands behind the face.

    counts: (c, rows, 4). driven: (c,) where the robot drove. of_walls: (c,) what is a known wall's, which may be a pane's mullion.
    """
    fronts = rules.fronts
    inner = counts[:, FOOT_ROW : cells_in(rules.openings.building.door_height_min_m)]
    rows = cells_in(fronts.patch_m)
    near = with_neighbours(inner)[:, : inner.shape[1] // rows * rows]
    patches = near.reshape(len(near), -1, rows, 4).sum(axis=2)
    passes = patches[..., THROUGH] > patches[..., FILLED]
    clear = patches * passes[..., None]
    on_pane = clear * lies_on_sheet(clear, rules.openings)[..., None]
    met, returned = clear[..., FILLED] + clear[..., THROUGH], on_pane[..., FILLED]
    share = returned.sum() / max(met.sum(), 1.0)
    if share < fronts.share_min:
        return
    tells = share * met >= rules.openings.openings.expected_min
    asked, shown = tells.sum(axis=1), (tells & (returned > 0)).sum(axis=1)
    is_told = asked >= fronts.patches_min
    bar = cells_in(rules.openings.openings.bar_max_m)
    no_pane = driven | of_walls | (is_told & (shown < 0.5 * asked))
    sure = is_told & (shown >= fronts.shown_min * asked) & ~no_pane
    sure = long_runs(sure, 1, bridge=cells_in(fronts.bridge_m)) & ~no_pane
    # A wall takes what is close beside it too.
    mullion = long_runs(sure, 1, bridge=bar + 2 * cells_in(rules.missed.explained_m)) & of_walls & ~driven
    sure &= long_runs(sure | mullion, cells_in(fronts.width_min_m), 0)
    no_pane &= ~mullion
    # Where too few rays met it to tell, it goes on up to what returns them all.
    goes_on = sure | (passes.sum(axis=1) > 0.5 * np.count_nonzero(patches[..., [FILLED, THROUGH]].any(axis=2), axis=1))
    for first, after in runs(long_runs(goes_on & ~no_pane, 1, bridge=bar) & ~no_pane):
        told = first + np.flatnonzero(sure[first:after])
        sheet, returns = on_pane[told].sum(axis=(0, 1)), float(clear[told, :, FILLED].sum())
        is_pure = sheet[FILLED] >= fronts.pure_min * returns
        is_glass = fronts.share_min <= sheet[FILLED] / max(met[told].sum(), 1.0) <= fronts.share_max
        shows = shown[told].sum() >= fronts.shown_min * asked[told].sum()
        if is_pure and is_glass and shows and not _has_bars(inner[told], share, rules):
            yield first, after, -float(sheet[SUM] / sheet[FILLED])


def _has_bars(counts: FloatArray, share: float, rules: GlassRules) -> bool:
    """Whether columns (c, rows, 4) are those of a railing: its bars return rays, the gaps between them hardly any, in turns.

    A pane returns about the same beside. share: of the rays that meet it what a pane would return.
    """
    clear = counts * (counts[..., THROUGH] > counts[..., FILLED])[..., None]
    returned = clear[..., FILLED].sum(axis=1)
    met = returned + clear[..., THROUGH].sum(axis=1)
    tells = share * met >= rules.openings.openings.expected_min
    returned, met = returned[tells], met[tells]
    here, next_ = returned[:-1] * met[1:], returned[1:] * met[:-1]
    # The rays that return vary by chance.
    noise = np.sqrt(met[:-1] * met[1:] * (returned[:-1] + returned[1:]))
    steps = np.abs(here - next_) > rules.fronts.bars_sigma * noise
    steps &= np.maximum(here, next_) > rules.fronts.bars_ratio * np.minimum(here, next_)
    # There is a step at both sides of each bar.
    return bool(2.0 * len(steps) * CELL_M < rules.fronts.bars_apart_max_m * np.count_nonzero(steps))


def new_fronts(fronts: Windows, known: Windows, settings: GlassFrontsSettings) -> Windows:
    """The fronts most of which is no known window's pane, seen from the same side."""
    is_new = np.ones(len(fronts), bool)
    for k, own in enumerate(segments(fronts)):
        for ends in known.ends[known.normal @ own.normal > 0.0]:
            is_near = abs(float(own.before_m(ends.mean(axis=0)))) < settings.other_pane_m
            is_new[k] &= not (is_near and own.shared_m(ends) > 0.5 * own.length_m)
    return fronts.select(is_new)


def set_in_walls(fronts: Windows, walls: Walls, settings: GlassFrontsSettings) -> Windows:
    """The fronts, each in the face of the wall beside it, behind which its pane stands; in its pane where no wall is."""
    depth_m = np.zeros(len(fronts))
    for k, own in enumerate(segments(fronts)):
        for ends in walls.ends[walls.normal @ own.normal > SAME_WAY]:
            before_m = float(own.before_m(ends.mean(axis=0)))
            if depth_m[k] < before_m < settings.reveal_m and own.shared_m(ends) > -settings.reveal_m:
                depth_m[k] = before_m
    return replace(fronts, ends=moved(fronts.ends, fronts.normal, depth_m), pane_m=depth_m)
