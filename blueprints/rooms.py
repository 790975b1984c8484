"""Rooms: coloured, with their areas, over the grid map, and their topology as a graph."""

import rerun.blueprint as rrb
from rerun.blueprint import archetypes

from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.maps.rivals import Rival
from ffmap.blueprints.entities import (
    FURNITURE_FREE,
    GRAPH_UNITS_PER_M,
    GRID,
    ROOMS_COMPARED,
    SEGMENTED,
)
from ffmap.blueprints.views import from_above, layout, space

_EVIDENCE = "topology", "voronoi", "furniture"
_COMPARED = {
    Segmented.NORMAL: "Normal map, after alpha removal",
    Segmented.NORMAL_AS_IS: "Normal map, furniture and all",
}


def build(centre_m: tuple[float, float], extent_m: float, grid: str = SEGMENTED) -> rrb.Blueprint:
    """Return the layout of a recording of one segmented map.

    centre_m, extent_m: of the view. grid: name of the map.
    """
    return layout(tab(centre_m, extent_m, grid), rrb.TimePanel(state="hidden"))


def tab(
    centre_m: tuple[float, float],
    extent_m: float,
    grid: str = FURNITURE_FREE,
    compared: bool = False,
) -> rrb.Container:
    """Return rooms and their graph. compared: with the rooms of the normal map (Fig. 10)."""
    eye = from_above(centre_m, extent_m)

    def areas(root: str, grid: str, title: str) -> rrb.Spatial3DView:
        rest = [f"- {root}/{name}" for name in _EVIDENCE]
        return space(title, [f"{GRID}/{grid}", f"{root}/**", *rest], eye)

    cut = space(
        "Voronoi graph (blue), topology (violet), removed as furniture (orange)",
        [f"{GRID}/{grid}", *(f"/world/rooms/{name}" for name in _EVIDENCE)],
        eye,
    )
    evidence = [_topology(centre_m, extent_m), cut]
    if not compared:
        rooms = areas("/world/rooms", grid, "Rooms and their areas; passages red")
        return rrb.Horizontal(rooms, rrb.Vertical(*evidence), column_shares=[3, 2], name="Rooms")
    title = "Furniture-free map (Fig. 10); passages red"
    rooms_of_maps = [
        areas("/world/rooms", grid, title),
        *(areas(f"{ROOMS_COMPARED}/{name}", Rival.MIDDLE, t) for name, t in _COMPARED.items()),
    ]
    return rrb.Vertical(
        rrb.Horizontal(*rooms_of_maps), rrb.Horizontal(*evidence), row_shares=[1, 1], name="Rooms"
    )


def _topology(centre_m: tuple[float, float], extent_m: float) -> rrb.GraphView:
    x, y = (value * GRAPH_UNITS_PER_M for value in centre_m)
    half = 0.6 * extent_m * GRAPH_UNITS_PER_M
    bounds = rrb.VisualBounds2D(x_range=[x - half, x + half], y_range=[-y - half, -y + half])
    return rrb.GraphView(
        origin="/rooms/graph",
        name="Topology: which room leads to which",
        visual_bounds=bounds,
        force_link=archetypes.ForceLink(enabled=False),
        force_many_body=archetypes.ForceManyBody(enabled=False),
        force_position=archetypes.ForcePosition(enabled=False),
        force_center=archetypes.ForceCenter(enabled=False),
        force_collision_radius=archetypes.ForceCollisionRadius(enabled=False),
    )
