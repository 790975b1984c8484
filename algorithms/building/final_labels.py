"""From the building back to the scans: the final label of every return.

A return at range r is from a surface k of the building with the likelihood

    p(r | k) p(label of the scan | k) p(no other surface hides k),

where r is Gaussian about the range at which the ray meets the surface, with the noise of ranges and
the error of the pose, or an outlier. Surfaces are panels (see `panels`) and the scan's own floor
and ceiling. "Nothing of the building" competes with them: clutter may be anywhere, but not behind a
surface.
"""

from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import cell_at, index_near
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import (
    LENGTH,
    along_line,
    before_line,
    crossing,
    lines_of,
    moved,
)
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.heights import HeightMap
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_DOORS,
    NO_WALLS,
    NO_WINDOWS,
    Blinds,
    Doors,
    Walls,
    Windows,
)
from ffmap.algorithms.building.panels import (
    BACK,
    BOTTOM,
    COLUMN,
    FRONT,
    KIND,
    LABEL,
    TOP,
    WALL,
    Kind,
    pane_depth_m,
    panels_of,
    table_of,
)
from ffmap.algorithms.building.verdicts import JudgedFaces


class RelabellingSettings(StepSettings):
    """Likelihood of returns from the building's surfaces."""

    range_noise_m: float = Field(
        0.018, gt=0, description="Standard deviation (m) of ranges. The lidar's data sheet."
    )
    pose_error_m: float = Field(
        0.007, gt=0, description="Standard deviation (m) of a wall in a scan after alignment."
    )
    level_error_m: float = Field(
        0.005, gt=0, description="Standard deviation (m) of a scan's own floor and ceiling."
    )
    edge_error_m: float = Field(
        0.01, gt=0, description="Standard deviation (m) of the edges of walls, doors and windows."
    )
    outlier_share: float = Field(
        0.02, gt=0, lt=1, description="Share of larger errors, as of returns from two surfaces."
    )
    passed_share: float = Field(
        0.02, gt=0, lt=1, description="Share of rays that pass a surface: errors of the map."
    )
    clutter_per_m: float = Field(
        0.07, gt=0, description="Number of returns from clutter on a metre of a ray."
    )


@dataclass(frozen=True)
class BuildingModel:
    """The building by which scans are relabelled, in the map frame.

    foreground: ceiling height and flat objects before each wall face.
    judged: also contains the refused faces; its own `walls` are not used.
    levels: level surfaces, applied in this order.
    leaf_panes: panes in the leaves of open doors: no window of a wall.
    low_walls: those walls that end below the ceiling.
    passages: openings larger than doors are, without leaves.
    """

    walls: Walls
    foreground: Foreground
    judged: JudgedFaces
    doors: Doors
    windows: Windows
    blinds: Blinds
    levels: tuple[HeightMap, ...]
    leaf_panes: Windows = NO_WINDOWS
    low_walls: Walls = NO_WALLS
    passages: Doors = NO_DOORS

    @property
    def ways(self) -> Doors:
        """Doors, then passages."""
        return self.doors.append(self.passages)


class _Level(Protocol):
    def label_of(self, points_map: FloatArray, label: UInt8Array) -> UInt8Array: ...


@dataclass(frozen=True)
class Relabelled:
    """The final label of each return (n,), what it is from (see `Kind`), and the odds (n,) float32
    of the label against the second best, at most `ODDS_MAX`; NaN for level surfaces of all scans.

    wall: (n,) the number of the wall whose panel it is from; -1 for others.
    """

    label: UInt8Array
    kind: UInt8Array
    odds: FloatArray
    wall: IntArray


ODDS_MAX = 6e4

