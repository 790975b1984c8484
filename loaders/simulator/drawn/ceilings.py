"""Ceilings: flat, stepped, coffered, with beams, sloping, gabled, vaulted; skylights and soffits. All of them is ceiling, for
what hangs from a ceiling is no wall on the floor's plan.
"""

from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import edges, segments, spot_on
from ffmap.loaders.simulator.drawn.elements import Ceiling, Drop, Well, polygons
from ffmap.loaders.simulator.drawn.ranges import CeilingShape, Ranges, choose
from ffmap.loaders.simulator.glass import Glass
from ffmap.loaders.simulator.mesh import Material, MeshBuilder, Spot, Surface

_LEAST_M = 2.05  # Under any drop
_FAR_M = 60.0


def draw_ceiling(interior: shapely.Polygon, height_m: float, ranges: Ranges, rng: np.random.Generator) -> Ceiling:
    """A ceiling whose highest part, or lowest where it slopes, is at a height."""
    shape = choose(ranges.ceiling, rng)
    wall = max(edges(interior), key=lambda ends: float(np.linalg.norm(ends[1] - ends[0])))
    frame = spot_on(wall, 0.0)
    spot = Spot(interior.centroid.x, interior.centroid.y, frame.yaw + float(rng.choice([0.0, np.pi / 2])))
    drop = min(float(rng.uniform(*ranges.drop_m)), height_m - _LEAST_M)
    if shape in ("sloping", "gable", "vault"):
        return Ceiling(shape, spot, _profile(shape, interior, spot, height_m, ranges, rng))
    profile = np.array([[-_FAR_M, height_m], [_FAR_M, height_m]])
    drops: list[Drop] = []
    if drop >= 0.05:
        drops = [Drop(area, drop) for area in _drop_areas(shape, interior, spot, rng)]
        if shape == "flat" and rng.random() < ranges.soffit_share:
            drops = [Drop(part, drop) for part in polygons(_soffit(interior, rng))]
    well = None
    if shape == "flat" and rng.random() < ranges.skylight_share:
        well = _skylight(interior, shapely.union_all([d.area for d in drops]), spot.yaw, ranges, rng)
    return Ceiling(shape if drops or shape == "flat" else "flat", spot, profile, tuple(drops), (well,) if well else ())


def _profile(
    shape: CeilingShape, interior: shapely.Polygon, spot: Spot, low_m: float, ranges: Ranges, rng: np.random.Generator
) -> FloatArray:
    """Heights across a room; none above the ranges' highest ceiling."""
    local = np.array(interior.exterior.coords) - [spot.x, spot.y]
    across = local @ [np.cos(spot.yaw), np.sin(spot.yaw)]
    start, end = float(across.min()) - 0.1, float(across.max()) + 0.1
    span = (end - start) / (1 if shape == "sloping" else 2)
    rise = float(np.tan(np.radians(rng.uniform(*ranges.slope_deg)))) * span
    rise = max(min(rise, ranges.ceiling_m[1] - low_m), 0.02 * span)
    if shape == "sloping":
        return np.array([[start, low_m], [end, low_m + rise]])
    if shape == "gable":
        return np.array([[start, low_m], [(start + end) / 2, low_m + rise], [end, low_m]])
    places = np.linspace(start, end, 13)
    share = (places - (start + end) / 2) / span
    return np.column_stack([places, low_m + rise * np.sqrt(np.maximum(1.0 - share**2, 0.0))])


def _drop_areas(shape: CeilingShape, interior: shapely.Polygon, spot: Spot, rng: np.random.Generator) -> list[shapely.Polygon]:
    """What hangs lower than the rest: the border of a stepped ceiling, the ribs of a coffered one, beams."""
    if shape == "stepped":
        border = min(float(rng.uniform(0.3, 1.0)), 0.25 * float(np.sqrt(interior.area)))
        return polygons(interior.difference(interior.buffer(-border, join_style="mitre")))
    if shape not in ("coffered", "beams"):
        return []
    x0, y0, x1, y1 = interior.bounds
    reach, pitch, width = np.hypot(x1 - x0, y1 - y0), float(rng.uniform(0.9, 2.6)), float(rng.uniform(0.08, 0.4))
    places = np.arange(-reach, reach, pitch) + float(rng.uniform(0, pitch))
    ribs = [spot.rectangle(p, p + width, -reach, reach) for p in places]
    if shape == "coffered":
        ribs += [spot.rectangle(-reach, reach, p, p + width) for p in places]
    return polygons(shapely.union_all(ribs).intersection(interior))


def _soffit(interior: shapely.Polygon, rng: np.random.Generator) -> BaseGeometry:
    edge = max(edges(interior), key=lambda ends: float(np.linalg.norm(ends[1] - ends[0])) * rng.uniform(0.5, 1.0))
    length = float(np.linalg.norm(edge[1] - edge[0]))
    return spot_on(edge, length / 2).rectangle(-length / 2, length / 2, -0.01, float(rng.uniform(0.2, 0.8))).intersection(interior)


def _skylight(
    interior: shapely.Polygon, drops: BaseGeometry, yaw: float, ranges: Ranges, rng: np.random.Generator
) -> Well | None:
    a, b = rng.uniform(*ranges.skylight_m, 2) / 2
    area = Spot(interior.centroid.x, interior.centroid.y, yaw).rectangle(-a, a, -b, b)
    if not interior.buffer(-0.2).contains(area) or area.intersects(drops):
        return None
    return Well(area, float(rng.uniform(0.15, 0.6)), Glass.DOUBLE)


def build_ceiling(interior: shapely.Polygon, ceiling: Ceiling, mesh: MeshBuilder, surface: Surface, wall: Surface) -> None:
    """A ceiling that reaches a little into the walls."""
    area = interior.buffer(0.02, join_style="mitre").difference(shapely.union_all([well.area for well in ceiling.wells]))
    for (start, _), (end, _) in pairwise(ceiling.profile):
        strip = ceiling.spot.rectangle(start, end, -_FAR_M, _FAR_M)
        for part in polygons(area.intersection(strip)):
            mesh.sheet(part, ceiling.height, Truth.CEILING, surface)
    for drop in ceiling.drops:
        top = ceiling.high_m
        mesh.slab(drop.area, top - drop.drop_m, Truth.CEILING, surface)
        mesh.wall(np.array(list(segments(drop.area))), (top - drop.drop_m, top), Truth.CEILING, surface)
    for well in ceiling.wells:
        _build_well(well, ceiling.high_m, mesh, surface, wall)


def _build_well(well: Well, ceiling_m: float, mesh: MeshBuilder, surface: Surface, wall: Surface) -> None:
    """The curb of a skylight is ceiling; the walls of a stairwell are walls."""
    top = ceiling_m + well.rise_m
    sides, sides_surface = (Truth.WALL, wall) if well.glass is None else (Truth.CEILING, surface)
    mesh.wall(np.array(edges(well.area)), (ceiling_m, top), sides, sides_surface)
    if well.glass is None:
        mesh.slab(well.area, top, Truth.CEILING, surface)
    else:
        mesh.slab(well.area, top, Truth.GLASS, Material(0.1, pane=int(well.glass)))
