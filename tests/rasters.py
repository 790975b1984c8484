"""Walls of a small plan, and grid maps drawn from walls."""

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.maps.grid import Cell, GridMap

PLAN = np.array(
    [
        [[0, 0], [9, 0]], [[9, 0], [9, 6]], [[9, 6], [0, 6]], [[0, 6], [0, 0]],
        [[4, 0], [4, 3.5]], [[4, 4.5], [4, 6]], [[4, 2], [6.5, 2]], [[7.5, 2], [9, 2]],
    ],
    float,
)  # fmt: skip


def moved(plan: FloatArray, turn_deg: float, shift: tuple[float, float]) -> FloatArray:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return plan @ np.array([[c, s], [-s, c]]) + np.array(shift)


def raster(
    plan: FloatArray, cell_m: float = 0.05, noise_m: float = 0.0, furniture: int = 0
) -> GridMap:
    generator = np.random.default_rng(0)
    dots = np.concatenate([a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in plan])
    dots = dots + generator.normal(0, noise_m, dots.shape) if noise_m else dots
    low, high = dots.min(axis=0), dots.max(axis=0)
    dots = np.concatenate([dots, generator.uniform(low, high, (furniture, 2))])
    origin = np.floor((low - 0.5) / cell_m) * cell_m
    columns, rows = np.ceil((high + 0.5 - origin) / cell_m).astype(int)
    cells = np.full((rows, columns), Cell.FREE, np.uint8)
    index = np.clip(np.floor((dots - origin) / cell_m).astype(int), 0, [columns - 1, rows - 1])
    cells[index[:, 1], index[:, 0]] = Cell.OCCUPIED
    return GridMap(cells, origin, cell_m)
