"""Walls that no single scan shows as a plane: lines along which the returns of all scans stand.

Columns of returns that belong to no face are searched for lines in the walls' directions, and what
is left for chords of round walls. Each line is parsed like a face, from both its sides; it has to
show itself as a wall where a face that scans saw as a plane may stay hidden.
"""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import pairs_near
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.evidence import NEAR, ON
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_WALLS,
    BuildingSettings,
    Walls,
    cells_in,
    unknown_support,
)
from ffmap.algorithms.building.parse import DOORS, OF_WALLS, OPENINGS, Kind
from ffmap.algorithms.building.settle import ParsedFaces, Run, has_jambs, standing, wall_odds
from ffmap.algorithms.building.verdicts import ACROSS, SAME_WAY
from ffmap.algorithms.scan.wall_planes import fit_upright_plane

Line = tuple[FloatArray, FloatArray]
"""Ends (2, 2) and normal (2,)."""
_ROW_RETURNS_MIN = 2
"""Least returns of a row of cells that show how high a line stands."""
_DOORS_SHARE_MAX, _OPEN_SHARE_MAX = 0.5, 2 / 3
"""Greatest share of a wall's length that is doors, and that is doors and windows. The robot's way
through scattered returns looks like a doorway."""
_TRACED_TO_M = 4.0
"""Height up to which rays are counted against lines, of whose tops nothing is known yet."""


class UnseenWallsSettings(StepSettings):
    """Walls that only all scans together show."""

    explained_m: float = Field(
        0.08, gt=0, description="Maximum distance (m) from a known face of its own returns."
    )
    half_thickness_m: float = Field(
        0.04, gt=0, description="Half thickness (m) of a wall's returns: range noise and drift."
    )
    beside_m: float = Field(
        0.1, gt=0, description="A line this near (m) to a face that looks the same way is its own."
    )
    faced_m: float = Field(
        0.5, gt=0, description="Between two faces that look at each other nobody stands: no nearer."
    )
    shelf_m: float = Field(
        0.6, gt=0, description="Maximum depth (m) of shelves, whose boards' edges seem a pane."
    )
    chord_m: float = Field(0.35, gt=0, description="Minimum length (m) of a chord of a round wall.")
    odds_min: float = Field(
        10.0, ge=0, description="Least odds (nats) of a wall against the next kind: it must show."
    )
    returns_min: int = Field(20, ge=1, description="Least returns that prove it.")
    scatter_max_m: float = Field(
        0.05,
        gt=0,
        description="Greatest scatter (m, rms) of a wall's returns; what is strewn has more.",
    )


@dataclass(frozen=True)
class Columns:
    """Upright columns of voxels.

    place: (m, 2) x and y. weight: (m,) voxels in each, many as few. top_m: (m,) z of the highest.
    """

    place: FloatArray
    weight: FloatArray
    top_m: FloatArray


def walls_of(
    parsed: ParsedFaces,
    lines: IntArray,
    known: Walls,
    building: BuildingSettings,
    settings: UnseenWallsSettings,
) -> tuple[Walls, list[Run]]:
    """The parts of parsed lines that show themselves as walls.

    lines: which of the faces are such. known: the walls that scans see as planes.
    """
    faces, walls, runs = parsed.faces, NO_WALLS, list[Run]()
    gap = cells_in(building.gap_m)
    for w in lines[~_taken(faces.walls.select(lines), known, settings)]:
        stretches, ended = parsed.stretches[w], faces.evidence.ended[faces.columns(w)]
        likely = [
            run
            for run in standing(stretches, gap)
            if wall_odds(stretches, *run) >= settings.odds_min
            and has_jambs(stretches, *run, ended, building.knee_m)
        ]
        if not likely or _taken(faces.walls.one(w), walls, settings)[0]:
            continue
        crossed = _crossed_by(known, faces.walls, w, len(ended))
        seen = np.isfinite(faces.clear_m[faces.columns(w)]) & ~crossed
        for first, after in likely:
            own = [s for s in stretches if first <= s.first < after and s.kind in OF_WALLS]
            on = sum(float(ended[s.columns, :, ON].sum()) for s in own if s.kind == Kind.WALL)
            doors, opened = (
                sum(s.after - s.first for s in own if s.kind in kinds) / (after - first)
                for kinds in (DOORS, OPENINGS)
            )
            is_open = doors > _DOORS_SHARE_MAX or opened > _OPEN_SHARE_MAX
            if on < settings.returns_min or seen[first:after].mean() <= 0.5 or is_open:
                continue
            wall = _as_seen(parsed, (w, first, after))
            # Spread evenly over the layers that are asked, 22 cm, returns would scatter 6.4 cm.
            if wall.rms_m[0] <= settings.scatter_max_m:
                walls = walls.append(wall)
                runs.append((w, first, after))
    return walls, runs


