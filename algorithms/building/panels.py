"""The upright surfaces of a building as panels: rectangles on which rays end, with a label each."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import (
    LENGTH,
    Faces,
    lengthened,
    lengths_m,
    lines_of,
    moved,
    segments,
)
from ffmap.algorithms.building.model import CELL_M, Blinds, Doors, Rows, Windows
from ffmap.algorithms.scan.doors import DoorState

if TYPE_CHECKING:
    from ffmap.algorithms.building.final_labels import BuildingModel


class Kind(IntEnum):
    """What a return is from."""

    NOTHING = 0
    BEYOND_PANE = 1
    FLOOR = 2
    CEILING = 3
    WALL = 4
    LEAF = 5
    REVEAL = 6
    RECESS = 7
    BLIND = 8
    RELIEF = 9
    REFUSED = 10
    LEVEL = 11


KIND_WORDS: dict[int, str] = {
    Kind.NOTHING: "no surface of the building",
    Kind.BEYOND_PANE: "beyond a pane",
    Kind.FLOOR: "floor of the scan",
    Kind.CEILING: "ceiling of the scan",
    Kind.WALL: "wall face",
    Kind.LEAF: "closed door",
    Kind.REVEAL: "jamb or lintel of a door",
    Kind.RECESS: "recess of a window",
    Kind.BLIND: "blind",
    Kind.RELIEF: "object flat against a wall",
    Kind.REFUSED: "plane that is not a wall",
    Kind.LEVEL: "floor, ceiling or step of all scans",
}

PANE_DEPTH_M = 0.12
"""Depth (m) of a pane without returns: half of a wall, which is 0.24 m thick (DIN 4172)."""
_LEAF_M = 0.04
"""Thickness (m) of a door leaf (DIN 68706-1)."""
_LINTEL_M = 0.3
"""Height (m) of the lintel above a door: the last row of bricks and its bearing."""
_EDGE_M = 0.02
"""Error (m) of a door's edges, by which it may be wider."""
_OTHER_FACE_M = 0.1
"""Maximum error (m) of a reveal's depth, within which a door opens the wall's other face."""
_DUPLICATE_M = 0.04
"""A refused plane this close (m) to a wall face is a duplicate of it."""
_PARALLEL = 0.95  # cosine


@dataclass(frozen=True)
class Panels(Rows):
    """Upright rectangles, each visible from the side of its normal.

    ends: (P, 2, 2) x and y, metres. normal: (P, 2) unit vectors.
    bottom_m, top_m: (P,) heights above the floor.
    front_m, back_m: (P,) depth before and behind the rectangle that belongs to the panel, as the
        recess before a pane.
    label: (P,) of its returns. kind: (P,) see `Kind`.
    wall: (P,) index of the wall face by which scans are aligned; -1 for none.
    column: (P,) position of its start in the columns of `Foreground`; -1 without columns.
    """

    ends: FloatArray
    normal: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray
    front_m: FloatArray
    back_m: FloatArray
    label: UInt8Array
    kind: UInt8Array
    wall: IntArray
    column: FloatArray


BOTTOM, TOP, FRONT, BACK, LABEL, KIND, WALL, COLUMN = range(LENGTH + 1, LENGTH + 9)
"""The columns of `table_of` after those of `lines_of`."""


def table_of(panels: Panels) -> FloatArray:
    """Return (P, 15) for compiled code."""
    return np.ascontiguousarray(
        np.column_stack(
            [
                *(lines_of(panels), panels.bottom_m, panels.top_m, panels.front_m, panels.back_m),
                *(panels.label, panels.kind, panels.wall, panels.column),
            ]
        )
    )


def panels_of(building: "BuildingModel") -> Panels:
    """Return all panels of a building."""
    return reduce(Panels.append, _parts(building))


def _parts(building: "BuildingModel") -> Iterator[Panels]:
    walls, doors, windows = building.walls, building.ways, building.windows
    blinds, judged = building.blinds, building.judged
    doors = replace(doors, reveal_m=np.fmax(doors.reveal_m, 0.0))
    opened_m, pane_m = doors.reveal_m + _OTHER_FACE_M, pane_depth_m(windows)
    head_m = np.append(doors.head_m, -np.inf)  # index -1: no door
    blind, _, _, (door,) = _split(blinds, (doors, opened_m))
    blinds = blinds.select(np.setdiff1d(blind, blind[door >= 0]))  # a glazed door is a door
    hung = blinds, np.full(len(blinds), _OTHER_FACE_M)
    wider = replace(doors, ends=lengthened(doors.ends, _EDGE_M))
    glass = windows, np.full(len(windows), _OTHER_FACE_M)
    wall, start_m, ends, (door, window, blind) = _split(walls, (wider, opened_m), glass, hung)
    bare = (window < 0) & (blind < 0)
    yield _without(
        blinds,
        blind,
        _panels(
            *(ends, walls.normal[wall], Label.WALL, Kind.WALL, head_m[door]),
            top_m=np.where(bare, walls.top_m[wall], np.inf),
            wall=wall,
            column=np.where(bare, building.foreground.first[wall] + start_m / CELL_M, -1.0),
        ),
    )
    yield from _door_panels(doors)
    window, _, ends, (door, blind) = _split(windows, (doors, opened_m), hung)
    yield _without(
        blinds,
        blind,
        _panels(
            moved(ends, windows.normal[window], -pane_m[window]),
            *(windows.normal[window], Label.WALL, Kind.RECESS, head_m[door]),
            front_m=pane_m[window],
        ),
    )
    yield _panels(
        moved(blinds.ends, blinds.normal, -blinds.behind_m),
        *(blinds.normal, Label.CLUTTER, Kind.BLIND, blinds.bottom_m, blinds.top_m),
        front_m=blinds.behind_m,
    )
    plane, _, ends, (wall, window) = _split(
        judged.refused,
        (walls, np.full(len(walls), _DUPLICATE_M)),
        (windows, pane_m + _DUPLICATE_M),
    )
    alone = (wall < 0) & (window < 0)
    plane = plane[alone]
    yield _panels(
        *(ends[alone], judged.refused.normal[plane]),
        *(judged.refused_label[plane], Kind.REFUSED),
        top_m=judged.refused.top_m[plane],
    )


