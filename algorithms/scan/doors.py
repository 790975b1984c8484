"""From point lines and wall planes to doors, by the paper's three conditions (III.C)."""

from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.scan.point_lines import PointLines
from ffmap.algorithms.scan.rearrangement import Returns
from ffmap.algorithms.scan.wall_planes import WallPlanes

OPEN_DEPTH_M = 0.15  # depth (m) beyond which a door is open
HEIGHT_MAX_M = 2.6  # maximum height (m) above the floor at which a door begins
ABOVE_PER_RECESS, ABOVE_MORE_M = 0.5, 0.01
"""The wall above a door is off its plane by at most half a recess and the plane's own error (m)."""
EXCEPTIONS_MAX = 0.15  # maximum share of returns on the plane below the start: noise, a handle
_WALL_DISTANCE_M = 0.05
"""Maximum distance (m) from the plane of the uppermost return of the wall in a line.

A higher return is the ceiling or another object.
"""
_BEFORE_M = 0.08  # a return farther before the plane (m) hides the wall and is ignored
_DEPTH_MAX_M = 0.5
"""Maximum depth (m) that a return counts with: a few far returns through an open door would
decide otherwise."""
_LINTEL_MIN_M = 0.06  # minimum height (m) of the wall above a door
_POINTS_MIN = 12  # minimum number of returns behind the plane in a line
RETURNS_MIN = _POINTS_MIN + 3  # minimum number of returns at the plane and behind it in a line
_GAP_MAX_M = 0.35  # maximum gap (m) between neighbouring lines of an opening


class DoorsSettings(StepSettings):
    """The paper's door conditions (III.C) and the openings made of them."""

    recess_min_m: float = Field(
        0.022,
        gt=0,
        description="Minimum depth (m) of a door below its wall plane: less is the plane's own "
        "error. III.C, condition 2.",
    )
    height_min_m: float = Field(
        1.8,
        gt=0,
        description="Minimum height above the floor (m) at which a door begins. III.C, "
        "condition 3.",
    )
    lines_min: int = Field(
        2, ge=1, description="Minimum number of neighbouring lines in an opening. III.C."
    )


class DoorState(IntEnum):
    CLOSED = 0
    OPEN = 1


class Depression(IntEnum):
    """Whether condition 2 held, or what it failed by; tried in this order."""

    FEW_RETURNS = 0  # the line has too few returns at its plane and behind it
    NONE = 1  # the returns below are nowhere behind the returns above by the minimum depth
    ABOVE_OFF_PLANE = 2  # the returns above the split are not on the plane
    SHALLOW = 3  # the returns below the split are less than the minimum depth behind the plane
    EXCEPTIONS = 4  # too many returns below the split are on the plane
    HELD = 5


@dataclass(frozen=True)
class DoorLines:
    """The three conditions for each line (D,) that belongs to a wall plane, tried in order.

    line, plane: the point line, and the wall plane of its up-most structure (condition 1 held).
    behind: condition 2: from some point downwards all of its returns are behind the plane.
    start_height_m: height above the floor of the return at which that begins.
    high_enough: condition 3: it begins at least the door's minimum height above the floor.
    depth_m: mean distance behind the plane below the start, each return limited to 0.5 m.
    state: uint8, see `DoorState`; meaningful where all three conditions held.
    position: (D, 2) x and y at which the line passes through the plane below the start.

    What condition 2 measured; NaN where it failed earlier:
    depression: uint8, see `Depression`.
    return_count: number of returns at the plane and behind it.
    recess_m: the largest step back, mean above less mean below, over all splits.
    above_m, below_m: mean distance before the plane above and below the best split.
    on_plane_share: share of the returns below the split that are on the plane.
    """

    line: IntArray
    plane: IntArray
    behind: BoolArray
    start_height_m: FloatArray
    high_enough: BoolArray
    depth_m: FloatArray
    state: UInt8Array
    position: FloatArray
    depression: UInt8Array
    return_count: IntArray
    recess_m: FloatArray
    above_m: FloatArray
    below_m: FloatArray
    on_plane_share: FloatArray

    @property
    def above_door(self) -> BoolArray:
        """(D,) whether all three conditions held."""
        return self.behind & self.high_enough


