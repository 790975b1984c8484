"""The maps with which the paper compares its own: slices of the cloud, and single structures.

Returns of a scan are counted by cells of the ground when it is labelled, so that memory grows with
the building only (Fig. 6, Fig. 9c, d).
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.model import Windows
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes
from ffmap.algorithms.maps.free_space import Draft
from ffmap.algorithms.maps.furniture_free import draft_cells
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.labelling import ScanLabelling

_BELOW_CEILING_M = 0.5
"""Distance (m) of the upper slice below the ceiling. IV.C."""
_SLICE_M = 0.1
"""Thickness (m) of both slices. IV.C."""
_HITS_MIN = 3
"""Minimum returns that occupy a cell. IV.C."""


class Rival(StrEnum):
    """The maps beside the furniture-free map, in the order of the votes' codes."""

    BELOW_CEILING = "below_ceiling"  # a slice close under the ceiling (Fig. 9c)
    MIDDLE = "middle"  # a slice halfway up, as of a 2-D lidar: the normal map (Fig. 9d)
    UPMOST = "upmost"  # the highest vertical structure of each point line (Fig. 6a)
    BOTTOMMOST = "bottommost"  # the lowest (Fig. 6b)


@dataclass(frozen=True)
class RivalReturns:
    """The returns of a scan that occupy cells of the rivals.

    row: (k,) int32 return of the scan. rival: (k,) uint8 rival in which it counts, by its place in
    `Rival`.
    """

    row: IntArray
    rival: UInt8Array

    @classmethod
    def of(cls, points_level: FloatArray, labelling: ScanLabelling) -> "RivalReturns":
        """Choose returns (n, 3) of a scan; without a ceiling, a scan has no slices."""
        below_m = below_ceiling(points_level, labelling.ceiling_planes)
        structures, samples = labelling.structures, labelling.lines.samples
        rows: dict[Rival, IntArray] = {
            Rival.BELOW_CEILING: np.flatnonzero(
                (below_m > _BELOW_CEILING_M) & (below_m < _BELOW_CEILING_M + _SLICE_M)
            ),
            # Halfway up a return is as far from the floor as from the ceiling.
            Rival.MIDDLE: np.flatnonzero(np.abs(labelling.height_m - below_m) < _SLICE_M),
        }
        sample = np.arange(samples.shape[1])
        for rival, structure in (
            (Rival.UPMOST, structures.upmost),
            (Rival.BOTTOMMOST, structures.bottommost),
        ):
            chosen = structure[structure >= 0]
            first, last = structures.first[chosen, None], structures.last[chosen, None]
            within = (sample >= first) & (sample <= last)
            rows[rival] = samples[structures.line[chosen]][within]
        row = np.concatenate([rows[rival] for rival in Rival]).astype(np.int32)
        codes = np.arange(len(Rival), dtype=np.uint8)
        return cls(row, np.repeat(codes, [len(rows[rival]) for rival in Rival]))


class RivalCounter:
    """Counts returns by cell for each rival; the votes of blocks of scans add up."""

    def __init__(self, cell_m: float) -> None:
        self._table = VoxelTable(cell_m, len(Rival))

    def add(self, points_map: FloatArray, returns: RivalReturns) -> None:
        """Count one scan with its returns at points_map (n, 3)."""
        flat = np.zeros((len(returns.row), 3), points_map.dtype)
        flat[:, :2] = points_map[returns.row, :2]
        self._table.add(flat, returns.rival)

    def votes(self) -> VoxelVotes:
        """Returns by cell (a voxel with index 0 along z) and rival, so far."""
        return self._table.votes()


def draft_rival(rival: Rival, votes: VoxelVotes, frame: GridMap, windows: Windows) -> Draft:
    """Draw one of the maps.

    votes: sums of `RivalCounter.votes`. windows: nothing behind them is free, as in the
    furniture-free map; the paper removed it by hand.
    """
    occupied = votes.counts[:, list(Rival).index(rival)] >= _HITS_MIN
    return draft_cells((votes.cube_index[occupied, :2] + 0.5) * frame.cell_m, frame, windows)
