"""Doors of the building, by the rays of all scans."""

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from ffmap.algorithms.base.plan_index import pairs_near
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import LENGTH, along_lines_m, lengths_m, lines_of, segments
from ffmap.algorithms.building.cells import FILLED, THROUGH, mean_before_m, with_neighbours
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import TracedFace, TracedFaces
from ffmap.algorithms.building.face_verdicts import SAME_WAY
from ffmap.algorithms.building.model import (
    AT_FACE_M,
    CELL_M,
    NO_DOORS,
    ON_FACE_M,
    BuildingSettings,
    Doors,
    Walls,
    Windows,
    cells_in,
    one_door,
    stretches,
)
from ffmap.algorithms.building.openings import (
    DoorColumns,
    OpeningRules,
    OpeningsSettings,
    is_open_to_floor,
    is_pane,
    look_for_doors,
    to_jambs,
    widened,
    without_panels,
)
from ffmap.algorithms.scan.doors import DoorState


def find_doors(faces: TracedFaces, rules: OpeningRules, windows: Windows, floor_before: BoolArray) -> Doors:
    """Doors: columns with wall above and, below, either nothing for the rays to hit or a recessed leaf.

    Columns next to each other that agree make a door, if it is as wide as doors are. What was seen in both faces of a
    wall, or in two stretches of it, is there twice, the better seen first: see `each_once`. Where a face ends in an open doorway,
    another face has to be there, or one of the windows: the doorway's other jamb.

    faces: without the rays through the windows, for what is seen through glass tells nothing of this building's doors.
    floor_before: (columns,) whether the floor was seen up to the face, so that nothing stands before it.
    """
    found: list[_Seen] = []
    alone = _ends_alone(faces.walls, windows, rules.openings.beside_m)
    # What lies higher is no door's pane, but its overlight.
    panes = windows.select(windows.bottom_m < rules.building.door_height_min_m)
    for own in faces.each():
        for seen in _doors_in(own, floor_before[own.columns], rules):
            # Below a beam of which scans saw a piece no doorway ends where the piece does; a leaf has a jamb, be it seen or not.
            has_leaf = seen.door.ajar[0] or seen.door.state[0] == DoorState.CLOSED
            if (has_leaf or not (seen.is_cut & alone[own.number]).any()) and not _has_glass(seen.door, panes, rules.openings):
                found.append(seen)
    # Where a face ends within an opening, the other face may show all of it.
    found.sort(key=lambda seen: (seen.is_cut.any(), -seen.door.confidence[0] * seen.door.ray_count[0]))
    return reduce(Doors.append, (seen.door for seen in found), NO_DOORS)


def each_once(seen: Doors, rules: OpeningRules) -> Doors:
    """The doors without doubtful ones, each once: of several that show the same door the first stands.

    A door that is doubtful as one face shows it may be beyond doubt in the other: hence it is dropped first. What is seen in the
    other face of a door's wall tells how far its doorway reaches (`reveal_m`).
    """
    doors, sure = NO_DOORS, drop_doubtful(seen, rules.building)
    for door in (sure.one(d) for d in range(len(sure))):
        through_m = _through_m(door, doors, rules.openings.doorway_max_m)
        if np.isfinite(through_m).any():
            doors = replace(doors, reveal_m=np.fmax(doors.reveal_m, through_m))
            continue
        apart_m = np.linalg.norm(door.ends.mean(axis=1) - doors.ends.mean(axis=1), axis=1)
        across = np.abs(doors.normal @ door.normal[0]) < 0.8
        if np.all((apart_m > 0.6) | across):
            doors = doors.append(door)
    return doors


def _through_m(door: Doors, doors: Doors, doorway_max_m: float) -> FloatArray:
    """(D,) how far behind each of the doors a single one is seen in the other face of the same wall; NaN where it is not."""
    (own,) = segments(door)
    middle, through_m = door.ends[0].mean(axis=0), np.full(len(doors), np.nan)
    for d, other in enumerate(segments(doors)):
        behind_m = -float(other.before_m(middle))
        shared_m = other.shared_m(door.ends[0])
        if other.normal @ own.normal < -SAME_WAY and shared_m > 0.5 * min(own.length_m, other.length_m):
            through_m[d] = behind_m if 0.0 < behind_m < doorway_max_m else np.nan
    return through_m


class _Seen(NamedTuple):
    """A single door as one face shows it, and at which of its ends (2,) it reaches that face's, which may not be its jamb."""

    door: Doors
    is_cut: BoolArray


def _doors_in(face: TracedFace, floor_before: BoolArray, rules: OpeningRules) -> Iterator[_Seen]:
    """The doors that one face shows; floor_before: (c,) as above."""
    if len(face.counts) < 3:
        return
    found = look_for_doors(face.counts, face.top_m, rules)
    for columns in _open_columns(face, found, floor_before, rules):
        yield from _door(face, found, DoorState.OPEN, columns, rules)
    for first, last in stretches(found.is_closed, 2):
        yield from _door(face, found, DoorState.CLOSED, slice(first, last + 1), rules)


