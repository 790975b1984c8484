"""One run: the labelled scan, its lines and difference curves, the growing map and the grid at a glance."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from algorithms.grid_map import GridMap
from blueprints import entities, maps, rooms
from blueprints.entities import CurveSheet
from blueprints.maps import from_above, until_now


def build(
    ring_count: int | None = 32,
    centre_m: tuple[float, float] = (0.0, 0.0),
    extent_m: float = 20.0,
    evaluated: bool = False,
    scans: bool = True,
    several: bool = False,
) -> rrb.Blueprint:
    """The layout of a run's recording.

    ring_count: emitters of the vertical lidar, None where there is nothing to label. centre_m, extent_m: middle and size
    of what the map views show. evaluated: with the errors that `evaluation.rrd` adds, first of all. scans: whether the
    recording has anything of single scans. several: whether it is to hold for several runs, with the list to choose from.
    """
    about: list[rrb.Container | rrb.View] = [_metrics(), rrb.TextDocumentView(origin=entities.README, name="Read me")]
    if ring_count is None:
        return _blueprint([_odometry(None), *about], entities.STAMP_TIMELINE, several)
    building = [
        _building(centre_m, extent_m),
        maps.tab(centre_m, extent_m, evaluated),
        rooms.tab(centre_m, extent_m, compared=True),
    ]
    if not scans:
        # The map alone: its tabs without the scan's views, which would be empty.
        tabs = [*building, _map(centre_m, extent_m), _odometry(_aslant(centre_m, extent_m)), *about]
        tabs = [_evaluation(centre_m, extent_m, scans=False), *tabs] if evaluated else tabs
        return _blueprint(tabs, entities.SCAN_TIMELINE, several)
    overview = rrb.Vertical(
        rrb.Horizontal(_scan(), _map(centre_m, extent_m), column_shares=[1, 1]),
        rrb.Horizontal(_lines(), _curves(ring_count), _grid(centre_m, extent_m), column_shares=[1, 1.25, 1]),
        row_shares=[1, 1],
        name="At a glance",
    )
    tabs = [overview, _method(ring_count), *building, _odometry(_aslant(centre_m, extent_m)), *about]
    tabs = [_evaluation(centre_m, extent_m), *tabs] if evaluated else tabs
    return _blueprint(tabs, entities.SCAN_TIMELINE, several)


def view_of(*grids: GridMap | None) -> tuple[tuple[float, float], float]:
    """`centre_m` and `extent_m` that show all of some grid maps."""
    there = [grid for grid in grids if grid is not None]
    if not there:
        return (0.0, 0.0), 20.0
    low = np.min([grid.origin for grid in there], axis=0)
    high = np.max([grid.origin + np.array(grid.cells.shape[::-1]) * grid.cell_m for grid in there], axis=0)
    x, y = (low + high) / 2
    return (float(x), float(y)), float(np.max(high - low))


def _blueprint(tabs: list[rrb.Container | rrb.View], timeline: str, several: bool) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.BlueprintPanel(state="expanded" if several else "collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # A finished recording opens at its end, where the map is whole; a live one stays at the newest scan.
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


def _scan() -> rrb.Spatial3DView:
    return _scan_view("Labelled scan", [entities.POINTS, entities.OPENINGS])


def _lines() -> rrb.Spatial3DView:
    return _scan_view(
        "Point lines and wall planes; white: the line drawn large",
        [f"{entities.LINES}/**", entities.PLANES, entities.OPENINGS],
        (entities.OPENINGS, rr.LineStrips3D.from_fields(show_labels=False)),
    )


def _scan_view(
    name: str, contents: list[str], override: tuple[str, rrb.VisualizableArchetype | rrb.Visualizer] | None = None
) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=entities.SCAN,
        contents=contents,
        name=name,
        overrides=dict([override]) if override else None,
        # From behind the robot, right of it and above.
        eye_controls=rrb.EyeControls3D(position=(-4.8, -3.9, 4.3), look_target=(0.2, 0.0, 1.1)),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def _curves(ring_count: int, name: str = "Forward differences of all lines (eq. 2, Fig. 5b)") -> rrb.Spatial2DView:
    sheet = CurveSheet(ring_count)
    return rrb.Spatial2DView(
        origin=entities.CURVES,
        name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=[-20, sheet.WIDTH + 20], y_range=[-110, sheet.height + 10]),
    )


def _map(centre_m: tuple[float, float], extent_m: float) -> rrb.Spatial3DView:
    x, y = centre_m
    return rrb.Spatial3DView(
        origin=entities.WORLD,
        contents=[
            entities.MAP_POINTS,
            entities.TRAJECTORY,
            f"{entities.BASE}/**",
            entities.WALLS,
            entities.DOORS,
            entities.WINDOWS,
            entities.REFUSED_WALLS,
        ],
        name="Growing map (ceiling hidden)",
        overrides={
            entities.MAP_POINTS: until_now(),
            entities.TRAJECTORY: until_now(),
        },
        eye_controls=rrb.EyeControls3D(
            position=(x - 0.3 * extent_m, y - 0.65 * extent_m, 0.65 * extent_m), look_target=(x, y, 0.0)
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def _grid(centre_m: tuple[float, float], extent_m: float, name: str = entities.FURNITURE_FREE) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=entities.WORLD,
        contents=[f"{entities.GRID}/{name}", entities.DOOR_SILLS, entities.TRAJECTORY, f"{entities.BASE}/**"],
        name=f"Grid map: {name.replace('_', ' ')}, doors, trajectory",
        overrides={entities.TRAJECTORY: until_now()},
        eye_controls=from_above(centre_m, extent_m),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def _evaluation(centre_m: tuple[float, float], extent_m: float, scans: bool = True) -> rrb.Container:
    """What is wrong: on the map, in the scan (if there are any), over time, and in figures."""
    eye = from_above(centre_m, extent_m)
    outlines = [entities.TRUTH_WALLS, entities.TRUTH_DOORS, entities.INVENTED_DOORS]
    scan = rrb.Vertical(
        _scan_view(
            "This scan: false wall red, missed wall orange",
            [entities.POINTS],
            (entities.POINTS, _mapped(rr.Points3D.from_fields(), "Points3D:colors", entities.POINT_VERDICT_COLOR)),
        ),
        _scan_view("Its labels", [entities.POINTS]),
        rrb.TimeSeriesView(origin=entities.SCAN_ERRORS, name="Wrong points in each scan, percent"),
        row_shares=[3, 3, 2],
    )
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Tabs(
                rrb.Spatial3DView(
                    origin=entities.WORLD,
                    contents=[*outlines, f"{entities.PLAN_ERRORS}/**", entities.TRAJECTORY, f"{entities.BASE}/**"],
                    name="False wall red, missed wall orange; truth white",
                    overrides={entities.TRAJECTORY: until_now()},
                    eye_controls=eye,
                    line_grid=rrb.LineGrid3D(visible=False),
                ),
                rrb.Spatial3DView(
                    origin=entities.WORLD,
                    contents=[*outlines, f"{entities.ERRORS}/**", entities.TRAJECTORY, f"{entities.BASE}/**"],
                    name="The same in space",
                    overrides={entities.TRAJECTORY: until_now()},
                    line_grid=rrb.LineGrid3D(visible=False),
                ),
            ),
            rrb.Spatial3DView(
                origin=entities.WORLD,
                contents=[
                    *outlines,
                    f"{entities.GRID}/{entities.FURNITURE_FREE}",
                    f"{entities.OVERLAYS}/{entities.FURNITURE_FREE}/**",
                ],
                name="Wall map: right cells green, false red, missed orange",
                eye_controls=eye,
                line_grid=rrb.LineGrid3D(visible=False),
            ),
        ),
        *([scan] if scans else []),
        rrb.TextDocumentView(origin=entities.FIGURES, name="Figures"),
        column_shares=[4, 3, 3] if scans else [3, 2],
        name="Evaluation",
    )


def _method(ring_count: int) -> rrb.Container:
    """The paper's figures, step by step."""
    return rrb.Vertical(
        rrb.Horizontal(
            _scan_view(
                "1. Floor and ceiling removed (Fig. 3)",
                [entities.POINTS, entities.FLOOR, entities.CEILING],
                (entities.POINTS, _mapped(rr.Points3D.from_fields(), "Points3D:radii", entities.POINT_RADIUS_UPRIGHT)),
            ),
            _scan_view("2. Point lines (Fig. 5a)", [f"{entities.LINES}/**"]),
            _curves(ring_count, "3. Forward differences (eq. 2, Fig. 5b)"),
        ),
        rrb.Horizontal(
            _scan_view("4. Up-most structures: wall candidates (Fig. 6a)", [entities.UPMOST]),
            _scan_view("5. Bottom-most, for comparison (Fig. 6b)", [entities.BOTTOMMOST]),
            _scan_view(
                "6. Wall planes grown (Fig. 7)",
                [entities.UPMOST, entities.PLANES],
                (
                    entities.UPMOST,
                    _mapped(rr.LineStrips3D.from_fields(), "LineStrips3D:colors", entities.CANDIDATE_PLANE_COLOR),
                ),
            ),
            _scan_view("7. Conditions of a door", [f"{entities.SCAN_DOORS}/**", entities.PLANES]),
        ),
        name="Step by step",
    )


