"""Lines in the plan along which returns stand that no known face explains: walls, or panes, that no single scan showed."""

from dataclasses import replace

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import pairs_near
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.model import CELL_M, Walls
from ffmap.algorithms.building.votes import VoxelVotes

Line = tuple[FloatArray, FloatArray]
"""Ends (2, 2) and normal (2,)."""
_TRACED_TO_M = 5.0
"""Height up to which rays are counted against lines, of whose tops nothing is known yet."""


def both_sides(lines: list[Line]) -> Walls:
    """The lines as faces: which side each is seen from is not known yet, so both are tried."""
    ends, normal = np.array([e for e, _ in lines]).reshape(-1, 2, 2), np.array([n for _, n in lines]).reshape(-1, 2)
    faces = unseen_faces(ends, normal, np.full(len(ends), _TRACED_TO_M))
    return faces.append(from_behind(faces))


def from_behind(faces: Walls) -> Walls:
    """The same faces, seen from their other side."""
    return replace(faces, ends=faces.ends[:, ::-1], normal=-faces.normal)


def unseen_faces(ends: FloatArray, normal: FloatArray, top_m: FloatArray) -> Walls:
    """Faces (k, 2, 2) that stand on the floor, of which no scan saw a plane, for rays to be counted against."""
    count = len(ends)
    return Walls(
        ends=ends,
        normal=normal,
        bottom_m=np.zeros(count),
        top_m=top_m,
        scan_count=np.zeros(count, np.int32),
        rms_m=np.full(count, np.nan),
        sample_count=np.zeros(count, np.int64),
    )


def unexplained_columns(
    votes: VoxelVotes, walls: Walls, refused: Walls, explained_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Upright columns of cubes that no face explains: x and y (m, 2), the number of cubes in each, and z of the highest (m,)."""
    label = votes.label
    unexplained = ((label == Label.CLUTTER) | (label == Label.WALL)) & (votes.counts.max(axis=1, initial=0) > 0)
    position, count = votes.mean_position[unexplained], votes.point_count[unexplained]
    free = np.ones(len(position), bool)
    free[pairs_near(walls.append(refused), position, explained_m)[0]] = False
    position, count = position[free], count[free]
    cell = np.floor(position[:, :2] / CELL_M).astype(np.int64)
    _, column = np.unique(cell, axis=0, return_inverse=True)
    column = column.ravel()
    columns = int(column.max(initial=-1)) + 1
    weight = np.bincount(column, count, columns)
    place = np.stack([np.bincount(column, count * position[:, axis], columns) / weight for axis in (0, 1)], axis=1)
    cubes = np.bincount(column, minlength=columns)
    top_m = np.full(columns, -np.inf)
    np.maximum.at(top_m, column, position[:, 2])
    stands = cubes >= 3
    return place[stands], np.minimum(cubes[stands], 20).astype(np.float64), top_m[stands]


def straight_lines(
    place: FloatArray, weight: FloatArray, normals: FloatArray, half_thickness_m: float, gap_m: float
) -> list[Line]:
    """Stretches of columns in line, the strongest first, each column in one: ends (2, 2) and normal (2,).

    half_thickness_m: of their returns. gap_m: no gap within one is longer.
    """
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
        parts = [p for p in np.split(near, breaks) if len(p) >= 3 and np.ptp(along[direction][p]) > 3 * CELL_M]
        if not parts:
            dead[direction][at] = True
            continue
        part = max(parts, key=lambda p: float(weight[p].sum()))
        left[part] = False
        normal = normals[direction]
        offset = float(np.average(across[direction][part], weights=weight[part]))
        reach = along[direction][part][[0, -1]] + np.array([-0.5, 0.5]) * CELL_M
        found.append((normal * offset + reach[:, None] * np.array([-normal[1], normal[0]]), normal))
    return found
