"""Closed doors whose leaf hangs before the wall on a rail, and slides along it.

Of all that stands flat before a wall a leaf alone is as wide and as high as doors are, reaches the floor, and lies at one depth: it
is thicker than any casing. A leaf that stands open against the wall does so too, but beside its doorway.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from ffmap.algorithms.base.known import row_medians
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.building.cells import FILLED, THROUGH, mean_before_m
from ffmap.algorithms.building.closed_doors import closed_door
from ffmap.algorithms.building.door_casings import DoorCasingsSettings
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import TracedFace, TracedFaces, runs
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_DOORS,
    NO_WINDOWS,
    ON_FACE_M,
    BuildingSettings,
    Doors,
    Windows,
    cells_in,
)
from ffmap.algorithms.scan.doors import DoorState


class HangingLeaf(NamedTuple):
    """One leaf before a face: how far, between which columns, and how high.

    pane: its lowest and highest row that let rays pass, if it is one. agreement: share of its returns that lie at its depth.
    """

    face: TracedFace
    before_m: float
    first: int
    after: int
    head_m: float
    pane: tuple[int, int] | None
    agreement: float


def find_hanging_leaves(
    faces: TracedFaces, building: BuildingSettings, settings: DoorCasingsSettings
) -> list[HangingLeaf]:
    """What hangs before the faces as leaves do. faces: with all rays."""
    return [leaf for face in faces.each() for leaf in _leaves_before(face, building, settings)]


def find_sliding_doors(leaves: Iterable[HangingLeaf], known: Doors, building: BuildingSettings) -> Doors:
    """The closed doors whose leaf hangs before its wall's face, by a negative `depth_m`.

    known: doors; a leaf beside an open one is its own.
    """
    doors = NO_DOORS
    opened = list(segments(known.select(known.state == DoorState.OPEN)))
    for leaf in leaves:
        face, opening = leaf.face, (leaf.first, leaf.after)
        told = partial(closed_door, face.segment, opening, face.counts, leaf.head_m, building.known_min, wall=face.number)
        told = partial(told, depth_m=-leaf.before_m)
        door = told() if leaf.pane is None else told(agreement=leaf.agreement, glazed=True)
        if not any(_is_beside(doorway, door, building.reveal_m) for doorway in opened):
            doors = doors.append(door)
    return doors


def sliding_panes(leaves: Iterable[HangingLeaf]) -> Windows:
    """The stretches of wall behind those leaves that are panes, as windows: what is behind them is seen through glass."""
    windows = NO_WINDOWS
    for leaf in leaves:
        if leaf.pane is not None:
            face = leaf.face.segment
            ends = face.at(CELL_M * np.array([leaf.first, leaf.after]))
            bottom_m, top_m = CELL_M * np.array([[leaf.pane[0]], [leaf.pane[1] + 1]])
            windows = windows.append(Windows(ends[None], face.normal[None], bottom_m, top_m, np.full(1, np.nan)))
    return windows


def _is_beside(doorway: Segment, door: Doors, near_m: float) -> bool:
    """Whether a single door lies in the wall of a doorway, next to it, or over it.

    near_m: a usual wall's thickness, for the doorway may have been seen in the wall's other face; no leaf stands farther from it.
    """
    off_m = np.abs(doorway.before_m(door.ends[0])).max()
    return bool(off_m < near_m and doorway.shared_m(door.ends[0]) > -near_m)


def _leaves_before(
    face: TracedFace, building: BuildingSettings, settings: DoorCasingsSettings
) -> Iterator[HangingLeaf]:
    counts = face.counts
    wall, lowest, highest = (cells_in(m) for m in (settings.wall_m, building.door_height_min_m, building.door_height_max_m))
    if counts.shape[1] <= lowest + wall:
        return
    before_m = mean_before_m(counts)
    below = before_m[:, FOOT_ROW:lowest]
    is_glass = _lets_pass(counts[:, FOOT_ROW:lowest].sum(axis=1), building)
    column_m = row_medians(below, building.known_min)
    # A pane, or a panel, lies back in its stiles.
    for first, after in runs(column_m > ON_FACE_M):
        own = slice(first, after)
        if not building.door_width_min_m <= (after - first) * CELL_M <= building.door_width_max_m:
            continue
        if not (column_m[own] > settings.relief_max_m).any():
            continue
        leaf_m = float(np.median(column_m[own]))
        flush_m = settings.flush_max * leaf_m
        # The columns and the row at its edges are its own in part.
        sides = slice(max(first - 1 - wall, 0), max(first - 1, 0)), slice(after + 1, after + 1 + wall)
        beside_m = np.concatenate([column_m[side] for side in sides])
        sheets_m = [float(np.median(column_m[own][part])) for part in (is_glass[own], ~is_glass[own]) if part.any()]
        off_m = np.min([np.abs(below[own] - sheet_m) for sheet_m in sheets_m], axis=0)
        row_m = row_medians(before_m[own].T)
        ended = np.flatnonzero(~(row_m[lowest - 1 : highest + 1] > flush_m))
        if len(beside_m) < 2 * wall or not np.all(np.abs(beside_m) < flush_m) or not len(ended) or ended[0] == 0:
            continue
        head = lowest - 1 + int(ended[0])
        over_m = row_m[head + 1 : head + 1 + wall]
        flat, returns = off_m < 0.5 * ON_FACE_M, counts[own, FOOT_ROW:lowest, FILLED]
        is_flat = np.mean(flat[np.isfinite(off_m)]) > settings.proud_min
        if is_flat and len(over_m) == wall and np.all(np.abs(over_m) < flush_m):
            clear = np.flatnonzero(_lets_pass(counts[own, :head].sum(axis=0), building))
            pane = (int(clear[0]), int(clear[-1])) if 2 * np.count_nonzero(is_glass[own]) > after - first else None
            yield HangingLeaf(face, leaf_m, first, after, head * CELL_M, pane, float(returns[flat].sum() / returns.sum()))


def _lets_pass(counts: FloatArray, building: BuildingSettings) -> BoolArray:
    """(n,) where more of the rays (n, 4) pass than a leaf that is no pane lets through."""
    return np.asarray(counts[:, THROUGH] > (1.0 - building.opaque_min) * (counts[:, THROUGH] + counts[:, FILLED]))