def _open_columns(face: TracedFace, found: DoorColumns, floor_before: BoolArray, rules: OpeningRules) -> Iterator[slice]:
    """The columns of each opening of a face, from jamb to jamb."""
    settings, openings = rules.building, rules.openings
    below = face.counts[:, FOOT_ROW : cells_in(settings.door_height_min_m)].sum(axis=1)
    for first, last in stretches(found.is_open, 2):
        own = slice(first, last + 1)
        if is_pane(face.counts[own], rules) or not is_open_to_floor(face.counts[own], rules):
            continue
        first, last = to_jambs(below, first, last, openings.leaf_max_m)
        if (last + 1 - first) * CELL_M < settings.door_width_min_m:
            first, last = _over_what_its_leaf_hides(found, first, last, rules)
        else:
            first, last = _over_empty_columns(found, floor_before, first, last, rules)
        yield slice(first, last + 1)


def _door(
    face: TracedFace, found: DoorColumns, seen_as: DoorState, columns: slice, rules: OpeningRules
) -> Iterator[_Seen]:
    """The door that some columns of a face are, if they are as wide as one and its wall stands beside it."""
    settings, is_open = rules.building, seen_as == DoorState.OPEN
    counts, flags = face.counts[columns], (found.is_open if is_open else found.is_closed)
    width_m = len(counts) * CELL_M
    # Smoothing and the cells' own width blur each side by up to a column.
    if not settings.door_width_min_m <= width_m + CELL_M or width_m > settings.door_width_max_m:
        return
    lintel_m = float(np.mean(found.lintel_m[columns]))
    depth_m = float("nan") if is_open else float(np.nanmedian(found.depth_m[columns]))
    jambs = _count_jambs(face.counts, columns, lintel_m, depth_m, rules)
    lintel = float(np.mean(found.has_lintel[columns]))
    if jambs < (1 if lintel > 0.5 else 2):
        return
    leaf = counts[:, FOOT_ROW : cells_in(settings.door_height_min_m)]
    agree = found.through[columns] if is_open else _share_on_leaf(leaf, rules.openings)
    is_ajar = not is_open and _is_ajar(found.depth_m[columns], rules.openings.ajar_m)
    state = DoorState.OPEN if is_ajar else seen_as
    door = one_door(
        ends=face.segment.at(CELL_M * np.array([columns.start, columns.stop])),
        normal=face.segment.normal,
        head_m=_head_m(counts, state, float(face.top_m[columns].max()), lintel_m, depth_m, settings),
        depth_m=np.nan if is_ajar else depth_m,
        state=state,
        agreement=np.nanmean(agree[flags[columns]]),
        # The columns of a doorway that its leaf, ajar, covers bear it out as well.
        coverage=np.mean((flags | found.is_closed)[columns]),
        lintel=lintel,
        ajar=is_ajar,
        ray_count=found.rays[columns][:, [FILLED, THROUGH]].sum() / 3,
        wall=face.number,
    )
    yield _Seen(door, np.array([columns.start == 0, columns.stop == len(face.counts)]))


