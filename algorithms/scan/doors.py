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

_WALL_DISTANCE_M = 0.05
"""Maximum distance (m) from the plane of the uppermost return of the wall in a line; what is higher
is ceiling or another thing. III.C."""
_BEFORE_M = 0.08
"""Distance before the plane (m) beyond which a return hides the wall and is left out. III.C,
condition 2."""
_DEPTH_MAX_M = 0.5
"""Maximum depth (m) that a return counts with: a few far ones seen through an open door would
decide. III.C."""
_GAP_MAX_M = 0.35
"""Maximum gap (m) between neighbouring lines of an opening. III.C."""


class DoorsSettings(StepSettings):
    """The paper's door conditions (III.C) and the openings made of them."""

    recess_min_m: float = Field(
        0.022,
        gt=0,
        description="Minimum depth (m) of a door below its wall plane: less is the plane's own error. III.C, condition 2.",
    )
    open_depth_m: float = Field(0.15, gt=0, description="Depth (m) beyond which a door stands open. III.C.")
    height_min_m: float = Field(
        1.8, gt=0, description="Minimum height above the floor (m) at which a door begins. III.C, condition 3."
    )
    height_max_m: float = Field(
        2.6, gt=0, description="Maximum height above the floor (m) at which a door begins. III.C."
    )
    lintel_min_m: float = Field(
        0.06, ge=0, description="Minimum height (m) of the wall above a door. III.C, condition 1."
    )
    exceptions_max: float = Field(
        0.15, ge=0, lt=1, description="Maximum share of returns on the plane below the start: noise, a handle. III.C."
    )
    points_min: int = Field(
        12, ge=1, description="Minimum number of returns behind the plane in a line. III.C, condition 2."
    )
    lines_min: int = Field(2, ge=1, description="Minimum number of neighbouring lines in an opening. III.C.")


class DoorState(IntEnum):
    CLOSED = 0
    OPEN = 1


class Depression(IntEnum):
    """Whether condition 2 held, and what it failed by; tried in this order."""

    FEW_RETURNS = 0  # the line has too few returns at its plane and behind it
    NONE = 1  # nowhere do the returns below lie behind those above by the minimum depth
    ABOVE_OFF_PLANE = 2  # the returns above the split do not lie on the plane
    SHALLOW = 3  # the returns below the split lie less than the minimum depth behind the plane
    EXCEPTIONS = 4  # too many returns below the split lie on the plane
    HELD = 5


