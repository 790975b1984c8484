"""Rooms: coloured with their areas over the grid map, and their topology as a graph beside it."""

import rerun.blueprint as rrb
from rerun.blueprint import archetypes

from blueprints import entities
from blueprints.maps import from_above


def build(centre_m: tuple[float, float], extent_m: float, grid: str = entities.SEGMENTED) -> rrb.Blueprint:
    """The layout of a recording that holds one segmented map.

    centre_m, extent_m: middle and size of what is shown. grid: name of the map.
    """
    return rrb.Blueprint(
        tab(centre_m, extent_m, grid),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def tab(centre_m: tuple[float, float], extent_m: float, grid: str = entities.FURNITURE_FREE) -> rrb.Container:
    """Rooms and their graph, as a part of a larger layout."""
    eye = from_above(centre_m, extent_m)
    ground = f"{entities.GRID}/{grid}"
    x, y = (value * entities.GRAPH_UNITS_PER_M for value in centre_m)
    half = 0.6 * extent_m * entities.GRAPH_UNITS_PER_M
    return rrb.Horizontal(
        rrb.Spatial3DView(
            origin=entities.WORLD,
            contents=[
                ground,
                entities.ROOM_FLOORS,
                entities.ROOM_OUTLINES,
                entities.ROOM_NAMES,
                entities.ROOM_PASSAGES,
            ],
            name="Rooms and their areas; passages red",
            eye_controls=eye,
            line_grid=rrb.LineGrid3D(visible=False),
        ),
        rrb.Vertical(
            rrb.GraphView(
                origin=entities.ROOM_GRAPH,
                name="Topology: which room leads to which",
                visual_bounds=rrb.VisualBounds2D(x_range=[x - half, x + half], y_range=[-y - half, -y + half]),
                force_link=archetypes.ForceLink(enabled=False),
                force_many_body=archetypes.ForceManyBody(enabled=False),
                force_position=archetypes.ForcePosition(enabled=False),
                force_center=archetypes.ForceCenter(enabled=False),
                force_collision_radius=archetypes.ForceCollisionRadius(enabled=False),
            ),
            rrb.Spatial3DView(
                origin=entities.WORLD,
                contents=[ground, entities.ROOM_VORONOI, entities.ROOM_TOPOLOGY, entities.ROOM_FURNITURE],
                name="Voronoi graph (blue), topology (violet), what was taken for furniture (orange)",
                eye_controls=eye,
                line_grid=rrb.LineGrid3D(visible=False),
            ),
        ),
        column_shares=[3, 2],
        name="Rooms",
    )
