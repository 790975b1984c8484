"""What surfaces return to a lidar: ranges of diffuse reflectivity at 0.9 µm, and of what a sheen adds at right angles.

Reflectivities are of the order that spectral libraries give for 0.9 µm (ECOSTRESS, JPL): plaster and paint are bright, dyes
that look dark in daylight are not always so in the near infrared, black plastic and rubber are.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np

from ffmap.loaders.simulator.mesh import Material

Name = Literal["paint", "gloss paint", "wood", "concrete", "brick", "tile", "metal", "fabric", "carpet", "plastic", "paper"]

_RANGES: Mapping[Name, tuple[tuple[float, float], tuple[float, float]]] = {
    "paint": ((0.60, 0.90), (0.0, 0.05)),
    "gloss paint": ((0.45, 0.80), (0.1, 0.5)),
    "wood": ((0.35, 0.70), (0.0, 0.3)),
    "concrete": ((0.25, 0.45), (0.0, 0.0)),
    "brick": ((0.30, 0.55), (0.0, 0.0)),
    "tile": ((0.40, 0.75), (0.3, 1.0)),
    "metal": ((0.10, 0.35), (0.6, 1.0)),
    "fabric": ((0.10, 0.70), (0.0, 0.0)),
    "carpet": ((0.06, 0.40), (0.0, 0.0)),
    "plastic": ((0.04, 0.60), (0.0, 0.4)),
    "paper": ((0.60, 0.85), (0.0, 0.1)),
}


def draw_material(names: tuple[Name, ...], rng: np.random.Generator) -> Material:
    """One of the named materials."""
    reflectivity, gloss = _RANGES[names[int(rng.integers(len(names)))]]
    return Material(float(rng.uniform(*reflectivity)), float(rng.uniform(*gloss)))