_LABEL_GIVEN_SURFACE = np.array(
    [
        [0.86, 0.13, 0.003],  # clutter
        [0.06, 0.935, 0.003],  # upright structure
        [0.50, 0.935, 0.003],  # floor and ceiling
        [0.08, 0.13, 0.78],  # closed door
        [0.40, 0.57, 0.010],  # plane that is not a wall
    ]
)[:, [0, 1, 1, 1, 2, 0]]
"""Probability that a scan labels a return from a surface (row) as each of `Label`: measured for
clutter, structure and door in four simulated buildings. Which structure says nothing along edges,
where a scan's labels have the same errors as the distances; neither does clutter above its floor or
below its ceiling, which it finds by the same distance."""
_SURFACE_OF_KIND = np.array([0, 0, 2, 2, 1, 3, 1, 1, 1, 4, 4, 4, 2])
"""The row of each `Kind`."""
_REACH_M = 0.12
"""Maximum distance (m) of outliers from a surface."""
_RANGE_ERROR_MAX_M = 0.2
"""Maximum error (m) of a range, for outliers too."""
_LEVEL_REACH_M = 0.1
"""The same of floor and ceiling. A ceiling that is lower by more is that of another room."""
_LEVEL_BEHIND_M = 0.05
"""The same below the floor and above the ceiling, beyond what a scan labels so itself."""
_LEVEL_PRESENCE = 0.9
"""Probability that a scan's floor or ceiling extends to where a ray crosses its plane."""
_DEPTH_PER_M = 2.0
"""Returns per metre of depth that belongs to a panel: sills, handles, what is near a plane."""
_SINE_MIN = 0.01
_OWN_FROM_M, _OWN_TO_M, _OWN_OFF_M, _OWN_BIN_M, _OWN_RETURNS_MIN = 0.08, 0.7, 0.06, 0.002, 20
"""Heights above the floor, and depths below the ceiling, of the returns that align a scan with a
wall face, their maximum distance (m) from it, the resolution (m), and their minimum number."""
_SCORE, _DEVIATION, _BEYOND, _ERROR, _PRESENCE, _SINE, _CEILING = range(7)
"""Columns of the candidates of a return: likelihood; distance behind the surface in standard
deviations, in metres along the ray, and the error of these; probability that the ray meets it; sine
of the angle between them; height of the ceiling before it."""
_CANDIDATES_MAX = 40
_DEPTH = LENGTH + 1
"""Column of panes: how far behind their wall's face."""

if TYPE_CHECKING:
    _Rules = RelabellingSettings
else:  # compiled code takes named tuples
    _Rules = namedtuple("_Rules", RelabellingSettings.model_fields)


@dataclass(frozen=True)
class Relabelling:
    """A building as tables for compiled code.

    panels: see `table_of`. near: their index, see `index_near`. panes: lines and `_DEPTH`.
    walls: number of wall faces.
    """

    panels: FloatArray
    near: IntArray
    panes: FloatArray
    walls: int
    foreground: Foreground
    levels: Sequence[_Level]
    rules: "_Rules"

    @classmethod
    def of(cls, building: BuildingModel, settings: RelabellingSettings) -> "Relabelling":
        """Prepare a building."""
        panels = panels_of(building)
        # From the middle of their depth panels reach least far.
        half_m = 0.5 * float((panels.front_m + panels.back_m).max(initial=0.0))
        middle = moved(panels.ends, panels.normal, 0.5 * (panels.front_m - panels.back_m))
        reach_m = (
            half_m + _OWN_OFF_M + max(_REACH_M, _RANGE_ERROR_MAX_M + 5.0 * settings.edge_error_m)
        )
        panes = building.windows.append(building.leaf_panes)
        return cls(
            table_of(panels),
            index_near(replace(panels, ends=middle), reach_m),
            np.ascontiguousarray(np.column_stack([lines_of(panes), pane_depth_m(panes)])),
            len(building.walls),
            building.foreground,
            building.levels,
            _Rules(**settings.model_dump()),
        )

    def labels(
        self,
        points_map: FloatArray,
        height_m: FloatArray,
        below_ceiling_m: FloatArray,
        label_scan: UInt8Array,
        origin_map: FloatArray,
    ) -> Relabelled:
        """Relabel the returns of a scan.

        points_map: (n, 3). height_m: (n,) above the scan's floor, from which doors are measured.
        below_ceiling_m: (n,) below the scan's ceiling, infinite without one.
        label_scan: (n,) of the scan alone. origin_map: (3,) the sensor.
        """
        origin = np.ascontiguousarray(origin_map, np.float64)
        returns = points_map, height_m, below_ceiling_m, label_scan
        own_m = _own_offsets(*returns, self.panels, self.near, self.walls)
        label, kind, odds, wall = _likeliest(
            *returns,
            _outside(points_map, origin, self.panes, self.rules),
            origin,
            self.panels,
            self.near,
            own_m,
            self.foreground.clear_m,
            self.foreground.covered,
            self.rules,
        )
        for level in self.levels:
            corrected = level.label_of(points_map, label)
            of_level = corrected != label
            kind[of_level], odds[of_level], wall[of_level] = Kind.LEVEL, np.nan, -1
            label = corrected
        return Relabelled(label, kind, odds, wall)


