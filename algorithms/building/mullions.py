"""The mullions of glazed fronts, which stand out of their panes further than a wall's face scatters."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import Segment, lengthened, segments
from ffmap.algorithms.building.face_columns import runs
from ffmap.algorithms.building.model import CELL_M, NO_WINDOWS, BuildingSettings, Walls, Windows, cells_in
from ffmap.algorithms.building.openings import OpeningRules
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, THROUGH, WallCells, depth_moments
from ffmap.algorithms.building.unexplained_lines import unseen_faces
from ffmap.algorithms.building.windows import join_windows

_UPRIGHT_MIN = 0.75  # Share of a pane's height over which a mullion returns rays
_COVERED_MIN = 0.2  # Share of a column that it covers
_BEFORE_M = 0.1  # Before the pane: what stands as far before and behind this counts
_OFF_PANE_M = 0.03  # What returns closer to the pane is its own scatter


def find_mullions(
    windows: Windows, walls: Walls, trace: Callable[[Walls, BuildingSettings], WallCells], rules: OpeningRules
) -> Windows:
    """The mullions before the panes of windows, each as a window of its own whose face is the mullion's front.

    From foot to head a mullion returns the rays, it is no wider than a bar, and on either side of it is a pane, or the wall.
    Furniture and curtains are wider, or lower, and the edge of an open leaf has nothing beside it.

    trace: counts rays against faces, as deep behind them as the settings say.
    """
    before = windows.select(windows.pane_m < _BEFORE_M)  # Deeper ones stand within their wall's face.
    if not len(before):
        return NO_WINDOWS
    bar_m = rules.openings.bar_max_m
    to_front_m = (_BEFORE_M - before.pane_m)[:, None, None] * before.normal[:, None]
    # A pane ends at its mullions.
    ends = lengthened(before.ends + to_front_m, bar_m + CELL_M)
    faces = unseen_faces(ends, before.normal, before.top_m)
    cells = trace(faces, rules.building.model_copy(update={"near_m": _BEFORE_M - _OFF_PANE_M, "own_plane_m": 0.0}))
    found, known = NO_WINDOWS, [*segments(windows), *segments(walls)]
    for k, face in enumerate(segments(faces)):
        rows = slice(max(cells_in(before.bottom_m[k]), FOOT_ROW), cells_in(before.top_m[k]))
        counts = cells.of(k).counts[:, rows].astype(np.float64)
        for first, after in _uprights(counts, cells_in(bar_m)):
            before_m, variance = depth_moments(counts[first:after].sum(axis=(0, 1)))
            front_m = min(float(before_m + np.sqrt(variance)), _BEFORE_M)
            beside = face.at(CELL_M * np.array([first - 1.5, after + 1.5]))
            if not all(any(_is_at(one, place) for one in known) for place in beside):
                continue
            ends = face.at(CELL_M * np.array([first, after])) + front_m * face.normal
            own = before.select(np.array([k]))
            found = found.append(replace(own, ends=ends[None], pane_m=np.array([_BEFORE_M + front_m])))
    return join_windows(found, _BEFORE_M, sill_m=np.inf)


def _is_at(face: Segment, place: FloatArray) -> bool:
    """Whether a pane or a wall is close behind a place (2,)."""
    return bool(face.beside(place, CELL_M) and abs(face.before_m(place)) < _BEFORE_M + _OFF_PANE_M)


def _uprights(counts: FloatArray, most: int) -> list[tuple[int, int]]:
    """Runs of at most `most` columns (c, rows, 4) of which most cells return rays, and that are passed on both sides.

    A mullion may cover a part of a column alone.
    """
    met = counts[..., FILLED] + counts[..., THROUGH]
    returns = counts[..., FILLED] > _COVERED_MIN * met
    returns = returns.sum(axis=1) >= _UPRIGHT_MIN * np.maximum((met > 0).sum(axis=1), 1)
    return [(first, after) for first, after in runs(returns) if after - first <= most and first > 0 and after < len(counts)]
