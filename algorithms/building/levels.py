"""The level and sloping surfaces of the building, found in the votes of all scans together.

Each plan cell has two layers: its lowest return and its highest one. Each layer is divided once
into patches: connected cells on local planes. A patch is classified by its width, its slope and its
height above the floor that scans found:

    layer     width      slope         height above the floor   becomes
    lowest    ≥ 1.2 m    –             −4 to 30 cm              floor: platforms, rooms beyond
    highest   ≥ 0.8 m    < 0.15        > 2.2 m                  ceiling
    highest   ≥ 0.8 m    0.15 to 1.8   > 1.0 m                  ceiling: roofs, stairs
    any       –          –             others                   unchanged

Where two patches of floor meet in a step lies its front. What hangs below a ceiling is part of it
if its sides reach up to the ceiling: beams, coffers, soffits. What lies more than a step below the
floor is outside: the storey below.
"""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.heights import (
    WINDOW,
    HeightMap,
    Patches,
    PlanGrid,
    Surface,
    find_patches,
    highest_around,
    level_parts,
    lowest_around,
    nearest_known,
)

_FLAT_M = 0.025
"""Maximum RMS distance of returns from their plane: range noise of lidars, and drift."""
_SLOPING = 0.15
"""Minimum rise per metre of a sloping ceiling; ramps and drift are below."""
_BESIDE = 9
"""Edge (cells) of the window in which a higher ceiling is beside a lower one."""
_DROP_MIN_M = 0.08
"""Minimum height of what hangs below a ceiling: two surfaces' thicknesses."""
_GAP_M = 0.15
"""Maximum gap between the returns of one upright side."""
_SIDES_MIN, _CLOSED_MIN = 5, 0.6
"""Minimum number of cells that show a drop's sides, and share of those that reach the ceiling."""
_SLIT_MAX_M = 0.65
"""Maximum distance from its wall of a duct that runs along it."""


class LevelsSettings(StepSettings):
    """Floors, ceilings and beams that only all scans together show."""

    cell_m: float = Field(0.1, gt=0, description="Edge (m) of the plan cells.")
    votes_min: int = Field(3, ge=1, description="Minimum votes for a voxel's label to be known.")
    margin_m: float = Field(
        0.04, gt=0, description="Half thickness (m) of a surface: 3 σ of range noise, and drift."
    )
    ceiling_min_m: float = Field(
        2.2, gt=0, description="Minimum height (m) of a level ceiling: rooms in building codes."
    )
    knee_min_m: float = Field(
        1.0, gt=0, description="Minimum height (m) of a sloping ceiling: where living area begins."
    )
    slope_max: float = Field(
        1.8, gt=0, description="Maximum rise per metre of a sloping ceiling: roofs of up to 60°."
    )
    ceiling_width_m: float = Field(
        0.8, gt=0, description="Minimum width (m) of a ceiling: ducts and cupboards are narrower."
    )
    step_min_m: float = Field(
        0.06, gt=0, description="Minimum height (m) of a step: sills and carpets are lower."
    )
    step_max_m: float = Field(
        0.30, gt=0, description="Maximum height (m) of a step: stools and seats are higher."
    )
    platform_width_m: float = Field(
        1.2, gt=0, description="Minimum width (m) of a platform: pallets are 0.8, mattresses 0.9."
    )
    headroom_m: float = Field(
        1.9, gt=0, description="Minimum height (m) of a beam above the floor: low door heads."
    )
    lamp_max_m: float = Field(
        2.0, gt=0, description="Maximum length (m) of a lamp: tubes are at most 1.5 m long."
    )


def map_levels(votes: VoxelVotes, settings: LevelsSettings) -> tuple[HeightMap, ...]:
    """Find all surfaces of the building, in the order in which they correct labels.

    votes: of the scans' labels. Surfaces without any cell are left out.
    """
    layers = Layers.of(votes, settings, settings.cell_m)
    ceiling = map_ceiling(layers)
    floor = map_floor(layers)
    # Far away, returns are far apart.
    distant_floor = map_floor(Layers.of(votes, settings, 2.0 * settings.cell_m))
    fronts = map_step_fronts(layers.corrected_by(floor).corrected_by(distant_floor))
    drops = map_drops(layers.corrected_by(ceiling), ceiling)
    levels = (ceiling, floor, distant_floor, fronts, drops, map_storey_below(layers))
    return tuple(level for level in levels if level.known.any())


