"""Rooms: coloured with their areas over the grid map, and their topology as a graph beside it."""

import rerun.blueprint as rrb
from rerun.blueprint import archetypes

from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.maps.rivals import Rival
from ffmap.blueprints import entities
from ffmap.blueprints.views import from_above, layout, space

_PARTS = (entities.ROOM_FLOORS, entities.ROOM_OUTLINES, entities.ROOM_NAMES, entities.ROOM_PASSAGES)
_COMPARED = {
    Segmented.NORMAL: "Normal map, after alpha removal",
    Segmented.NORMAL_AS_IS: "Normal map, furniture and all",
}


def build(centre_m: tuple[float, float], extent_m: float, grid: str = entities.SEGMENTED) -> rrb.Blueprint:
    """The layout of a recording that holds one segmented map.

    centre_m, extent_m: middle and size of what is shown. grid: name of the map.
    """
    return layout(tab(centre_m, extent_m, grid), rrb.TimePanel(state="hidden"))


def tab(
    centre_m: tuple[float, float], extent_m: float, grid: str = entities.FURNITURE_FREE, compared: bool = False
) -> rrb.Container:
    """Rooms and their graph, as a part of a larger layout. compared: the recording has the rooms of the normal map too,
    with and without alpha removal, which then stand beside.
    """
    evidence = [_topology(centre_m, extent_m), _voronoi(centre_m, extent_m, grid)]
    title = "Rooms and their areas; passages red"
    if not compared:
        return rrb.Horizontal(
            _areas(entities.ROOMS, grid, title, centre_m, extent_m),
            rrb.Vertical(*evidence),
            column_shares=[3, 2],
            name="Rooms",
        )
    areas = [_areas(entities.ROOMS, grid, f"Furniture-free map (Fig. 10): {title.lower()}", centre_m, extent_m)]
    for name, title in _COMPARED.items():
        root = f"{entities.ROOMS_COMPARED}/{name}"
        areas.append(_areas(root, Rival.MIDDLE, title, centre_m, extent_m))
    return rrb.Vertical(rrb.Horizontal(*areas), rrb.Horizontal(*evidence), row_shares=[1, 1], name="Rooms")


def _areas(root: str, grid: str, name: str, centre_m: tuple[float, float], extent_m: float) -> rrb.Spatial3DView:
    contents = [f"{entities.GRID}/{grid}", *(f"{root}/{part}" for part in _PARTS)]
    return space(name, contents, from_above(centre_m, extent_m))


def _topology(centre_m: tuple[float, float], extent_m: float) -> rrb.GraphView:
    x, y = (value * entities.GRAPH_UNITS_PER_M for value in centre_m)
    half = 0.6 * extent_m * entities.GRAPH_UNITS_PER_M
    return rrb.GraphView(
        origin=entities.ROOM_GRAPH,
        name="Topology: which room leads to which",
        visual_bounds=rrb.VisualBounds2D(x_range=[x - half, x + half], y_range=[-y - half, -y + half]),
        force_link=archetypes.ForceLink(enabled=False),
        force_many_body=archetypes.ForceManyBody(enabled=False),
        force_position=archetypes.ForcePosition(enabled=False),
        force_center=archetypes.ForceCenter(enabled=False),
        force_collision_radius=archetypes.ForceCollisionRadius(enabled=False),
    )


def _voronoi(centre_m: tuple[float, float], extent_m: float, grid: str) -> rrb.Spatial3DView:
    return space(
        "Voronoi graph (blue), topology (violet), what was taken for furniture (orange)",
        [f"{entities.GRID}/{grid}", entities.ROOM_VORONOI, entities.ROOM_TOPOLOGY, entities.ROOM_FURNITURE],
        from_above(centre_m, extent_m),
    )