@numba.njit(cache=True, nogil=True)
def _own_offsets(
    points: FloatArray,
    height: FloatArray,
    below_ceiling: FloatArray,
    label_scan: UInt8Array,
    panels: FloatArray,
    near: IntArray,
    walls: int,
) -> FloatArray:  # pragma: no cover
    """(walls, 2) median distance of the scan's wall before each face, at its foot and its top.

    A pose may be off by a centimetre, and by tenths of a degree, which is as much at the ceiling.
    Without enough returns at one of the two it is that of the other, or 0.
    """
    bins = int(2.0 * _OWN_OFF_M / _OWN_BIN_M)
    counts = np.zeros((walls, 2, bins), np.int64)
    for i in range(len(points)):
        if label_scan[i] != Label.WALL:
            continue
        at_foot = _OWN_FROM_M < height[i] < _OWN_TO_M
        if not at_foot and not _OWN_FROM_M < below_ceiling[i] < _OWN_TO_M:
            continue
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        p = cell_at(near, x, y)
        for q in range(near[p], near[p + 1]):
            k = near[q]
            off_m = before_line(panels, k, x, y)
            if int(panels[k, KIND]) != Kind.WALL or abs(off_m) >= _OWN_OFF_M:
                continue
            if _OWN_OFF_M < along_line(panels, k, x, y) < panels[k, LENGTH] - _OWN_OFF_M:
                place = min(int((off_m + _OWN_OFF_M) / _OWN_BIN_M), bins - 1)
                counts[int(panels[k, WALL]), 0 if at_foot else 1, place] += 1
    own_m = np.zeros((walls, 2))
    for w in range(walls):
        total = counts[w].sum(axis=1)
        for end in range(2):
            told = end if total[end] >= _OWN_RETURNS_MIN else 1 - end
            if total[told] >= _OWN_RETURNS_MIN:
                middle = np.searchsorted(np.cumsum(counts[w, told]), 0.5 * total[told])
                own_m[w, end] = (middle + 0.5) * _OWN_BIN_M - _OWN_OFF_M
    return own_m


@numba.njit(cache=True, nogil=True)
def _outside(
    points: FloatArray, origin: FloatArray, panes: FloatArray, rules: _Rules
) -> BoolArray:  # pragma: no cover
    """(n,) whether a ray passed a pane before its return."""
    outside = np.zeros(len(points), np.bool_)
    margin_m = 3.0 * rules.edge_error_m
    for g in range(len(panes)):
        if before_line(panes, g, origin[0], origin[1]) <= 0.0:
            continue
        for i in range(len(points)):
            x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
            if before_line(panes, g, x, y) <= -panes[g, _DEPTH]:
                _, u = crossing(panes, g, 0.0, x, y, origin, 0.0)
                outside[i] |= -margin_m < u < panes[g, LENGTH] + margin_m
    return outside


@numba.njit(cache=True, nogil=True, forceinline=True, error_model="numpy")
def _density(
    off_m: float, sine: float, error_m: float, rules: _Rules
) -> tuple[float, float]:  # pragma: no cover
    """Density (1/m) along the ray of returns from a surface, and 1 / standard deviation of `off_m`.

    off_m: distance of the return from the surface. error_m: of the surface's position.
    """
    precision = 1.0 / np.sqrt(error_m**2 + (rules.range_noise_m * sine) ** 2)
    peak = (1.0 - rules.outlier_share) * sine * precision / np.sqrt(2.0 * np.pi)
    gaussian = np.exp(-0.5 * (off_m * precision) ** 2)
    return float(peak * gaussian + rules.outlier_share / (2.0 * _REACH_M)), float(precision)