def _aslant(centre_m: tuple[float, float], extent_m: float) -> rrb.EyeControls3D:
    """Aslant from above, the whole building in view."""
    x, y = centre_m
    position = (x - 0.2 * extent_m, y - 0.55 * extent_m, 0.75 * extent_m)
    return rrb.EyeControls3D(position=position, look_target=(x, y, 0.0))


def _building(centre_m: tuple[float, float], extent_m: float) -> rrb.Container:
    return rrb.Horizontal(
        rrb.Spatial3DView(
            origin=entities.WORLD,
            contents=[
                entities.CLOUD,
                entities.WALLS,
                entities.DOORS,
                entities.WINDOWS,
                entities.FUSED_WALLS,
                entities.REFUSED_WALLS,
                entities.AGAINST_WALLS,
                f"{entities.LEVELS}/**",
            ],
            name="Fused cloud, walls and doors (ceiling hidden)",
            overrides={
                entities.DOORS: rr.LineStrips3D.from_fields(show_labels=True),
                # They hide what lies below; a click on their eye shows them.
                **{f"{entities.LEVELS}/{ceiling}": rrb.EntityBehavior(visible=False) for ceiling in entities.CEILINGS},
            },
            eye_controls=_aslant(centre_m, extent_m),
            line_grid=rrb.LineGrid3D(visible=False),
        ),
        rrb.Vertical(
            _grid(centre_m, extent_m),
            rrb.TextDocumentView(origin=entities.BUILDING_REASONS, name="Why: doors, refused faces, windows, surfaces"),
        ),
        column_shares=[3, 2],
        name="Building",
    )