@dataclass(frozen=True)
class Openings:
    """The openings (O,) in view of a scan, each of neighbouring lines above a door.

    plane: its wall plane.
    ends: (O, 2, 2) x and y of its two sides, on the plane.
    head_m: height of the lintel's underside.
    depth_m: median depth of its lines.
    state: uint8, see `DoorState`.
    line_count: number of its lines.
    door_line_opening: (D,) the opening of each row of `DoorLines`, -1 for none: its conditions
        failed, or too few neighbours' held.
    door_line_group: (D,) number of neighbouring lines whose conditions held, itself counted; 0
        where its own failed.
    """

    plane: IntArray
    ends: FloatArray
    head_m: FloatArray
    depth_m: FloatArray
    state: UInt8Array
    line_count: IntArray
    door_line_opening: IntArray
    door_line_group: IntArray

    def __len__(self) -> int:
        return len(self.plane)


def find_door_lines(
    returns: Returns,
    lines: PointLines,
    planes: WallPlanes,
    upmost: IntArray,
    settings: DoorsSettings,
) -> DoorLines:
    """Test conditions 1 to 3 on every line whose up-most structure belongs to a wall plane.

    All returns of a line count, also the floor's: seen through an open door they are behind the
    wall and prove that it is "connected to the floor".

    upmost: (L,) each line's up-most vertical structure, from `VerticalStructures`.
    """
    is_upmost = upmost[planes.candidates.line] == planes.candidates.structure
    member = (planes.candidate_plane >= 0) & is_upmost
    line, plane = planes.candidates.line[member], planes.candidate_plane[member]
    start, depression, measured = _find_depressions(
        returns,
        lines.order,
        lines.starts,
        line,
        planes.normal[plane],
        planes.offset_m[plane],
        settings.recess_min_m,
    )
    return_count, recess_m, above_m, below_m, on_plane_share, x, y = measured.T
    behind = depression == Depression.HELD
    start_height_m = np.where(behind, returns.height_m[start], np.nan)
    depth_m = np.where(behind, -below_m, np.nan)
    state = np.where(depth_m > OPEN_DEPTH_M, DoorState.OPEN, DoorState.CLOSED)
    return DoorLines(
        line=line,
        plane=plane,
        behind=behind,
        start_height_m=start_height_m,
        high_enough=behind
        & (start_height_m >= settings.height_min_m)
        & (start_height_m <= HEIGHT_MAX_M),
        depth_m=depth_m,
        state=state.astype(np.uint8),
        position=np.where(behind[:, None], np.column_stack([x, y]), np.nan),
        depression=depression,
        return_count=return_count.astype(np.int32),
        recess_m=recess_m,
        above_m=above_m,
        below_m=below_m,
        on_plane_share=on_plane_share,
    )


@numba.njit(cache=True, nogil=True)
def _find_depressions(
    returns: Returns,
    order: IntArray,
    starts: IntArray,
    line: IntArray,
    normal: FloatArray,
    offset: FloatArray,
    recess_min_m: float,
) -> tuple[IntArray, UInt8Array, FloatArray]:
    """Condition 2 for lines (D,), each with the normal (D, 2) and offset (D,) of its plane.

    The wall ends and the depression begins where one split of the line, from top to bottom, parts
    its distances best: single returns scatter as much as a closed door is recessed.

    Returns the return (D,) at which the depression begins, `Depression` (D,), and what was measured
    (D, 7): number of returns, recess, above, below, share on the plane, x and y at which the line
    passes through it.
    """
    points, height, origin = returns
    start = np.full(len(line), -1, np.int32)
    depression = np.full(len(line), Depression.FEW_RETURNS, np.uint8)
    measured = np.full((len(line), 7), np.nan)
    for d in range(len(line)):
        own = order[starts[line[d]] : starts[line[d] + 1]][::-1]  # from the top down
        xyz = points[own]
        before = normal[d, 0] * xyz[:, 0] + normal[d, 1] * xyz[:, 1] - offset[d]
        # The wall begins at the highest return on the plane; returns well before it hide the wall.
        on_wall = np.flatnonzero(np.abs(before) <= _WALL_DISTANCE_M)
        top = on_wall[0] if len(on_wall) else len(own)
        used = top + np.flatnonzero(before[top:] < _BEFORE_M)
        own, xyz, before = own[used], xyz[used], before[used]
        measured[d, 0] = len(own)
        if len(own) < RETURNS_MIN:
            continue
        # Far returns behind an open door count no more than a closed door's when it is split.
        limited = np.maximum(before, -2.0 * OPEN_DEPTH_M)
        is_lintel = height[own[0]] - height[own] >= _LINTEL_MIN_M
        split, measured[d, 1] = _best_split(limited, is_lintel, recess_min_m)
        depression[d] = Depression.NONE
        if split < 0:
            continue
        above, below = before[: split + 1], before[split + 1 :]
        above_m = np.maximum(above, -_DEPTH_MAX_M).mean()
        below_m = np.maximum(below, -_DEPTH_MAX_M).mean()
        # A return a quarter of a recess behind the plane is on it.
        on_plane = np.count_nonzero(below > -0.25 * recess_min_m) / len(below)
        measured[d, 2:5] = np.array([above_m, below_m, on_plane])
        if abs(above_m) > ABOVE_PER_RECESS * recess_min_m + ABOVE_MORE_M:
            depression[d] = Depression.ABOVE_OFF_PLANE
        elif below_m > -recess_min_m:
            depression[d] = Depression.SHALLOW
        elif on_plane > EXCEPTIONS_MAX:
            depression[d] = Depression.EXCEPTIONS
        else:
            depression[d] = Depression.HELD
            start[d] = own[split]
            sensor = normal[d, 0] * origin[0] + normal[d, 1] * origin[1] - offset[d]
            t = sensor / np.maximum(sensor - below, 1e-6)
            for axis in range(2):
                passed = origin[axis] + t * (xyz[split + 1 :, axis] - origin[axis])
                measured[d, 5 + axis] = passed.mean()
    return start, depression, measured