def _ends_alone(walls: Walls, windows: Windows, near_m: float) -> BoolArray:
    """(W, 2) whether each end of a face is no doorway's jamb: neither a pane nor another face is within `near_m`, but for one that
    looks the opposite way and ends there too."""
    ends, lines = walls.ends.reshape(-1, 2), lines_of(walls)
    end, face = pairs_near(walls, ends, near_m)
    along_m = along_lines_m(lines[face], ends[end])
    ends_there = np.minimum(along_m, lines[face, LENGTH] - along_m) < near_m
    is_back = (walls.normal[face] * walls.normal[end // 2]).sum(axis=1) < -SAME_WAY
    is_alone = np.ones(len(ends), bool)
    is_alone[end[(face != end // 2) & ~(is_back & ends_there)]] = False
    is_alone[pairs_near(windows, ends, near_m)[0]] = False
    return is_alone.reshape(-1, 2)


def _share_on_leaf(leaf: FloatArray, settings: OpeningsSettings) -> FloatArray:
    """(c,) which share of the rays that meet a leaf (c, rows, 4), away from its vision panels, end on it; NaN where none do."""
    rays = with_neighbours(without_panels(leaf, settings.stile_min_m)).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(rays[:, FILLED] / (rays[:, FILLED] + rays[:, THROUGH]))


def _over_what_its_leaf_hides(columns: DoorColumns, first: int, last: int, rules: OpeningRules) -> tuple[int, int]:
    """The columns of an opening too narrow for a door, with those on one side of it that its leaf hides, up to its jamb.

    A leaf ajar towards the robot lets no ray come to them, or stands before the wall beside its hinge; above and beyond it the
    wall goes on. columns: of the whole face; first, last: the opening's.
    """
    settings, most = rules.building, cells_in(rules.openings.leaf_max_m)
    on, passed = columns.rays[:, FILLED], columns.rays[:, THROUGH]
    unseen = on + passed < settings.rays_min
    hidden = columns.has_lintel & (unseen | (columns.depth_m < -settings.recess_min_m))
    stands = ~hidden & (on >= settings.rays_min) & (passed < on)
    before, behind = widened(hidden, first, first, most)[0], widened(hidden, last, last, most)[1]
    on_left = 0 < before < first and bool(stands[before - 1])
    on_right = last < behind < len(hidden) - 1 and bool(stands[behind + 1])
    if on_left == on_right:
        return first, last
    return (before, last) if on_left else (first, behind)


def _over_empty_columns(
    columns: DoorColumns, floor_before: BoolArray, first: int, last: int, rules: OpeningRules
) -> tuple[int, int]:
    """The columns of an opening, with those beside it, up to its jamb, that return nothing below their lintel.

    A sweep that meets the lintel meets the wall below it too, if there is one and nothing stands before it: what passes there
    at a slant ends on the reveal, or on a wall close behind it. columns: of the whole face; first, last: the opening's.
    """
    settings, most = rules.building, cells_in(rules.openings.leaf_max_m)
    on, passed = columns.rays[:, FILLED], columns.rays[:, THROUGH]
    empty = columns.has_lintel & (on + passed < settings.rays_min) & floor_before
    stands = (on >= settings.rays_min) & (passed < on)
    before, behind = widened(empty, first, first, most)[0], widened(empty, last, last, most)[1]
    to_left = before if before > 0 and stands[before - 1] else first
    to_right = behind if behind < len(empty) - 1 and stands[behind + 1] else last
    return (to_left, to_right) if cells_in(settings.door_width_max_m) >= to_right + 1 - to_left else (first, last)


def lower_heads_to_overlights(doors: Doors, windows: Windows, rules: OpeningRules) -> Doors:
    """The closed doors, whose heads lie no higher than the panes above them: a recess may hold both."""
    head_m = doors.head_m.copy()
    for d in np.flatnonzero(doors.state == DoorState.CLOSED):
        is_above = (windows.bottom_m >= rules.building.door_height_min_m) & (windows.bottom_m < head_m[d])
        for pane in (windows.one(k) for k in np.flatnonzero(is_above)):
            if _has_glass(doors.one(d), pane, rules.openings):
                head_m[d] = min(head_m[d], pane.bottom_m[0])
    return replace(doors, head_m=head_m)


def _has_glass(door: Doors, windows: Windows, settings: OpeningsSettings) -> bool:
    """Whether one of some windows takes most of an opening's width, in whichever of its wall's faces."""
    opening = next(segments(door))
    for ends, normal in zip(windows.ends, windows.normal, strict=True):
        near = np.abs(opening.before_m(ends)).max() < settings.glazed_m and abs(opening.normal @ normal) > 0.8
        if near and opening.shared_m(ends) > 0.5 * opening.length_m:
            return True
    return False


def _is_ajar(depth_m: FloatArray, ajar_m: float) -> bool:
    """Whether a leaf, of which depth_m (c,) is how far behind the wall each column lies, stands aslant."""
    known = np.flatnonzero(np.isfinite(depth_m))
    if len(known) < 3:
        return False
    # Columns at the jambs hold returns of the reveals as well: the median of the slopes between all pairs (Theil and Sen).
    first, second = (known[place] for place in np.triu_indices(len(known), 1))
    slope = np.median((depth_m[second].astype(np.float64) - depth_m[first]) / (second - first))
    return bool(abs(slope) * len(depth_m) > ajar_m)


def _count_jambs(counts: FloatArray, opening: slice, lintel_m: float, depth_m: float, rules: OpeningRules) -> int:
    """On how many sides the wall above an opening stands beside it too: on one at least, on both where its lintel is hidden.

    A cupboard's front below a board is recessed behind what is above alone, a leaf behind the wall beside it, too. Beside an
    open doorway that is seen through another one, things may hide the wall.

    counts: (columns, rows, 4) of the whole face; opening: columns. lintel_m: how far before the face the
    wall above lies; depth_m: how far behind that the leaf does, NaN of an open door.
    """
    settings, openings = rules.building, rules.openings
    below = counts[:, FOOT_ROW : cells_in(settings.door_height_min_m)].sum(axis=1)
    before_m = mean_before_m(below)
    off_m = np.abs(lintel_m - before_m)
    if not np.isfinite(depth_m):
        # Where a duct hides most of the lintel, returns from its other side pull its mean back: the wall beside lies in the face.
        off_m = np.minimum(off_m, np.abs(before_m))
    seen = below[:, FILLED] + below[:, THROUGH] >= settings.rays_min
    stands = (below[:, FILLED] >= settings.rays_min) & (below[:, THROUGH] < below[:, FILLED])
    flush = stands & (off_m < (0.5 * depth_m if np.isfinite(depth_m) else ON_FACE_M))
    reach = cells_in(openings.beside_m)
    sides = slice(max(opening.start - reach, 0), opening.start), slice(opening.stop, opening.stop + reach)
    beside = np.concatenate([seen[side] for side in sides])
    hidden = not np.isfinite(depth_m) and len(beside) > 0 and beside.mean() < 0.5
    wall_min = cells_in(openings.beside_wall_m)
    return 1 if hidden else sum(int(np.count_nonzero(flush[side]) >= wall_min) for side in sides)


def _head_m(
    counts: FloatArray, state: DoorState, top_m: float, lintel_m: float, leaf_m: float, settings: BuildingSettings
) -> float:
    """Height below which the rows of a door are no longer wall.

    top_m: how high its wall stands. lintel_m: how far before the face the wall above lies; leaf_m: how far behind it a closed leaf
    does.
    """
    rows = counts.sum(axis=0)
    depth_m = lintel_m - mean_before_m(rows)
    # A ray that ends on the lintel's underside passes the face lower than it ends.
    above_opening = (rows[:, FILLED] > rows[:, THROUGH]) & (depth_m < ON_FACE_M)
    wall = above_opening if state == DoorState.OPEN else depth_m < 0.5 * leaf_m
    # What is open may be higher than doors are.
    highest_m = max(settings.door_height_max_m + 0.3, top_m if state == DoorState.OPEN else 0.0)
    start, stop = cells_in(settings.door_height_min_m - 0.1), cells_in(highest_m)
    above = np.flatnonzero((wall & (rows[:, FILLED] > 0))[start:stop])
    if state == DoorState.CLOSED and start + above.min(initial=stop) > cells_in(settings.door_height_max_m + CELL_M):
        # The recess goes on above its door, whose head is below the pane of its overlight.
        start = cells_in(settings.door_height_min_m)
        above = np.flatnonzero((rows[:, THROUGH] > rows[:, FILLED])[start:stop])
    if len(above):
        # The head lies somewhere in the row below, which is partly wall.
        return (start + int(above[0]) - 0.5) * CELL_M
    # A duct hides the lintel: the head is as high as rays came.
    came = np.flatnonzero(rows[:stop, FILLED] + rows[:stop, THROUGH] > 0)
    return max(settings.door_height_min_m, (int(came[-1]) + 1) * CELL_M if len(came) else 0.0)


def drop_doubtful(doors: Doors, settings: BuildingSettings) -> Doors:
    """The doors without what is too narrow for one or too unsure, and without "closed" ones that are rather a wall or a pane.

    A leaf's recess of centimetres shows from nearby only: at least `scans_min` scans have to have seen it so, unless it is deeper
    than noise and the poses' errors displace returns. A leaf is set back by a step, as high as doors are; a wall that the poses'
    tilt leans back comes forward little by little, and its "head" is far too low or high. And no ray passes a leaf.
    """
    width_m = lengths_m(doors.ends)
    lowest_m, highest_m = settings.door_height_min_m - CELL_M, settings.door_height_max_m + CELL_M
    doubtful = (
        ((doors.scan_count < settings.scans_min) & (doors.depth_m < AT_FACE_M))
        | (doors.head_m < lowest_m)
        | (doors.head_m > highest_m)
        | (doors.agreement < settings.opaque_min)
    )
    unsure = (width_m < settings.door_width_min_m - CELL_M) | (doors.confidence < settings.confidence_min)
    return doors.select(~unsure & ~(doubtful & (doors.state == DoorState.CLOSED)))


def prove_crossed(doors: Doors, path_map: FloatArray) -> Doors:
    """The doors, of which those that the robot drove through are open beyond doubt, whatever rays said of them.

    path_map: (n, 2) the robot's places in their order.
    """
    crossed = np.zeros(len(doors), bool)
    for d, door in enumerate(segments(doors)):
        side_m, place_m = door.before_m(path_map), door.place_m(path_map)
        change = np.flatnonzero(np.diff(side_m > 0))
        t = side_m[change] / (side_m[change] - side_m[change + 1])
        at_m = place_m[change] + t * (place_m[change + 1] - place_m[change])
        crossed[d] = bool(np.any((at_m > 0) & (at_m < door.length_m)))
    return replace(
        doors,
        crossed=crossed,
        state=np.where(crossed, np.uint8(DoorState.OPEN), doors.state),
        depth_m=np.where(crossed, np.nan, doors.depth_m),
    )