def _odometry(eye: rrb.EyeControls3D | None) -> rrb.Container:
    """eye: None where nothing says how large the place is."""
    return rrb.Horizontal(
        rrb.Spatial3DView(
            origin=entities.WORLD,
            contents=[f"{entities.ODOMETRY}/**", f"{entities.POSE_GRAPH}/**", entities.TRAJECTORY],
            name="What was registered, and loops (timeline stamp)",
            eye_controls=eye,
            overrides={entities.TRAJECTORY: until_now()},
        ),
        rrb.Vertical(
            *(
                rrb.TimeSeriesView(origin=f"{entities.REGISTRATION}/{name}", name=title)
                for name, title in (
                    ("weak", "Alarm: registration is weak (1)"),
                    ("weakest_share", "Hold in the direction that holds least, share of the best one's"),
                    ("refined_inlier_share", "Share of the scan that fits the map"),
                    ("loops_moved_m", "Closing the loops moved the pose, m"),
                    ("residual_m", "KISS-ICP: median distance to the local map, m"),
                    ("correction_m", "KISS-ICP: correction of the predicted pose, m"),
                    ("threshold_m", "KISS-ICP: adaptive threshold, m"),
                )
            )
        ),
        name="Odometry",
    )


def _metrics() -> rrb.Container:
    return rrb.Vertical(
        rrb.TimeSeriesView(origin=entities.LABEL_COUNTS, name="Returns by label"),
        rrb.TimeSeriesView(origin=entities.COUNTS, name="Evidence counted"),
        rrb.TimeSeriesView(origin=entities.RANGES, name="Scatter of the ranges, mm; returns on no facet, %"),
        rrb.TimeSeriesView(origin=entities.MILLISECONDS, name="Milliseconds by stage"),
        rrb.TextLogView(origin=entities.MESSAGES, name="Warnings"),
        row_shares=[3, 3, 2, 3, 2],
        name="Metrics and warnings",
    )


def _mapped(archetype: rrb.VisualizableArchetype, target: str, component: str) -> rrb.Visualizer:
    """What is drawn with a component of the entity's own in the place of another; a radius of 0 hides a point."""
    return archetype.visualizer(
        mappings=[
            VisualizerComponentMapping(
                target=target, source_kind=ComponentSourceKind.SourceComponent, source_component=component
            )
        ]
    )
