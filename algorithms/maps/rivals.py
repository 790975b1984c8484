"""The maps with which the paper compares its own: slices of the cloud, and single structures.

Returns of a scan are counted by cells of the ground when it is labelled, so that memory grows with
the building only (Fig. 6, Fig. 9c, d).
"""

from enum import StrEnum

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.model import Windows
from ffmap.algorithms.maps.free_space import Draft
from ffmap.algorithms.maps.furniture_free import draft_cells
from ffmap.algorithms.maps.grid import GridMap
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


def rival_returns(
    points_map: FloatArray, labelling: ScanLabelling
) -> tuple[FloatArray, UInt8Array]:
    """Choose the returns (n, 3) of a scan that occupy cells; without a ceiling, it has no slices.

    Returns their places (k, 3) in the map, at height 0, and the rivals (k,) in which they count, as
    places in `Rival`.
    """
    below_m, structures, samples = labelling.below_m, labelling.structures, labelling.lines.samples
    rows: list[IntArray] = [
        np.flatnonzero((below_m > _BELOW_CEILING_M) & (below_m < _BELOW_CEILING_M + _SLICE_M)),
        # Halfway up a return is as far from the floor as from the ceiling.
        np.flatnonzero(np.abs(labelling.height_m - below_m) < _SLICE_M),
    ]
    sample = np.arange(samples.shape[1])
    for structure in (structures.upmost, structures.bottommost):
        chosen = structure[structure >= 0]
        first, last = structures.first[chosen, None], structures.last[chosen, None]
        within = (sample >= first) & (sample <= last)
        rows.append(samples[structures.line[chosen]][within])
    places = points_map[np.concatenate(rows)]
    places[:, 2] = 0.0
    return places, np.repeat(np.arange(len(Rival), dtype=np.uint8), [len(own) for own in rows])


def draft_rival(rival: Rival, votes: VoxelVotes, frame: GridMap, windows: Windows) -> Draft:
    """Draw one of the maps.

    votes: of `rival_returns` in cells of the frame. windows: nothing behind them is free, as in the
    furniture-free map; the paper removed it by hand.
    """
    occupied = votes.counts[:, list(Rival).index(rival)] >= _HITS_MIN
    return draft_cells((votes.cube_index[occupied, :2] + 0.5) * frame.cell_m, frame, windows)