@numba.njit(cache=True, nogil=True)
def _best_split(before: FloatArray, allowed: BoolArray, recess_min_m: float) -> tuple[int, float]:
    """The last place above the best split (-1 for none), and the largest step back of any split.

    The best split has the largest variance between its two parts (Otsu, 1979).
    """
    count = len(before)
    total, above = before.sum(), 0.0
    best, most, largest = -1, 0.0, np.nan
    for j in range(count - _POINTS_MIN):
        above += before[j]
        if not allowed[j]:
            continue
        gap = above / (j + 1) - (total - above) / (count - j - 1)
        largest = gap if np.isnan(largest) else max(gap, largest)
        variance = gap * gap * (j + 1) * (count - j - 1) / count
        if gap > recess_min_m and variance > most:
            best, most = j, variance
    return best, largest


def find_openings(door_lines: DoorLines, planes: WallPlanes, settings: DoorsSettings) -> Openings:
    """Group neighbouring lines above a door, of one plane and one state, into openings."""
    chosen = np.flatnonzero(door_lines.above_door)
    along = np.stack([-planes.normal[:, 1], planes.normal[:, 0]], axis=1)
    place_m = np.sum(door_lines.position[chosen] * along[door_lines.plane[chosen]], axis=1)
    walk = np.lexsort((place_m, door_lines.state[chosen], door_lines.plane[chosen]))
    chosen, place_m = chosen[walk], place_m[walk]
    plane, state = door_lines.plane[chosen], door_lines.state[chosen]
    apart = np.diff(place_m) > _GAP_MAX_M
    breaks = np.flatnonzero((np.diff(plane) != 0) | (np.diff(state) != 0) | apart) + 1
    groups = np.split(np.arange(len(chosen)), breaks)
    door_line_group = np.zeros(len(door_lines.line), np.int32)
    for group in groups:
        door_line_group[chosen[group]] = len(group)
    groups = [group for group in groups if len(group) >= settings.lines_min]
    door_line_opening = np.full(len(door_lines.line), -1, np.int32)
    for opening, group in enumerate(groups):
        door_line_opening[chosen[group]] = opening
    first = np.array([g[0] for g in groups], np.intp)
    last = np.array([g[-1] for g in groups], np.intp)
    sides_m = np.stack([place_m[first], place_m[last]], axis=1)
    owner = plane[first]
    foot = planes.normal[owner] * planes.offset_m[owner][:, None]
    return Openings(
        plane=owner,
        ends=foot[:, None, :] + along[owner][:, None, :] * sides_m[:, :, None],
        head_m=np.array([np.median(door_lines.start_height_m[chosen[g]]) for g in groups]),
        depth_m=np.array([np.median(door_lines.depth_m[chosen[g]]) for g in groups]),
        state=state[first],
        line_count=np.array([len(g) for g in groups], np.int32),
        door_line_opening=door_line_opening,
        door_line_group=door_line_group,
    )