@dataclass(frozen=True)
class Layers:
    """The votes over a plan grid.

    ground_m: (rows, columns) height of the nearest floor that scans found, NaN without any.
    """

    votes: VoxelVotes
    settings: LevelsSettings
    grid: PlanGrid
    ground_m: FloatArray

    @classmethod
    def of(cls, votes: VoxelVotes, settings: LevelsSettings, cell_m: float) -> "Layers":
        """Cover all voxels. votes: of the scans' labels."""
        grid = PlanGrid.around(votes.mean_position, cell_m, settings.ceiling_width_m)
        floor = votes.seen(settings.votes_min) & (votes.label == Label.FLOOR)
        floor_m = grid.heights(votes.mean_position[floor], 0.5)
        return cls(votes, settings, grid, floor_m[nearest_known(np.isfinite(floor_m))[1]])

    def labelled(self, *labels: Label, votes_min: int = 1) -> FloatArray:
        """(n, 3) positions of the voxels with one of some labels."""
        chosen = self.votes.seen(votes_min) & np.isin(self.votes.label, labels)
        return self.votes.mean_position[chosen]

    def above_m(self, position: FloatArray) -> FloatArray:
        """(n,) heights of positions (n, 3) above the floor."""
        return np.asarray(position[:, 2] - self.ground_m[self.grid.cells(position)])

    def heights(self, label: Label) -> FloatArray:
        """(rows, columns) median height of the voxels that scans agree on, NaN without."""
        return self.grid.heights(self.labelled(label, votes_min=self.settings.votes_min), 0.5)

    def patches(self, places: FloatArray) -> Patches:
        """Divide a layer (rows, columns, 3) into patches."""
        return find_patches(
            self.grid, places, _FLAT_M, self.settings.margin_m, self.settings.slope_max
        )

    def corrected_by(self, level: HeightMap) -> "Layers":
        """Move the votes of voxels on a surface from the label that it corrects to its own."""
        votes, surface = self.votes, level.surface
        wrong = level.label_of(votes.mean_position, votes.label) != votes.label
        counts = votes.counts.copy()
        counts[wrong, surface.label] += counts[wrong, surface.taken_for]
        counts[wrong, surface.taken_for] = 0
        return replace(self, votes=replace(votes, counts=counts))


def map_ceiling(layers: Layers) -> HeightMap:
    """Map the highest patches that are broad, and the ceilings of scans, which may be narrow."""
    settings, grid = layers.settings, layers.grid
    over = layers.labelled(Label.CEILING, Label.CLUTTER, Label.WALL)
    over = over[layers.above_m(over) > settings.knee_min_m]
    patches = layers.patches(grid.places(over, 1.0))
    above_m = patches.medians(patches.height_m - layers.ground_m)
    high = (above_m > settings.ceiling_min_m) | (patches.medians(patches.slope) > _SLOPING)
    known = (high & (patches.width_m >= settings.ceiling_width_m))[patches.number]
    height_m = np.where(known, patches.height_m, layers.heights(Label.CEILING))
    away, nearest = nearest_known(np.isfinite(height_m))
    sloping = (known & (patches.slope > _SLOPING))[nearest]
    # A level ceiling continues above what is as wide as a duct, a sloping one within a window.
    height_m = np.where(sloping, patches.height_m, height_m[nearest])
    reach_m = np.where(sloping, 0.5 * WINDOW * grid.cell_m, settings.ceiling_width_m)
    height_m[away * grid.cell_m > reach_m] = np.nan
    within_cell_m = np.where(sloping, 0.5 * grid.cell_m * patches.slope, 0.0)
    return grid.map(Surface.CEILING, height_m, settings.margin_m + within_cell_m)


def map_floor(layers: Layers) -> HeightMap:
    """Map the lowest patches that are broad and at most a step above the floor of scans."""
    settings, grid = layers.settings, layers.grid
    low = layers.labelled(Label.FLOOR, Label.CLUTTER)
    places = grid.places(low[layers.above_m(low) > -settings.margin_m], 0.0)
    # Where scans found the floor, what else is at its height is the foot of furniture.
    found = np.isfinite(layers.heights(Label.FLOOR))
    places[nearest_known(found)[0] * grid.cell_m < 1.5 * settings.cell_m] = np.nan
    patches = layers.patches(places)
    above_m = patches.medians(patches.height_m - layers.ground_m)
    broad = (patches.width_m >= settings.platform_width_m) & (above_m < settings.step_max_m)
    height_m = np.where(broad[patches.number], patches.height_m, np.nan)
    return grid.map(Surface.FLOOR, height_m, settings.margin_m)


def map_step_fronts(layers: Layers) -> HeightMap:
    """Map the upright fronts between two broad patches of floor. layers: with all floors."""
    settings, grid = layers.settings, layers.grid
    patches = layers.patches(grid.places(layers.labelled(Label.FLOOR), 0.5))
    broad = (patches.width_m >= settings.platform_width_m)[patches.number]
    height_m = np.where(broad, patches.height_m, np.nan)
    number = np.where(broad, patches.number, np.nan)
    low_m, high_m = lowest_around(height_m, WINDOW), highest_around(height_m, WINDOW)
    step = lowest_around(number, WINDOW) < highest_around(number, WINDOW)
    step &= (high_m - low_m > settings.step_min_m) & (high_m - low_m < settings.step_max_m)
    half_m = np.where(step, 0.5 * (high_m - low_m), np.nan)
    return grid.map(Surface.STEP_FRONT, low_m + half_m, half_m)


