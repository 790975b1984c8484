"""Walls: how thick, where they are round, and what is put into rooms after the robot's ways are known."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import Door, Opening, edges, shared_walls, spot_on
from ffmap.loaders.simulator.drawn.elements import UPRIGHT_DEG, DrawnPlan, HalfWall, LeaningWall, Niche, polygons
from ffmap.loaders.simulator.drawn.ranges import Ranges
from ffmap.loaders.simulator.mesh import Spot

SKIN_M = 0.035
"""From an outline to the inner face of an outer wall; no inner wall is thinner than twice this."""

_ROOMY_M2 = 12.0
_TRIES = 20
Areas = Sequence[shapely.Polygon]
Thickness = Mapping[frozenset[int], float]


def add_bays(outlines: Areas, ranges: Ranges, rng: np.random.Generator) -> list[shapely.Polygon]:
    """Some rooms' outlines with a part of a circle before the façade; the corridor's, the first, stays."""
    found = list(outlines)
    for i in range(1, len(found)):
        if rng.random() >= ranges.bay_share:
            continue
        others = shapely.union_all([outline for k, outline in enumerate(found) if k != i]).buffer(0.7)
        façade = [edge for edge in edges(found[i]) if not shapely.LineString(edge).interpolate(0.5, normalized=True).within(others)]
        length = [float(np.linalg.norm(edge[1] - edge[0])) for edge in façade]
        if not façade or max(length) < 2.4:
            continue
        edge = façade[int(np.argmax(length))]
        radius = max(length) * float(rng.uniform(0.25, 0.38))
        middle = spot_on(edge, max(length) / 2).to_plan(np.array([[0.0, radius * float(rng.uniform(0.0, 0.7))]]))[0]
        bay = shapely.Point(middle).buffer(radius, quad_segs=20)
        if not bay.intersects(others):
            found[i] = found[i].union(bay)
    return found


def draw_thickness(outlines: Areas, corridor_m: float, ranges: Ranges, rng: np.random.Generator) -> dict[frozenset[int], float]:
    """Of the wall between each two rooms, by their numbers; the corridor's are alike."""
    return {
        frozenset((a, b)): corridor_m if a == 0 else float(rng.uniform(*ranges.inner_wall_m))
        for a, b in combinations(range(len(outlines)), 2)
    }


def carve(outlines: Areas, thickness: Thickness) -> list[shapely.Polygon]:
    """The rooms' interiors: what their walls leave of their outlines."""
    bands: list[list[BaseGeometry]] = [[] for _ in outlines]
    by_thickness: dict[float, list[tuple[int, int, FloatArray]]] = {}
    for (a, b), thick in ((sorted(pair), thick) for pair, thick in thickness.items()):
        for ends in shared_walls(outlines[a], outlines[b]):
            by_thickness.setdefault(thick, []).append((a, b, ends))
    for thick, walls in by_thickness.items():
        # Joined, so that walls that bend are closed at the bend.
        lines = shapely.line_merge(shapely.union_all([shapely.LineString(ends) for _, _, ends in walls]))
        band = lines.buffer(thick / 2, cap_style="flat", join_style="mitre")
        for room in {room for a, b, _ in walls for room in (a, b)}:
            bands[room].append(band)
    return [
        max(polygons(outline.buffer(-SKIN_M, join_style="mitre").difference(shapely.union_all(own))), key=lambda p: p.area)
        for outline, own in zip(outlines, bands, strict=True)
    ]


def round_corner(interior: shapely.Polygon, ranges: Ranges, rng: np.random.Generator) -> tuple[shapely.Polygon, BaseGeometry]:
    """An interior with one corner rounded, and what was filled; nothing is where no radius fits."""
    x0, y0, x1, y1 = interior.bounds
    radius = min(float(rng.uniform(*ranges.round_m)), 0.4 * min(x1 - x0, y1 - y0))
    smooth = interior.buffer(-radius).buffer(radius, quad_segs=24)
    corners = polygons(interior.difference(smooth), 0.005)
    if not corners or smooth.is_empty:
        return interior, shapely.Polygon()
    filled = corners[int(rng.integers(len(corners)))]
    rest = polygons(interior.difference(filled.buffer(1e-6)))
    return max(rest, key=lambda part: float(part.area)), filled


def place_niches(plan: DrawnPlan, ranges: Ranges, rng: np.random.Generator) -> list[Niche]:
    """Holes in walls that are thick enough, clear of doors and windows."""
    niches: list[Niche] = []
    solid = plan.solid
    taken = shapely.union_all([opening.area.buffer(0.15) for opening in plan.openings])
    for room in plan.drawn_rooms:
        for edge in edges(room.interior):
            length = float(np.linalg.norm(edge[1] - edge[0]))
            if length < 1.5 or rng.random() >= ranges.niche_share:
                continue
            width = float(rng.uniform(0.4, min(2.0, length - 0.8)))
            depth = float(rng.uniform(*ranges.niche_depth_m))
            bottom = 0.0 if rng.random() < 0.4 else float(rng.uniform(0.2, 1.2))
            top = min(bottom + float(rng.uniform(0.4, 2.4)), room.ceiling_m - 0.05)
            place = float(rng.uniform(0.3 + width / 2, length - 0.3 - width / 2))
            niche = Niche(spot_on(edge, place), width, bottom, top, (-depth, 0.0))
            around = niche.spot.rectangle(-width / 2 - 0.05, width / 2 + 0.05, -depth - 0.05, -0.002)
            if top > bottom + 0.3 and solid.contains(around) and not around.intersects(taken):
                niches.append(niche)
                taken = taken.union(around)
    return niches