def _taken(lines: Walls, walls: Walls, settings: UnseenWallsSettings) -> BoolArray:
    """(L,) whether a line is a wall's own, or faces one so near that nobody can stand between."""
    middles = lines.ends.mean(axis=1)
    faced = near_a_face(middles, -lines.normal, walls, 0.0, settings.faced_m)
    beside = near_a_face(middles, lines.normal, walls, -settings.beside_m, settings.beside_m)
    return faced | beside


def _as_seen(parsed: ParsedFaces, part: Run) -> Walls:
    """A stretch of a line as a single face, as high as rays ended on it."""
    faces, (w, first, after) = parsed.faces, part
    columns = slice(faces.columns(w).start + first, faces.columns(w).start + after)
    on = faces.evidence.ended[columns, :, ON].sum(axis=0, dtype=np.float64)
    near = float(faces.evidence.ended[columns, :, : NEAR + 1].sum())
    rms_m = np.sqrt(float(faces.evidence.depth_squares[columns].sum()) / near)
    seen = np.flatnonzero(on >= min(_ROW_RETURNS_MIN, on.max()))
    top_m = min((seen[-1] + 1) * CELL_M, float(faces.top_m[columns].max()))
    return replace(
        parsed.cut([part]),
        bottom_m=np.array([seen[0] * CELL_M]),
        top_m=np.array([top_m]),
        rms_m=np.array([rms_m]),
        sample_count=np.array([on.sum()], np.int64),
    )


def both_sides(lines: list[Line]) -> Walls:
    """The lines as faces: which side each is seen from is not known yet, so both are tried."""
    ends = np.array([e for e, _ in lines]).reshape(-1, 2, 2)
    normal = np.array([n for _, n in lines]).reshape(-1, 2)
    top_m = np.full(len(ends), _TRACED_TO_M)
    return unseen_faces(ends, normal, top_m).append(unseen_faces(ends[:, ::-1], -normal, top_m))


def unseen_faces(ends: FloatArray, normal: FloatArray, top_m: FloatArray) -> Walls:
    """Faces (k, 2, 2) that stand on the floor, of which no scan saw a plane."""
    count = len(ends)
    return Walls(
        ends=ends,
        normal=normal,
        bottom_m=np.zeros(count),
        top_m=top_m,
        scan_count=np.zeros(count, np.int32),
        rms_m=np.full(count, np.nan),
        sample_count=np.zeros(count, np.int64),
        support=unknown_support(count),
    )


def unexplained_columns(votes: VoxelVotes, faces: Walls, settings: UnseenWallsSettings) -> Columns:
    """Upright columns of voxels that no face explains, neither walls nor refused ones."""
    label = votes.label
    unexplained = (label == Label.CLUTTER) | (label == Label.WALL)
    unexplained &= votes.counts.max(axis=1, initial=0) > 0
    position, count = votes.mean_position[unexplained], votes.point_count[unexplained]
    free = np.ones(len(position), bool)
    free[pairs_near(faces, position, settings.explained_m)[0]] = False
    position, count = position[free], count[free]
    cell = np.floor(position[:, :2] / CELL_M).astype(np.int64)
    _, column = np.unique(cell, axis=0, return_inverse=True)
    column = column.ravel()
    columns = int(column.max(initial=-1)) + 1
    returns = np.bincount(column, count, columns)
    sums = [np.bincount(column, count * position[:, axis], columns) for axis in (0, 1)]
    place = np.stack([total / returns for total in sums], axis=1)
    cubes = np.bincount(column, minlength=columns)
    top_m = np.full(columns, -np.inf)
    np.maximum.at(top_m, column, position[:, 2])
    stands = cubes >= 3
    weight = np.minimum(cubes[stands], 20).astype(np.float64)
    return Columns(place[stands], weight, top_m[stands])


