"""A grid map laid over another map of the same building, a drawing or another drive's, and compared with it."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, distance_transform_edt
from scipy.spatial import cKDTree

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.maps import WALL_TOLERANCE_M, WallMapFigures


@dataclass(frozen=True)
class Alignment:
    """T_reference_map: (3, 3) the rigid motion that lays the map over the reference.

    share: of the map's occupied cells that then lie within 10 cm of one of the reference's.
    """

    T_reference_map: FloatArray
    share: float

    @property
    def fits(self) -> bool:
        """Whether the two show the same building; the walls of two buildings never agree by as much."""
        return self.share >= 0.6

    @property
    def turn_deg(self) -> float:
        return float(np.degrees(np.arctan2(self.T_reference_map[1, 0], self.T_reference_map[0, 0])))

    @property
    def shift_m(self) -> FloatArray:
        """(2,) where the map's origin lies in the reference."""
        return np.asarray(self.T_reference_map[:2, 2])

    def to_map(self, places_reference: FloatArray) -> FloatArray:
        """Places (n, 2) of the reference in the map's frame."""
        R, t = self.T_reference_map[:2, :2], self.T_reference_map[:2, 2]
        return np.asarray((places_reference - t) @ R)


def align_maps(grid: GridMap, reference: GridMap) -> Alignment:
    """The turn and shift, from wherever, that lay a map over another; neither scale nor mirror image.

    Every turn in steps of 2° is tried with every shift at once, by correlation with the blurred reference (Chen and
    Defrise, 1994); the best are refined by iterative closest points (Besl and McKay, 1992) with Tukey's weights, and the
    one with most cells within 10 cm stands.
    """
    source, target = wall_cells(grid), wall_cells(reference)
    if not len(source) or not len(target):
        return Alignment(np.eye(3), 0.0)
    points_max = 4_000
    if len(source) > points_max:
        source = np.random.default_rng(0).choice(source, points_max, replace=False)
    tree = cKDTree(target)
    best = Alignment(np.eye(3), -1.0)
    for T in _coarse(source, target):
        T = _refine(T, source, target, tree)
        share = float(np.mean(tree.query(source @ T[:2, :2].T + T[:2, 2])[0] <= WALL_TOLERANCE_M))
        if share > best.share:
            best = Alignment(T, share)
    return best


def wall_cells(grid: GridMap) -> FloatArray:
    """(m, 2) the middles of the occupied cells that are not inside others: a thick wall's faces, a thin wall's all."""
    occupied = grid.cells == Cell.OCCUPIED
    inner = binary_erosion(occupied, border_value=1)
    return grid.middles(occupied & ~inner)


def _coarse(source: FloatArray, target: FloatArray) -> list[FloatArray]:
    """The best motions (3, 3) of the correlation, one for each turn, best first."""
    # A second to import, which every process would wait for.
    from scipy.signal import fftconvolve

    cell_min_m, cells_max, turn_step_deg, blur_cells, best_max = 0.2, 400, 2.0, 1.5, 12
    centre = source.mean(axis=0)
    reach = float(np.linalg.norm(source - centre, axis=1).max())
    size = max(float(np.ptp(target, axis=0).max()), 2 * reach)
    cell_m = max(cell_min_m, size / cells_max)
    low = target.min(axis=0) - 2 * cell_m
    shape = (np.ceil((np.ptp(target, axis=0) + 4 * cell_m) / cell_m)).astype(int) + 1
    hit = np.zeros(shape, bool)
    hit[tuple(np.floor((target - low) / cell_m).astype(int).T)] = True
    near = np.exp(-0.5 * (distance_transform_edt(~hit) / blur_cells) ** 2)
    half = int(np.ceil(reach / cell_m)) + 1
    found: list[tuple[float, FloatArray]] = []
    for turn in np.radians(np.arange(0.0, 360.0, turn_step_deg)):
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        index = np.floor(((source - centre) @ R.T) / cell_m).astype(int) + half
        kernel = np.zeros((2 * half + 1, 2 * half + 1))
        np.add.at(kernel, tuple(index.T), 1.0)
        score = fftconvolve(near, np.minimum(kernel, 3.0)[::-1, ::-1], mode="full")
        peak = np.unravel_index(int(np.argmax(score)), score.shape)
        # Index k of the full correlation lays the kernel's middle on cell k - half.
        middle = low + (np.array(peak) - half + 0.5) * cell_m
        T = np.eye(3)
        T[:2, :2], T[:2, 2] = R, middle - R @ centre
        found.append((float(score[peak]), T))
    found.sort(key=lambda candidate: -candidate[0])
    return [T for _, T in found[:best_max]]


def _refine(T: FloatArray, source: FloatArray, target: FloatArray, tree: cKDTree) -> FloatArray:
    """Closest points with weights that forget what lies far off, ever nearer."""
    for reach_m in np.geomspace(1.0, 2 * WALL_TOLERANCE_M, 40):
        moved = source @ T[:2, :2].T + T[:2, 2]
        distance, nearest = tree.query(moved)
        weight = np.where(distance < reach_m, (1 - (distance / reach_m) ** 2) ** 2, 0.0)
        if np.count_nonzero(weight) < 3:
            return T
        a, b = np.average(moved, axis=0, weights=weight), np.average(target[nearest], axis=0, weights=weight)
        U, _, Vt = np.linalg.svd(((target[nearest] - b) * weight[:, None]).T @ (moved - a))
        step = np.eye(3)
        step[:2, :2] = U @ np.diag([1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        step[:2, 2] = b - step[:2, :2] @ a
        T = step @ T
    return T


def compare_with_reference(grid: GridMap, known: GridMap, reference: GridMap, alignment: Alignment) -> WallMapFigures:
    """A map's occupied cells against those of a reference, in the map's frame.

    known: the map that says what was seen at all: of the reference's walls only those beside its free or occupied cells
    can be missed. A cell is right within 10 cm of a wall of the reference.
    """
    walls = alignment.to_map(wall_cells(reference))
    occupied = grid.centres(Cell.OCCUPIED)
    seen = _near_known(walls, known)
    distance = cKDTree(walls).query(occupied)[0] if len(walls) else np.full(len(occupied), np.inf)
    nearest = cKDTree(occupied).query(walls[seen])[0] if len(occupied) else np.full(int(seen.sum()), np.inf)
    return WallMapFigures(occupied, distance, walls[seen], nearest <= WALL_TOLERANCE_M + 1e-9)


def unseen_walls(known: GridMap, reference: GridMap, alignment: Alignment) -> FloatArray:
    """(m, 2) the reference's walls, in the map's frame, of which the map knows nothing."""
    walls = alignment.to_map(wall_cells(reference))
    return walls[~_near_known(walls, known)]


def _near_known(places: FloatArray, known: GridMap) -> BoolArray:
    """(n,) whether places (n, 2) lie within 15 cm of what a map knows."""
    reach = max(1, round(0.15 / known.cell_m))
    near = binary_dilation(known.cells != Cell.UNKNOWN, np.ones((3, 3)), iterations=reach)
    index, inside = known.index(places)
    found = np.zeros(len(places), bool)
    found[inside] = near[index[inside, 1], index[inside, 0]]
    return found