def draw_leaning(plan: DrawnPlan, keep: BaseGeometry, ranges: Ranges, rng: np.random.Generator) -> list[LeaningWall]:
    """Walls without openings that lean, and roofs that come down to a knee; keep: where the robot drives."""
    found = []
    openings = shapely.union_all([opening.area for opening in plan.openings])
    for room in plan.drawn_rooms[1:]:
        walls = [edge for edge in edges(room.interior) if np.linalg.norm(edge[1] - edge[0]) > 1.5]
        if rng.random() >= ranges.lean_share or room.ceiling.shape != "flat" or not walls:
            continue
        tries = [_lean(walls[int(rng.integers(len(walls)))], room.ceiling.low_m, ranges, rng) for _ in range(_TRIES)]
        fits = (
            wall for wall in tries
            if room.interior.buffer(0.01).contains(wall.area) and not wall.area.intersects(keep)
            and not wall.area.buffer(0.02).intersects(openings)
        )  # fmt: skip
        found += [wall for wall in [next(fits, None)] if wall is not None]
    return found


def _lean(edge: FloatArray, top_m: float, ranges: Ranges, rng: np.random.Generator) -> LeaningWall:
    """A stretch of a wall that leans; what leans far does so from a knee on, as roofs do."""
    length, lean = float(np.linalg.norm(edge[1] - edge[0])), float(rng.uniform(*ranges.lean_deg))
    own = length - 0.02 if rng.random() < 0.6 else float(rng.uniform(0.8, length - 0.1))
    knee = float(rng.uniform(0.5, 1.4)) if lean > UPRIGHT_DEG else 0.0
    return LeaningWall(spot_on(edge, float(rng.uniform(own / 2, length - own / 2))), own, knee, top_m, lean)


def draw_half_walls(plan: DrawnPlan, keep: BaseGeometry, ranges: Ranges, rng: np.random.Generator) -> list[HalfWall]:
    """One that stands out of a wall into a roomy room, where it is in nobody's way."""
    found = []
    for room in plan.drawn_rooms[1:]:
        if room.interior.area < _ROOMY_M2 or rng.random() >= ranges.half_wall_share:
            continue
        height, thick = float(rng.uniform(*ranges.half_wall_m)), float(rng.uniform(*ranges.half_wall_thickness_m))
        for _ in range(_TRIES):
            edge = edges(room.interior)[int(rng.integers(len(edges(room.interior))))]
            spot = spot_on(edge, float(rng.uniform(0.0, np.linalg.norm(edge[1] - edge[0]))))
            area = spot.rectangle(-thick / 2, thick / 2, 0.0, float(rng.uniform(0.8, 2.5)))
            if room.interior.buffer(0.001).contains(area) and not area.buffer(0.2).intersects(keep):
                found.append(HalfWall(spot.rectangle(-thick / 2, thick / 2, -0.02, area.length / 2 - thick), height))
                break
    return found


def draw_pillars(plan: DrawnPlan, keep: BaseGeometry, ranges: Ranges, rng: np.random.Generator) -> list[shapely.Polygon]:
    """Square and round ones, in rooms and before walls."""
    found = []
    for room in plan.drawn_rooms[1:]:
        if room.interior.area < _ROOMY_M2 or rng.random() >= ranges.pillar_share:
            continue
        side = float(rng.uniform(*ranges.pillar_m))
        is_round = rng.random() < 0.5
        x0, y0, x1, y1 = room.interior.bounds
        for _ in range(_TRIES):
            spot = Spot(float(rng.uniform(x0, x1)), float(rng.uniform(y0, y1)), float(rng.choice([0.0, np.pi / 4])))
            square = spot.rectangle(-side / 2, side / 2, -side / 2, side / 2)
            pillar = shapely.Point(spot.x, spot.y).buffer(side / 2, quad_segs=8) if is_round else square
            if room.interior.contains(pillar.buffer(0.1)) and not pillar.buffer(0.05).intersects(keep):
                found.append(pillar)
                break
    return found


def clear_of(openings: Sequence[Opening]) -> BaseGeometry:
    """Where nothing that is built may stand: before and behind doors, and at windows and niches."""
    return shapely.union_all([opening.area.buffer(0.9 if isinstance(opening, Door) else 0.1) for opening in openings])
