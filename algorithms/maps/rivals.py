"""The maps that the paper compares its own with: slices of the cloud, and single kinds of structure (Fig. 6, Fig. 9c, d).

What they need of a scan is counted by cells of the ground as soon as it is labelled, so that it grows with the building.
"""

from enum import StrEnum

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, IntArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import Windows
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes
from ffmap.algorithms.maps.grid import Draft, GridMapSettings, draft_cells
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.labelling import ScanLabelling


class Rival(StrEnum):
    """The maps beside the furniture-free one, in the order of the votes' codes."""

    BELOW_CEILING = "below_ceiling"  # a slice close under the ceiling (Fig. 9c)
    MIDDLE = "middle"  # a slice halfway up, as of a 2-D lidar: the normal map (Fig. 9d)
    UPMOST = "upmost"  # the highest vertical structure of each point line (Fig. 6a)
    BOTTOMMOST = "bottommost"  # the lowest (Fig. 6b)


class RivalMapsSettings(StepSettings):
    """The maps that the paper compares with (paper, IV.C, Fig. 9c and 9d; Fig. 6)."""

    below_ceiling_m: float = Field(0.5, ge=0, description="Distance (m) of the upper slice below the ceiling. IV.C.")
    slice_m: float = Field(0.1, gt=0, description="Thickness (m) of both slices. IV.C.")
    hits_min: int = Field(3, ge=1, description="Minimum returns that occupy a cell. IV.C.")


class RivalCounter:
    """Counts returns by cell for each rival; one for each block of scans, whose votes add up."""

    def __init__(self, cell_m: float, settings: RivalMapsSettings) -> None:
        self._settings = settings
        self._table = VoxelTable(cell_m, len(Rival))

    def add(self, placed: PlacedScan, labelling: ScanLabelling) -> None:
        """Count one scan. A slice needs a ceiling: a scan that saw none has none."""
        below_m = below_ceiling(placed.points_level, labelling.ceiling_planes)
        upper_m, slice_m = self._settings.below_ceiling_m, self._settings.slice_m
        self._count(Rival.BELOW_CEILING, placed, (below_m > upper_m) & (below_m < upper_m + slice_m))
        # Halfway up a return is as far from the floor as from the ceiling.
        self._count(Rival.MIDDLE, placed, np.abs(labelling.height_m - below_m) < slice_m)
        structures = labelling.structures
        for rival, chosen in ((Rival.UPMOST, structures.upmost), (Rival.BOTTOMMOST, structures.bottommost)):
            chosen = chosen[chosen >= 0]
            first, last = structures.first[chosen], structures.last[chosen]
            sample = np.arange(labelling.lines.samples.shape[1])
            within = (sample >= first[:, None]) & (sample <= last[:, None])
            self._count(rival, placed, labelling.lines.samples[structures.line[chosen]][within])

    def _count(self, rival: Rival, placed: PlacedScan, chosen: BoolArray | IntArray) -> None:
        points = np.asarray(placed.to_map(placed.points_level[chosen]))
        flat = np.pad(points[:, :2], ((0, 0), (0, 1)))
        self._table.add(flat, np.full(len(flat), list(Rival).index(rival), np.uint8))

    def votes(self) -> VoxelVotes:
        """Returns by cell (its cube with index 0 along z) and rival, so far."""
        return self._table.votes()


def draft_rival(
    rival: Rival,
    votes: VoxelVotes,
    windows: Windows,
    drive: Drive,
    grid: GridMapSettings,
    settings: RivalMapsSettings,
) -> Draft:
    """One of the maps as a grid, to be drawn like the furniture-free one but for what is occupied.

    votes: sums of `RivalCounter.votes`. windows: behind them nothing is free; the paper removed that by hand.
    """
    occupied = votes.counts[:, list(Rival).index(rival)] >= settings.hits_min
    return draft_cells(votes.cube_index[occupied, :2], windows, drive, grid)