def _without(blinds: Blinds, blind: IntArray, panels: Panels) -> Panels:
    """Return the parts of panels below and above blinds. blind: (P,) its index; -1 for none."""
    hidden, own = panels.select(blind >= 0), blinds.select(blind[blind >= 0])
    below = replace(hidden, top_m=np.minimum(hidden.top_m, own.bottom_m))
    above = replace(hidden, bottom_m=np.maximum(hidden.bottom_m, own.top_m))
    return panels.select(blind < 0).append(below).append(above)


def _door_panels(doors: Doors) -> Iterator[Panels]:
    """Yield the leaves of closed doors from both sides, and jambs and lintels of all doors."""
    leaves = doors.select(doors.state == DoorState.CLOSED)
    leaf = moved(leaves.ends, leaves.normal, -leaves.depth_m)
    of_leaf = Label.DOOR, Kind.LEAF, -np.inf, leaves.head_m
    before_m = np.maximum(leaves.depth_m, 0.0)
    yield _panels(leaf, leaves.normal, *of_leaf, front_m=before_m, wall=leaves.wall)
    yield _panels(leaf, -leaves.normal, *of_leaf, front_m=_LEAF_M)
    along = (doors.ends[:, 1] - doors.ends[:, 0]) / np.maximum(lengths_m(doors.ends), 1e-9)[:, None]
    other_face = moved(doors.ends, doors.normal, -doors.reveal_m)
    for end, inwards in ((0, along), (1, -along)):
        jamb = np.stack([doors.ends[:, end], other_face[:, end]], axis=1)
        yield _panels(jamb, inwards, Label.WALL, Kind.REVEAL, top_m=doors.head_m)
    lintel = (Label.WALL, Kind.REVEAL, doors.head_m, doors.head_m + _LINTEL_M, 0.0, doors.reveal_m)
    yield _panels(doors.ends, doors.normal, *lintel, wall=doors.wall)
    yield _panels(other_face, -doors.normal, *lintel)


def pane_depth_m(windows: Windows) -> FloatArray:
    """Return (N,) the depth of each pane behind its wall's face; one before it closes a wall."""
    return np.where(windows.pane_m >= 0.0, windows.pane_m, PANE_DEPTH_M)


def _panels(
    ends: FloatArray,
    normal: FloatArray,
    label: ArrayLike,
    kind: Kind,
    bottom_m: ArrayLike = -np.inf,
    top_m: ArrayLike = np.inf,
    front_m: ArrayLike = 0.0,
    back_m: ArrayLike = 0.0,
    wall: ArrayLike = -1,
    column: ArrayLike = -1.0,
) -> Panels:
    def rows(value: ArrayLike) -> FloatArray:
        return np.broadcast_to(np.asarray(value, np.float64), len(ends))

    return Panels(
        *(ends, normal, rows(bottom_m), rows(top_m), rows(front_m), rows(back_m)),
        label=rows(label).astype(np.uint8),
        kind=np.full(len(ends), kind, np.uint8),
        wall=rows(wall).astype(np.int64),
        column=rows(column),
    )


def _split(
    faces: Faces, *others: tuple[Faces, FloatArray]
) -> tuple[IntArray, FloatArray, FloatArray, list[IntArray]]:
    """Split faces where others along them begin and end.

    others: faces, and the distance (m) up to which each of them is along a face that it is
        parallel to.
    Returns the index of each piece's face (n,), its start along the face (n,), its ends
    (n, 2, 2), and for each of the others the index (n,) of one along the piece; -1 for none.
    """
    face, start, ends = [np.zeros(0, np.int64)], [np.zeros(0)], [np.zeros((0, 2, 2))]
    along: list[list[IntArray]] = [[np.zeros(0, np.int64)] for _ in others]
    for k, line in enumerate(segments(faces)):
        spans = []
        for other, near_m in others:
            places_m = np.sort(line.place_m(other.ends), axis=1).clip(0.0, line.length_m)
            parallel = np.abs(other.normal @ line.normal) > _PARALLEL
            near = (np.abs(line.before_m(other.ends)) < near_m[:, None]).all(axis=1)
            spans.append(np.where((parallel & near)[:, None], places_m, 0.0))
        edges = np.unique(np.concatenate([[0.0, line.length_m], *map(np.ravel, spans)]))
        middle = 0.5 * (edges[1:] + edges[:-1])
        face.append(np.full(len(middle), k))
        start.append(edges[:-1])
        ends.append(np.stack([line.at(edges[:-1]), line.at(edges[1:])], axis=1))
        for span, covering in zip(spans, along, strict=True):
            within = (span[:, :1] < middle) & (middle < span[:, 1:])
            within = np.vstack([within, np.ones((1, len(middle)), bool)])
            first = within.argmax(axis=0)
            covering.append(np.where(first < len(span), first, -1))
    covering_faces: list[IntArray] = [np.concatenate(indices) for indices in along]
    return np.concatenate(face), np.concatenate(start), np.concatenate(ends), covering_faces
