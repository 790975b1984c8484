"""Draw the rooms along a corridor that may bend, and their ceilings."""

from itertools import combinations

import numpy as np
import shapely

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator.mesh import Rng, Span, Spot, length_of, polygons, segments, spot_on
from ffmap.loaders.simulator.plan import SKIN_M, Ceiling, Room, shared_walls
from ffmap.loaders.simulator.settings import SimulationSettings, choose, draw

_CLEAR_OF_BEND_M = 1.4
_GENTLE_RAD = 1.0  # A gentle bend has a wall at its corner; around a sharp one there is a room
_SKEW_M = 0.8  # Largest shift of a partition along the façade
_LEAST_HEADROOM_M = 2.05  # Under beams and soffits
_FAR_M = 60.0
_TRIES = 100


def draw_rooms(settings: SimulationSettings, rng: Rng) -> tuple[FloatArray, list[Room]]:
    """Draw the corridor's centre line (n, 2), and rooms with their walls and ceilings."""
    corridor_wall_m, height = draw(settings.wall_thickness_m, rng), draw(settings.ceiling_m, rng)
    line, outlines = _draw_outlines(settings, corridor_wall_m, rng)
    rooms = []
    for number, interior in enumerate(_carve(outlines, corridor_wall_m, settings, rng)):
        lowered = height - float(rng.choice([0.0, rng.uniform(0.1, 0.35)]))
        ceiling = _draw_ceiling(interior, max(lowered, settings.ceiling_m[0]), settings, rng)
        name = f"room {number}" if number else "corridor"
        rooms.append(Room(name, outlines[number], interior, ceiling))
    return line, rooms


def _draw_outlines(
    settings: SimulationSettings, wall_m: float, rng: Rng
) -> tuple[FloatArray, list[shapely.Polygon]]:
    """Draw the corridor's centre line and all outlines, the corridor's first.

    The centre lines of walls partition the floor: the corridor, a strip of rooms on each side, cut
    by walls between rooms, and perhaps a hall at the end. They are drawn again while the corridor
    bends too sharply for the depth of its rooms.
    """
    for _ in range(_TRIES):
        line = _draw_line(settings, rng)
        half = (draw(settings.corridor_m, rng) + wall_m) / 2
        rings = [np.vstack([_offset(line, half), _offset(line, -half)[::-1]])]
        cuts: list[FloatArray] = []
        for side in (1, -1):
            reach = side * (half + draw(settings.room_depth_m, rng))
            rings.append(np.vstack([_offset(line, side * half), _offset(line, reach)[::-1]]))
            cuts += _draw_cuts(line, side * half, reach, settings, rng)
        if hall_m := draw(settings.hall_m, rng):
            left, right = rings[1][len(line)], rings[2][len(line)]
            ahead = hall_m * (line[-1] - line[-2]) / length_of(line[-2:])
            rings.append(np.array([left, right, right + ahead, left + ahead]))
        lines = [shapely.LinearRing(ring) for ring in rings] + [shapely.LineString(c) for c in cuts]
        faces = polygons(shapely.polygonize([shapely.union_all(lines, grid_size=1e-6)]))
        if len(faces) == len(rings) + len(cuts) and min(face.area for face in faces) > 4.0:
            middle = shapely.Point(line[:2].mean(axis=0))
            return line, sorted(faces, key=lambda face: not face.contains(middle))
    raise InputError(
        "simulate: the rooms overlap at the corridor's bend; set a smaller room_depth_m or turn_deg"
    )


def _draw_line(settings: SimulationSettings, rng: Rng) -> FloatArray:
    legs = round(draw(settings.legs, rng))
    turns = [0.0, *(draw(settings.turn_deg, rng) * rng.choice([-1, 1]) for _ in range(legs - 1))]
    heading, shares = np.radians(np.cumsum(turns)), rng.uniform(0.8, 1.2, legs)
    lengths = draw(settings.corridor_length_m, rng) * shares / shares.sum()
    steps = lengths[:, None] * np.stack([np.cos(heading), np.sin(heading)], 1)
    return np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])


def _offset(line: FloatArray, left_m: float) -> FloatArray:
    """Move a line (n, 2) to its left, with mitred corners."""
    along = np.diff(line, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], 1)
    before, after = np.vstack([normal[:1], normal]), np.vstack([normal, normal[-1:]])
    mitre = (before + after) / (1 + np.sum(before * after, axis=1))[:, None]
    return np.asarray(line + left_m * mitre)