@dataclass(frozen=True)
class DoorLines:
    """The three conditions for each line that belongs to a wall plane, tried in order.

    line, plane: (D,) the point line and the wall plane that its up-most structure belongs to (condition 1 held).
    behind: (D,) bool, condition 2: from some point downwards all of its returns lie behind the plane.
    start_height_m: (D,) height above the floor of the return at which that begins; NaN where condition 2 failed.
    high_enough: (D,) bool, condition 3: it begins at least the door's minimum height above the floor.
    depth_m: (D,) mean distance behind the plane below the start, `_DEPTH_MAX_M` at most a return;
        NaN where condition 2 failed.
    state: (D,) uint8, see `DoorState`; has a meaning where all three conditions held.
    position: (D, 2) x and y on the plane where the line passes below the start.

    What condition 2 measured; NaN where it failed earlier:
    depression: (D,) uint8, see `Depression`.
    recess_m: (D,) the largest step back, mean above less mean below, over all splits.
    above_m, below_m: (D,) mean distance before the plane above and below the best split; negative is behind.
    on_plane_share: (D,) share of the returns below the split that lie on the plane.
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
    """Neighbouring lines above a door taken together: one row for each opening that this scan shows.

    plane: (O,) its wall plane.
    ends: (O, 2, 2) x and y of its two sides, on the plane.
    head_m: (O,) height of the lintel's underside.
    depth_m: (O,) median depth of what lies behind.
    state: (O,) uint8, see `DoorState`.
    line_count: (O,) how many lines showed it.
    door_line_opening: (D,) the opening that each row of the `DoorLines` is part of, -1 where it is of none: its
        conditions did not hold, or too few neighbours' did.
    """

    plane: IntArray
    ends: FloatArray
    head_m: FloatArray
    depth_m: FloatArray
    state: UInt8Array
    line_count: IntArray
    door_line_opening: IntArray

    def __len__(self) -> int:
        return len(self.plane)


def find_door_lines(
    returns: Returns, lines: PointLines, planes: WallPlanes, upmost: IntArray, settings: DoorsSettings
) -> DoorLines:
    """Conditions 1 to 3 for every line whose up-most structure belongs to a wall plane.

    Of a line, all returns count, the floor's too: seen through an open door they lie behind the wall and prove that it
    is "connected to the floor". Where the plane ends and the depression begins is the split of the line, from top to
    bottom, that parts its distances best: single returns scatter as much as a closed leaf is recessed.

    lines: the point lines (L) of these returns.
    planes: the scan's wall planes, with the candidates that they were made from.
    upmost: (L,) index of each line's up-most vertical structure, -1 where it has none: `VerticalStructures.upmost`.
    """
    member = (planes.candidate_plane >= 0) & (upmost[planes.candidate_line] == planes.candidate_structure)
    line, plane = planes.candidate_line[member], planes.candidate_plane[member]
    start, depth_m, position, depression, measured = _split_lines(
        returns.points_level,
        returns.height_m,
        lines.order,
        lines.starts,
        line,
        plane,
        planes.normal,
        planes.offset_m,
        np.ascontiguousarray(returns.origin_level, np.float64),
        settings.recess_min_m,
        # The wall above may be off its plane by half of a recess, and by a centimetre that the plane itself is off.
        0.5 * settings.recess_min_m + 0.01,
        # What lies a quarter of a recess behind the plane is on it.
        0.25 * settings.recess_min_m,
        # A few far returns behind an open door weigh no more than a leaf's many when the split is looked for.
        2.0 * settings.open_depth_m,
        settings.lintel_min_m,
        settings.exceptions_max,
        settings.points_min,
    )
    behind = start >= 0
    start_height_m = np.where(behind, returns.height_m[start], np.nan)
    return DoorLines(
        line=line,
        plane=plane,
        behind=behind,
        start_height_m=start_height_m,
        high_enough=behind & (start_height_m >= settings.height_min_m) & (start_height_m <= settings.height_max_m),
        depth_m=depth_m,
        state=np.where(depth_m > settings.open_depth_m, DoorState.OPEN, DoorState.CLOSED).astype(np.uint8),
        position=position,
        depression=depression,
        recess_m=measured[:, 0],
        above_m=measured[:, 1],
        below_m=measured[:, 2],
        on_plane_share=measured[:, 3],
    )


def find_openings(door_lines: DoorLines, planes: WallPlanes, settings: DoorsSettings) -> Openings:
    """Neighbouring lines above a door, of one plane and one state, as openings."""
    chosen = np.flatnonzero(door_lines.above_door)
    along = np.stack([-planes.normal[:, 1], planes.normal[:, 0]], axis=1)
    place_m = np.sum(door_lines.position[chosen] * along[door_lines.plane[chosen]], axis=1)
    walk = np.lexsort((place_m, door_lines.state[chosen], door_lines.plane[chosen]))
    chosen, place_m = chosen[walk], place_m[walk]
    plane, state = door_lines.plane[chosen], door_lines.state[chosen]
    apart = np.diff(place_m) > _GAP_MAX_M
    breaks = np.flatnonzero((np.diff(plane) != 0) | (np.diff(state) != 0) | apart) + 1
    groups = [g for g in np.split(np.arange(len(chosen)), breaks) if len(g) >= settings.lines_min]
    door_line_opening = np.full(len(door_lines.line), -1, np.int32)
    for opening, group in enumerate(groups):
        door_line_opening[chosen[group]] = opening
    first = np.array([g[0] for g in groups], np.intp)
    low_high = np.array([[place_m[g[0]], place_m[g[-1]]] for g in groups]).reshape(-1, 2)
    owner = plane[first]
    foot = planes.normal[owner] * planes.offset_m[owner][:, None]
    return Openings(
        plane=owner,
        ends=foot[:, None, :] + along[owner][:, None, :] * low_high[:, :, None],
        head_m=np.array([np.median(door_lines.start_height_m[chosen[g]]) for g in groups]),
        depth_m=np.array([np.median(door_lines.depth_m[chosen[g]]) for g in groups]),
        state=state[first],
        line_count=np.array([len(g) for g in groups], np.int32),
        door_line_opening=door_line_opening,
    )


@numba.njit(cache=True, nogil=True)
def _split_lines(
    points: FloatArray,
    height: FloatArray,
    order: IntArray,
    starts: IntArray,
    line: IntArray,
    plane: IntArray,
    normal: FloatArray,
    offset: FloatArray,
    origin: FloatArray,
    recess_min_m: float,
    above_off_max_m: float,
    on_plane_m: float,
    split_depth_max_m: float,
    lintel_min_m: float,
    exceptions_max: float,
    points_min: int,
) -> tuple[IntArray, FloatArray, FloatArray, UInt8Array, FloatArray]:  # pragma: no cover
    """Condition 2 for lines (D,) on their planes (D,), from the top of each line down.

    Returns the return (D,) at which the depression begins, -1 where there is none; `depth_m`, `position` and `depression`
    of `DoorLines`, and (D, 4) what was measured: recess, above, below, share on the plane.
    """
    count = len(line)
    start = np.full(count, -1, np.int32)
    depth = np.full(count, np.nan)
    position = np.full((count, 2), np.nan)
    depression = np.full(count, Depression.FEW_RETURNS, np.uint8)
    measured = np.full((count, 4), np.nan)
    for d in range(count):
        nx, ny, off = normal[plane[d], 0], normal[plane[d], 1], offset[plane[d]]
        first, last = starts[line[d]], starts[line[d] + 1]
        # From the top down: where the line first lies on its plane, the wall begins.
        top = last - 1
        while (
            top >= first
            and abs(nx * points[order[top], 0] + ny * points[order[top], 1] - off)
            > _WALL_DISTANCE_M
        ):
            top -= 1
        # From there to the line's lower end: what stands before the plane is skipped, for it hides the wall.
        total, weight = 0.0, 0.0
        for j in range(first, top + 1):
            i = order[j]
            s = nx * points[i, 0] + ny * points[i, 1] - off
            if s < _BEFORE_M:
                total += max(s, -split_depth_max_m)
                weight += 1.0
        if weight < points_min + 3:  # of the wall above
            continue
        depression[d] = Depression.NONE
        best, best_j = 0.0, -1
        above_sum, above_n = 0.0, 0.0
        for j in range(top, first, -1):
            i = order[j]
            s = nx * points[i, 0] + ny * points[i, 1] - off
            if s >= _BEFORE_M:
                continue
            above_sum += max(s, -split_depth_max_m)
            above_n += 1.0
            below_n = weight - above_n
            if below_n < points_min:
                break
            if height[order[top]] - height[i] < lintel_min_m:
                continue
            gap = above_sum / above_n - (total - above_sum) / below_n
            measured[d, 0] = gap if np.isnan(measured[d, 0]) else max(gap, measured[d, 0])
            score = gap * gap * above_n * below_n / weight
            if gap > recess_min_m and score > best:
                best, best_j = score, j
        if best_j < 0:
            continue
        # Above the split the wall stands on its plane, below it all but a few returns lie behind.
        reach = nx * origin[0] + ny * origin[1] - off
        above, above_n, below, below_n, on_plane, x, y, crossings = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(first, top + 1):
            i = order[j]
            s = nx * points[i, 0] + ny * points[i, 1] - off
            if s >= _BEFORE_M:
                continue
            if j >= best_j:
                above += max(s, -_DEPTH_MAX_M)
                above_n += 1.0
                continue
            below += max(s, -_DEPTH_MAX_M)
            below_n += 1.0
            if s > -on_plane_m:
                on_plane += 1.0
            # Where the ray passed through the plane.
            t = reach / max(reach - s, 1e-6)
            x += origin[0] + t * (points[i, 0] - origin[0])
            y += origin[1] + t * (points[i, 1] - origin[1])
            crossings += 1.0
        measured[d, 1], measured[d, 2], measured[d, 3] = above / above_n, below / below_n, on_plane / below_n
        if abs(above / above_n) > above_off_max_m:
            depression[d] = Depression.ABOVE_OFF_PLANE
            continue
        if below / below_n > -recess_min_m:
            depression[d] = Depression.SHALLOW
            continue
        if on_plane > exceptions_max * below_n:
            depression[d] = Depression.EXCEPTIONS
            continue
        depression[d] = Depression.HELD
        start[d] = order[best_j]
        depth[d] = -below / below_n
        position[d, 0], position[d, 1] = x / crossings, y / crossings
    return start, depth, position, depression, measured