def straight_lines(
    columns: Columns, normals: FloatArray, gap_m: float, settings: UnseenWallsSettings
) -> list[Line]:
    """Stretches of columns in line, the strongest first, each column in one.

    normals: (k, 2) the lines' directions. gap_m: no gap within one is longer.
    """
    place, weight, half_thickness_m = columns.place, columns.weight, settings.half_thickness_m
    bin_m = 0.5 * half_thickness_m
    left = np.ones(len(place), bool)
    across = [place @ normal for normal in normals]
    along = [place @ np.array([-normal[1], normal[0]]) for normal in normals]
    bins = [np.floor((a - a.min(initial=0.0)) / bin_m).astype(np.int64) for a in across]
    dead = [np.zeros(int(b.max(initial=0)) + 3, bool) for b in bins]
    found: list[Line] = []
    while len(normals) and left.any():
        best, direction, at = 0.0, 0, 0
        for d in range(len(normals)):
            strength = np.bincount(bins[d][left], weight[left], len(dead[d]))
            strength = np.where(dead[d], 0.0, np.convolve(strength, np.ones(3), "same"))
            if strength.max() > best:
                best, direction, at = float(strength.max()), d, int(np.argmax(strength))
        if best < 9.0:
            break
        centre = float(across[direction].min(initial=0.0)) + (at + 0.5) * bin_m
        near = np.flatnonzero(left & (np.abs(across[direction] - centre) < half_thickness_m))
        near = near[np.argsort(along[direction][near])]
        breaks = np.flatnonzero(np.diff(along[direction][near]) > gap_m) + 1
        parts = [
            part
            for part in np.split(near, breaks)
            if len(part) >= 3 and np.ptp(along[direction][part]) > 3 * CELL_M
        ]
        if not parts:
            dead[direction][at] = True
            continue
        part = max(parts, key=lambda p: float(weight[p].sum()))
        left[part] = False
        normal = normals[direction]
        offset = float(np.average(across[direction][part], weights=weight[part]))
        reach = along[direction][part][[0, -1]] + np.array([-0.5, 0.5]) * CELL_M
        ends = normal * offset + reach[:, None] * np.array([-normal[1], normal[0]])
        found.append((ends, normal))
    return found


def lines_of_any_direction(place: FloatArray, settings: UnseenWallsSettings) -> list[Line]:
    """Stretches of columns (n, 2) in line, whatever their direction, each column in one."""
    if not len(place):
        return []
    tree, left = cKDTree(place), np.ones(len(place), bool)
    found: list[Line] = []
    for seed in range(len(place)):
        if not left[seed]:
            continue
        near = np.array(tree.query_ball_point(place[seed], settings.chord_m))
        near = near[left[near]]
        for _ in range(2):
            # The line of least squares, without what is off it.
            if len(near) < 3:
                break
            middle = place[near].mean(axis=0)
            x, y = (place[near] - middle).T
            nx, ny, *_ = fit_upright_plane(np.array([len(near), 0, 0, x @ x, x @ y, y @ y]))
            along, normal = np.array([ny, -nx]), np.array([-nx, -ny])
            off_m = np.abs((place[near] - middle) @ normal)
            near = near[off_m < 0.5 * settings.half_thickness_m]
        reach = np.sort((place[near] - middle) @ along) if len(near) >= 3 else np.zeros(1)
        if reach[-1] - reach[0] < settings.chord_m or np.diff(reach).max() > 3 * CELL_M:
            continue
        left[near] = False
        ends_m = reach[[0, -1]] + np.array([-0.5, 0.5]) * CELL_M
        found.append((middle + ends_m[:, None] * along, normal))
    return found


def near_a_face(
    places: FloatArray, normals: FloatArray, walls: Walls, above_m: float, below_m: float
) -> BoolArray:
    """(k,) whether each place (k, 2) is so far before a face that looks as its normal (k, 2)."""
    near = np.zeros(len(places), bool)
    for face in segments(walls):
        before_m = face.before_m(places)
        looks = normals @ face.normal > SAME_WAY
        near |= looks & face.beside(places) & (before_m > above_m) & (before_m < below_m)
    return near


def _crossed_by(walls: Walls, candidates: Walls, w: int, count: int) -> BoolArray:
    """(count,) the columns of one candidate at which it crosses a known face."""
    crossed = np.zeros(count, bool)
    candidate = segment(candidates, w)
    for face in segments(walls):
        if abs(face.normal @ candidate.normal) > ACROSS:
            continue
        towards = float(candidate.along @ face.normal)
        column = int(-face.before_m(candidate.start) / towards // CELL_M)
        place = candidate.at(np.array([(column + 0.5) * CELL_M]))
        if 0 <= column < count and face.beside(place)[0]:
            crossed[column] = True
    return crossed