@numba.njit(cache=True, nogil=True, forceinline=True, error_model="numpy")
def _passed(behind: float, presence: float, rules: _Rules) -> float:  # pragma: no cover
    """Probability that a surface does not hide what is behind it by so many standard deviations.

    presence: probability that the ray meets the surface.
    """
    # A cubic approximates the normal distribution to 3 %, in a tenth of the time.
    share = min(max(0.25 * behind + 0.5, 0.0), 1.0)
    hidden = presence * share * share * (3.0 - 2.0 * share)
    return float(1.0 - (1.0 - rules.passed_share) * hidden)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _likeliest(
    points: FloatArray,
    height: FloatArray,
    below_ceiling: FloatArray,
    label_scan: UInt8Array,
    outside: BoolArray,
    origin: FloatArray,
    panels: FloatArray,
    near: IntArray,
    own_m: FloatArray,
    clear_m: FloatArray,
    covered: BoolArray,
    rules: _Rules,
) -> tuple[UInt8Array, UInt8Array, FloatArray, IntArray]:  # pragma: no cover
    """The likeliest label (n,) of each return, what it is from, its odds, and its wall."""
    label, kind = np.zeros(len(points), np.uint8), np.zeros(len(points), np.uint8)
    odds, wall_of = np.zeros(len(points), np.float32), np.full(len(points), -1, np.int32)
    found = np.zeros((_CANDIDATES_MAX, 7))
    of_label, of_kind = np.zeros(_CANDIDATES_MAX, np.uint8), np.zeros(_CANDIDATES_MAX, np.uint8)
    of_wall = np.full(_CANDIDATES_MAX, -1, np.int32)
    sensor_before = np.zeros(len(panels))
    for k in range(len(panels)):
        sensor_before[k] = before_line(panels, k, origin[0], origin[1])
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        height_m, below_m = np.float64(height[i]), np.float64(below_ceiling[i])
        dx, dy, dz = x - origin[0], y - origin[1], z - origin[2]
        range_m = max(float(np.sqrt(dx * dx + dy * dy + dz * dz)), 1e-6)
        dx, dy, dz = dx / range_m, dy / range_m, dz / range_m
        scan = label_scan[i]
        count = 0
        for level in range(2):
            off_m: float = height_m if level == 0 else below_m
            if outside[i] or not -_LEVEL_BEHIND_M < off_m < _LEVEL_REACH_M:
                continue
            sine, error_m = max(abs(dz), _SINE_MIN), rules.level_error_m
            density, precision = _density(off_m, sine, error_m, rules)
            of_label[count] = Label.FLOOR if level == 0 else Label.CEILING
            of_kind[count], of_wall[count] = Kind.FLOOR if level == 0 else Kind.CEILING, -1
            one = (density, -off_m * precision, -off_m / sine, error_m / sine, _LEVEL_PRESENCE)
            found[count, :_SINE] = one
            found[count, _SINE], found[count, _CEILING] = 1.0, np.nan
            count += 1
        p = cell_at(near, x, y)
        for q in range(near[p], near[p + 1]):
            k = near[q]
            this = int(panels[k, KIND])
            if sensor_before[k] <= 0.0 or (outside[i] and this != Kind.BLIND):
                continue
            off_m = before_line(panels, k, x, y)
            wall = int(panels[k, WALL])
            if wall >= 0:
                # Interpolated between foot and top.
                share = min(max(height_m / max(height_m + below_m, 1.0), 0.0), 1.0)
                off_m -= own_m[wall, 0] * (1.0 - share) + own_m[wall, 1] * share
            outer_m = max(off_m - panels[k, FRONT], 0.0) + min(off_m + panels[k, BACK], 0.0)
            if abs(outer_m) > _REACH_M or count == _CANDIDATES_MAX:
                continue
            is_refused, error_m = this == Kind.REFUSED, rules.pose_error_m
            sine = max((sensor_before[k] - off_m) / range_m, _SINE_MIN)
            density, precision = _density(off_m, sine, error_m, rules)
            left_m = off_m
            if is_refused or panels[k, FRONT] + panels[k, BACK] > 0.0:
                # A refused plane is a part of dense clutter.
                in_depth = _DEPTH_PER_M * np.exp(-0.5 * (outer_m * precision) ** 2)
                if is_refused or in_depth > density:
                    density, left_m = in_depth, outer_m
            # The likeliest error of the range; that of the pose is 3 standard deviations at most.
            by_pose_m = left_m * (error_m * precision) ** 2
            step_m = (left_m - min(max(by_pose_m, -3.0 * error_m), 3.0 * error_m)) / sine
            step_m = min(max(step_m, -_RANGE_ERROR_MAX_M), _RANGE_ERROR_MAX_M)
            u = along_line(panels, k, x + step_m * dx, y + step_m * dy)
            at_m, top_m, ceiling_m = height_m + step_m * dz, panels[k, TOP], np.nan
            is_covered = False
            if panels[k, COLUMN] >= 0.0:
                place = min(max(u, 0.0), panels[k, LENGTH] - 1e-6) / CELL_M
                column = min(int(panels[k, COLUMN] + place), len(clear_m) - 1)
                ceiling_m = clear_m[column]
                top_m = max(top_m, ceiling_m) if ceiling_m == ceiling_m else top_m
                row = min(max(int(at_m / CELL_M), 0), covered.shape[1] - 1)
                is_covered = covered[column, row]
            wide_m = max(-u, u - panels[k, LENGTH], 0.0)
            tall_m = max(panels[k, BOTTOM] - at_m, at_m - top_m, 0.0)
            missed = (wide_m**2 + tall_m**2) / rules.edge_error_m**2
            if missed > 25.0:
                continue
            of_label[count], of_kind[count], of_wall[count] = int(panels[k, LABEL]), this, wall
            if is_covered:
                of_label[count], of_kind[count] = Label.CLUTTER, Kind.RELIEF
            met = np.exp(-0.5 * missed) if missed > 0.0 else 1.0
            one = (density * met, -off_m * precision, -off_m / sine, error_m / sine, met)
            found[count, :_SINE] = one
            found[count, _SINE], found[count, _CEILING] = sine, ceiling_m
            if is_refused:
                found[count, _PRESENCE] = 0.0
            count += 1
        nothing = rules.clutter_per_m * _LABEL_GIVEN_SURFACE[0, scan]
        best = -1
        for a in range(count):
            found[a, _SCORE] *= _LABEL_GIVEN_SURFACE[_SURFACE_OF_KIND[of_kind[a]], scan]
            nothing *= _passed(found[a, _DEVIATION], found[a, _PRESENCE], rules)
            for b in range(count):
                of_other_room = (
                    of_kind[b] == Kind.CEILING and found[a, _CEILING] > height_m + _LEVEL_REACH_M
                )
                if a != b and not of_other_room:
                    behind_m = found[b, _BEYOND] - found[a, _BEYOND]
                    error_m = np.sqrt(found[a, _ERROR] ** 2 + found[b, _ERROR] ** 2)
                    found[a, _SCORE] *= _passed(behind_m / error_m, found[b, _PRESENCE], rules)
            if best < 0 or found[a, _SCORE] > found[best, _SCORE]:
                best = a
        label[i] = Label.OUTSIDE if outside[i] else Label.CLUTTER
        kind[i] = Kind.BEYOND_PANE if outside[i] else Kind.NOTHING
        first, second = nothing, 0.0
        if best >= 0:
            # Clutter is as rare a centimetre before a wall, whether the ray grazes it or not.
            first *= found[best, _SINE]
            if found[best, _SCORE] > first:
                second = first if of_label[best] != label[i] else 0.0
                first, label[i], kind[i] = found[best, _SCORE], of_label[best], of_kind[best]
                wall_of[i] = of_wall[best]
        for a in range(count):
            if of_label[a] != label[i]:
                second = max(second, found[a, _SCORE])
        odds[i] = min(first / max(second, 1e-30), ODDS_MAX)
    return label, kind, odds, wall_of