def _draw_cuts(
    line: FloatArray, near_m: float, far_m: float, settings: SimulationSettings, rng: Rng
) -> list[FloatArray]:
    """Draw the walls (2, 2) between the rooms of a side, from near the corridor to the façade.

    near_m, far_m: offsets to the left. Inside a bend there is less space for rooms.
    """
    corners = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    headings = np.unwrap(np.arctan2(*np.diff(line, axis=0).T[::-1]))
    widths = [rng.uniform(5.0, 9.0)] if corners[-1] > 10 else []
    while sum(widths) < corners[-1]:
        widths.append(draw(settings.room_width_m, rng))
    places = np.cumsum(rng.permutation(widths))
    places = places[places < corners[-1] - settings.room_width_m[0]]
    skew = float(rng.choice([0.0, rng.uniform(0.2, _SKEW_M)]))
    cuts = []
    for i, turn in enumerate(np.diff(headings), start=1):
        margin = _CLEAR_OF_BEND_M + skew + max(far_m * np.tan(turn / 2), 0.0)
        places = places[np.abs(places - corners[i]) > margin]
        if abs(turn) < _GENTLE_RAD:
            cuts.append(np.array([_offset(line, near_m)[i], _offset(line, far_m)[i]]))
    for place in places:
        leg = int(np.searchsorted(corners, place)) - 1
        spot = spot_on(line[leg : leg + 2], place - corners[leg])
        overshoot = 0.01 * np.sign(far_m)  # Polygonize drops what extends beyond the rings
        shift = rng.uniform(-skew, skew)
        cuts.append(spot.to_plan([[0.0, near_m - overshoot], [shift, far_m + overshoot]]))
    return cuts


def _carve(
    outlines: list[shapely.Polygon], corridor_wall_m: float, settings: SimulationSettings, rng: Rng
) -> list[shapely.Polygon]:
    """Return the interiors: outlines without their walls, each with a thickness of its own."""
    walls: dict[float, list[shapely.LineString]] = {}
    for a, b in combinations(range(len(outlines)), 2):
        thick = corridor_wall_m if a == 0 else draw(settings.wall_thickness_m, rng)
        shared = shared_walls(outlines[a], outlines[b])
        walls.setdefault(thick, []).extend(map(shapely.LineString, shared))
    bands = []
    for thick, lines in walls.items():
        # Joined, so that walls which bend are closed at the bend.
        joined = shapely.line_merge(shapely.union_all(lines))
        bands.append(joined.buffer(thick / 2, cap_style="flat", join_style="mitre"))
    built = shapely.union_all(bands)
    inset = [outline.buffer(-SKIN_M, join_style="mitre") for outline in outlines]
    return [max(polygons(area.difference(built)), key=shapely.area) for area in inset]


def _draw_ceiling(
    interior: shapely.Polygon, height_m: float, settings: SimulationSettings, rng: Rng
) -> Ceiling:
    """Draw a ceiling whose highest part, or lowest part of a roof, is at a height."""
    shape, wall = choose(settings.ceiling, rng), max(segments(interior), key=length_of)
    yaw = spot_on(wall, 0.0).yaw + float(rng.choice([0.0, np.pi / 2]))
    spot = Spot(interior.centroid.x, interior.centroid.y, yaw)
    drop = min(float(rng.uniform(0.08, 0.5)), height_m - _LEAST_HEADROOM_M)
    drops = _draw_drops(shape, interior, spot, wall, rng) if drop > 0.05 else []
    profile = np.array([[-_FAR_M, height_m], [_FAR_M, height_m]])
    if shape in ("sloping", "gable", "vault"):
        profile = _draw_roof(shape, interior, spot, (height_m, settings.ceiling_m[1]), rng)
    elif not drops:
        shape = "flat"
    return Ceiling(shape, spot, profile, shapely.union_all(drops).intersection(interior), drop)


def _draw_roof(shape: str, interior: shapely.Polygon, spot: Spot, z: Span, rng: Rng) -> FloatArray:
    """Draw the profile (k, 2: x, z) of a roof across a room, from its lowest height up."""
    along = np.array([np.cos(spot.yaw), np.sin(spot.yaw)])
    x = (shapely.get_coordinates(interior) - [spot.x, spot.y]) @ along
    start, width = float(x.min()) - 0.1, float(np.ptp(x)) + 0.2
    share = np.linspace(0.0, 1.0, {"sloping": 2, "gable": 3, "vault": 13}[shape])
    off = np.abs(2 * share - 1)
    curve = {"sloping": share, "gable": 1 - off, "vault": np.sqrt(1 - off**2)}[shape]
    span = width if shape == "sloping" else width / 2
    rise = span * float(np.tan(np.radians(rng.uniform(2.0, 35.0))))
    rise = max(min(rise, z[1] - z[0]), 0.02 * span)
    return np.column_stack([start + share * width, z[0] + rise * curve])


def _draw_drops(
    shape: str, interior: shapely.Polygon, spot: Spot, wall: FloatArray, rng: Rng
) -> list[shapely.Polygon]:
    """Draw what hangs lower than the rest: a soffit along a wall, beams, or the ribs of coffers."""
    if shape == "soffit":
        return [spot_on(wall, 0.0).rectangle(0.0, length_of(wall), -0.01, rng.uniform(0.2, 0.8))]
    if shape not in ("beams", "coffered"):
        return []
    x0, y0, x1, y1 = interior.bounds
    reach, width = float(np.hypot(x1 - x0, y1 - y0)), float(rng.uniform(0.08, 0.4))
    places = np.arange(-reach, reach, float(rng.uniform(0.9, 2.6)))
    ribs = [spot.rectangle(p, p + width, -reach, reach) for p in places]
    across = [spot.rectangle(-reach, reach, p, p + width) for p in places]
    return ribs + across if shape == "coffered" else ribs