def map_storey_below(layers: Layers) -> HeightMap:
    """Map what lies more than a step below the floor: the storey below, seen down a stairwell."""
    top_m = layers.ground_m - layers.settings.step_max_m
    position = layers.votes.mean_position
    lower = position[position[:, 2] < top_m[layers.grid.cells(position)]]
    low_m = layers.grid.heights(lower, 0.0) - layers.settings.margin_m
    return layers.grid.map(Surface.STOREY_BELOW, 0.5 * (low_m + top_m), 0.5 * (top_m - low_m))


def map_drops(layers: Layers, ceiling: HeightMap) -> HeightMap:
    """Map beams and soffits: what hangs below the ceiling and closes up to it.

    The topmost piece of each cell hangs if it ends below the ceiling. Connected cells of like
    undersides are a part. A part is built if its sides reach the ceiling, and if a wall holds it or
    it is longer than lamps. What runs along a wall without contact all along is a duct.

    layers: with the ceiling.
    """
    settings, grid, layer_m = layers.settings, layers.grid, layers.votes.voxel_m
    ceiling_m = 0.5 * (ceiling.low_m + ceiling.high_m)
    sloping = ceiling.high_m - ceiling.low_m > 2.0 * settings.margin_m + 1e-6
    top_m = np.where(sloping, ceiling_m, highest_around(ceiling_m, WINDOW))
    over = layers.labelled(Label.CEILING, Label.CLUTTER)
    low_m, high_m = _topmost(grid, over[top_m[grid.cells(over)] - over[:, 2] > 0.5 * layer_m])
    hangs = (top_m - low_m > _DROP_MIN_M) & (low_m - layers.ground_m > settings.headroom_m)
    wall = layers.labelled(Label.WALL)
    wall = wall[wall[:, 2] < top_m[grid.cells(wall)]]
    walls = grid.heights(wall, 0.0) - layers.ground_m < settings.headroom_m
    parts = level_parts(hangs, low_m, 2.0 * _FLAT_M)

    def count(cells: BoolArray) -> IntArray:
        return np.bincount(parts[hangs & cells], minlength=parts.max() + 1)

    sides = ~walls & (high_m - low_m > layer_m)
    off_wall_m = nearest_known(walls)[0] * grid.cell_m
    seen, holding = count(sides), count(off_wall_m < 2.0 * grid.cell_m)
    closed = count(sides & (top_m - high_m < 2.0 * layer_m)) > _CLOSED_MIN * seen
    boxes = ndimage.find_objects(parts)
    length = np.array([0, *(np.hypot(r.stop - r.start, c.stop - c.start) for r, c in boxes)])
    is_duct = (count(off_wall_m < _SLIT_MAX_M) > 0.8 * count(hangs)) & (holding < length)
    long = length * grid.cell_m > settings.lamp_max_m
    built = (seen >= _SIDES_MIN) & closed & ((holding > 0) | long) & ~is_duct
    low_m = lowest_around(np.where(built[parts], low_m, np.nan), 3) - settings.margin_m
    return grid.map(Surface.CEILING_DROP, 0.5 * (low_m + top_m), 0.5 * (top_m - low_m))


def _topmost(grid: PlanGrid, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest position (rows, columns) of each cell's topmost piece, down to a gap."""
    cell = np.ravel_multi_index(grid.cells(position), grid.shape)
    order = np.lexsort((-position[:, 2], cell))
    cell, height_m = cell[order], position[order, 2]
    first = np.diff(cell, prepend=-1) != 0
    piece = np.cumsum(first | (-np.diff(height_m, prepend=np.inf) > _GAP_M))
    starts = np.flatnonzero(first)
    top = piece == np.repeat(piece[starts], np.diff(starts, append=len(cell)))
    low_m, high_m = np.full(grid.shape, np.nan), np.full(grid.shape, np.nan)
    np.fmin.at(low_m.reshape(-1), cell[top], height_m[top])
    high_m.flat[cell[starts]] = height_m[starts]
    return low_m, high_m


def of_rooms(ceiling: FloatArray, settings: LevelsSettings) -> BoolArray:
    """(n,) voxels of ceiling (n, 3) that are a room's: all but what is narrow and hangs.

    A scan labels the underside of a duct, or of a board over a wardrobe, as ceiling if it is at the
    height of another room's ceiling. What ends there is no wall.
    """
    grid = PlanGrid.around(ceiling, settings.cell_m, 0.0)
    lowest = grid.places(ceiling, 0.0)
    patches = find_patches(grid, lowest, _FLAT_M, settings.margin_m, settings.slope_max)
    narrow = (patches.width_m < settings.ceiling_width_m)[patches.number]
    beside_m = highest_around(grid.heights(ceiling, 0.5), _BESIDE)
    narrow &= lowest[..., 2] < beside_m - _DROP_MIN_M
    narrow_m = np.where(narrow, lowest[..., 2], np.nan)[grid.cells(ceiling)]
    return ~(np.abs(ceiling[:, 2] - narrow_m) < settings.margin_m)
