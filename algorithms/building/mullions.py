"""The mullions of glazed fronts, which stand out of their panes further than a wall's face scatters."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import Segment, lengthened, moved, segments
from ffmap.algorithms.building.cells import FILLED, THROUGH, WallCells, depth_moments
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import runs
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_MULLIONS,
    ON_FACE_M,
    Mullions,
    Walls,
    Windows,
    cells_in,
)
from ffmap.algorithms.building.openings import OpeningRules
from ffmap.algorithms.building.unexplained_lines import unseen_faces
from ffmap.algorithms.building.windows import is_beside

_PANE_MAX_M = 0.1  # Maximum distance of a pane behind its wall's face: of a deeper one the mullions stand within that
_OUT_MAX_M = 0.2  # Maximum distance before its pane of what a mullion returns
_OFF_PANE_M = 0.03  # Closer to the pane lies what the pane returns itself
_WIDTH_MAX_M = 0.1  # Maximum width: those of curtain walls are 5 to 8 cm wide, a curtain drawn aside is wider
_COVERED_MIN = 0.2  # Share of a column's rays that return where a mullion covers some of it
_UPRIGHT_MIN = 0.8  # Share of a pane's height over which they do


def find_mullions(
    windows: Windows, trace: Callable[[Walls], WallCells], rules: OpeningRules
) -> Mullions:
    """What parts the panes of glazed fronts and stands out of them.

    From foot to head a mullion returns rays; it is narrow, and on either side of it is a pane. Furniture is lower or wider, and
    what stands at the end of a pane, a curtain drawn aside or an open leaf, has no pane on its other side.

    trace: counts rays against faces, as deep behind them as the settings say.
    """
    is_front = (windows.pane_m < _PANE_MAX_M) & (windows.bottom_m <= rules.openings.lower_rail_max_m)
    fronts = windows.select(is_front)
    if not len(fronts):
        return NO_MULLIONS
    fronts = replace(fronts, ends=moved(fronts.ends, fronts.normal, -fronts.pane_m))
    panes = tuple(segments(fronts))
    # Rays are asked of a plane half way to the farthest that a mullion may stand out, about which cells tell distances. A pane ends
    # at its mullions.
    plane_m = 0.5 * _OUT_MAX_M
    wide = lengthened(fronts.ends, _WIDTH_MAX_M + 2.0 * CELL_M)
    faces = unseen_faces(moved(wide, fronts.normal, np.full(len(wide), plane_m)), fronts.normal, fronts.top_m)
    cells = trace(faces)
    found = NO_MULLIONS
    for k in range(len(fronts)):
        pane = Segment.between(wide[k], fronts.normal[k])
        rows = slice(max(cells_in(fronts.bottom_m[k]), FOOT_ROW), cells_in(fronts.top_m[k]))
        counts = cells.of(k).counts[:, rows].astype(np.float64)
        for first, after in _uprights(counts):
            if not all(_shows_at(column, pane, panes) for column in (first - 1.5, after + 1.5)):
                continue
            if _shows_at(0.5 * (first + after), pane, segments(found)):
                continue  # The pane on its other side has shown it.
            before_m, variance = depth_moments(counts[first:after].sum(axis=(0, 1)))
            # Its front returns most; what its sides return lies farther back.
            front_m = min(plane_m + float(before_m + np.sqrt(variance)), _OUT_MAX_M)
            ends, between_m = pane.at(CELL_M * np.array([first, after])), (fronts.bottom_m[[k]], fronts.top_m[[k]])
            found = found.append(Mullions(ends[None], pane.normal[None], *between_m, np.array([front_m])))
    return found


def _shows_at(column: float, pane: Segment, stretches: Iterable[Segment]) -> bool:
    """Whether one of some stretches, seen from the same side as a pane, is less than a column from a place on that."""
    around = pane.at(CELL_M * np.array([column - 1.0, column + 1.0]))
    return any(is_beside(one, around, pane.normal, ON_FACE_M) for one in stretches)


def _uprights(counts: FloatArray) -> list[tuple[int, int]]:
    """The first of the columns (c, rows, 4) of each mullion, and the one after its last."""
    filled, passed = counts[..., FILLED], counts[..., THROUGH]
    returns = np.mean(filled > _COVERED_MIN * (filled + passed), axis=1) >= _UPRIGHT_MIN
    # A column at either edge is covered in part.
    return [(first, after) for first, after in runs(returns) if after - first <= cells_in(_WIDTH_MAX_M) + 1]
