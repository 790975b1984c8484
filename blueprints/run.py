"""One run: the labelled scan, its lines and difference curves, the growing map and the grid at a glance."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from ffmap.algorithms.base.labels import Verdict
from ffmap.algorithms.maps.grid import GridMap
from ffmap.blueprints import entities, maps, rooms, views
from ffmap.blueprints.entities import CurveSheet, Legend
from ffmap.blueprints.views import Part, aslant, following, from_above, until_now


def build(
    line_pairs: int | None = 32,
    centre_m: tuple[float, float] = (0.0, 0.0),
    extent_m: float = 20.0,
    evaluated: bool = False,
    scans: bool = True,
    several: bool = False,
    registered: bool = True,
    lines: bool = True,
    several_lidars: bool = False,
    growing: bool = False,
) -> rrb.Blueprint:
    """The layout of a run's recording.

    line_pairs: pairs of point lines, None where there is nothing to label. centre_m, extent_m: middle and size
    of what the map views show. evaluated: with the errors that `evaluation.rrd` adds, first of all. scans: whether the
    recording has anything of single scans. several: whether it is to hold for several runs, with the list to choose from.
    several_lidars: whether scans are of more than one lidar, so that it is told of each which. growing: for a run under way,
    which has no map yet: the views of the maps show the odometry's.
    """
    readme = rrb.TextDocumentView(origin=entities.README, name="Read me")
    about: list[Part] = [_metrics(), readme]
    if line_pairs is None:
        only = _below_legend(_glance(), _poses(None, registered), "Odometry" if registered else "Trajectory as given")
        return _tabs([only, _warnings(), readme], entities.STAMP_TIMELINE, several)
    poses = _poses(aslant(centre_m, extent_m), registered)
    tabs: list[Part] = [
        _building(centre_m, extent_m, first=not scans),
        maps.tab(centre_m, extent_m, evaluated),
        rooms.tab(centre_m, extent_m, compared=True),
    ]
    if not scans:
        # The map alone: its tabs without the scan's views, which would be empty.
        tabs += [_map(centre_m, extent_m), poses]
    else:
        planes = [entities.PLANES, entities.OPENINGS]
        # The viewer reports an error for an override of an entity that has no line yet.
        names = None if growing else views.WITHOUT_NAMES
        how: list[Part] = [_scan_view("Wall planes and doors of the scan", planes, names)]
        if lines:
            title = "Point lines and wall planes; white: the line drawn large"
            how = [_scan_view(title, [f"{entities.LINES}/**", *planes], names), _curves(line_pairs)]
        scan = _scan_view("Labelled scan", [entities.POINTS, entities.OPENINGS])
        which = [rrb.TextDocumentView(origin=entities.SCAN_LIDAR, name="Lidar of the scan")] if several_lidars else []
        overview = rrb.Vertical(
            rrb.Horizontal(_label_legend(), _glance(), *which),
            rrb.Horizontal(scan, _map(centre_m, extent_m, growing), column_shares=[1, 1]),
            rrb.Horizontal(*how, _grid(centre_m, extent_m, growing), column_shares=[1, 1.25, 1] if lines else [1, 1]),
            row_shares=[1, 5, 5],
            name="At a glance",
        )
        method = [_method(line_pairs)] if lines else []
        tabs = [overview, *method, *tabs, poses]
    errors = _evaluation(centre_m, extent_m, scans, evaluated)
    tabs = [errors, *tabs, *about] if evaluated else [*tabs, about[0], errors, *about[1:]]
    return _tabs(tabs, entities.SCAN_TIMELINE, several)


def view_of(*grids: GridMap | None) -> tuple[tuple[float, float], float]:
    """`centre_m` and `extent_m` that show all of some grid maps."""
    there = [grid for grid in grids if grid is not None]
    if not there:
        return (0.0, 0.0), 20.0
    low = np.min([grid.origin for grid in there], axis=0)
    high = np.max([grid.origin + np.array(grid.cells.shape[::-1]) * grid.cell_m for grid in there], axis=0)
    x, y = (low + high) / 2
    return (float(x), float(y)), float(np.max(high - low))


def _tabs(tabs: list[Part], timeline: str, several: bool) -> rrb.Blueprint:
    return views.layout(rrb.Tabs(*tabs, active_tab=0), following(timeline), recordings=several)


def _label_legend() -> rrb.View:
    return _legend(entities.LABEL_LEGEND, len(entities.LABEL_LEGEND_ENTRIES), "Colours of the labels")


def _legend(origin: str, entries: int, name: str) -> rrb.Spatial2DView:
    """A strip that explains colours; entries: how many names `origin` has."""
    return rrb.Spatial2DView(
        origin=origin,
        name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=[0, entries * Legend.STEP], y_range=[-Legend.ABOVE, Legend.BELOW]),
    )


def _below_legend(strip: Part, content: Part, name: str) -> rrb.Container:
    return rrb.Vertical(strip, content, row_shares=[1, 12], name=name)


def _glance() -> rrb.View:
    return rrb.TextDocumentView(origin=entities.GLANCE, name="What this shows")


def _scan_view(
    name: str, contents: list[str], override: tuple[str, rrb.VisualizableArchetype | rrb.Visualizer] | None = None
) -> rrb.Spatial3DView:
    return views.space(name, contents, views.behind_the_robot(), entities.SCAN, dict([override]) if override else None)


def _curves(line_pairs: int, name: str = "Forward differences of all lines (eq. 2, Fig. 5b)") -> rrb.Spatial2DView:
    sheet = CurveSheet(line_pairs)
    return rrb.Spatial2DView(
        origin=entities.CURVES,
        name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=[-20, sheet.WIDTH + 20], y_range=[-110, sheet.height + 10]),
    )


def _map(centre_m: tuple[float, float], extent_m: float, growing: bool = False) -> rrb.Spatial3DView:
    return views.space(
        "Odometry's map; the labelled map follows" if growing else "Map up to the time cursor (ceiling hidden)",
        [
            entities.MAP_POINTS,
            entities.TRAJECTORY,
            f"{entities.BASE}/**",
            entities.WALLS,
            entities.DOORS,
            entities.DOOR_LEAVES,
            entities.WINDOWS,
            entities.MULLIONS,
            entities.BLINDS,
            entities.REFUSED_WALLS,
            *([entities.LOCAL_MAP] if growing else []),
        ],
        aslant(centre_m, extent_m, (-0.35, -0.8, 0.85)),
    )


def _grid(centre_m: tuple[float, float], extent_m: float, growing: bool = False) -> rrb.Spatial3DView:
    grid = f"{entities.GRID}/{entities.FURNITURE_FREE}"
    name = "From above; the grid map follows" if growing else "Grid map: wall black, free white, unseen gray; doors blue"
    return views.space(
        name,
        [grid, entities.DOOR_SILLS, entities.TRAJECTORY, f"{entities.BASE}/**", *([entities.LOCAL_MAP] if growing else [])],
        from_above(centre_m, extent_m),
    )


def _evaluation(centre_m: tuple[float, float], extent_m: float, scans: bool, evaluated: bool) -> rrb.Container:
    """What is wrong, and the figures; where these may not be there, a text that says where they are comes first."""
    figures = rrb.TextDocumentView(origin=entities.FIGURES, name="Figures")
    errors: list[Part] = [_errors_on_map(centre_m, extent_m)]
    if scans:
        errors.append(_errors_in_scan())
    parts: list[Part] = [
        _legend(entities.ERROR_LEGEND, len(entities.ERROR_LEGEND_ENTRIES), "Colours of what is wrong"),
        rrb.Horizontal(*errors, column_shares=[4, 3][: len(errors)]),
    ]
    if scans:
        parts.append(_errors_over_time())
    where = rrb.Vertical(*parts, row_shares=[1.2, 10, 2.5][: len(parts)], name="What is wrong, and where")
    if not evaluated:
        about = rrb.TextDocumentView(origin=entities.EVALUATION_HELP, name="What this needs")
        return rrb.Tabs(about, figures, where, active_tab=0, name="Evaluation")
    return rrb.Horizontal(where, figures, column_shares=[7, 3], name="Evaluation")


def _errors_on_map(centre_m: tuple[float, float], extent_m: float) -> rrb.Container:
    eye = from_above(centre_m, extent_m)
    plan = [entities.TRUTH_WALLS, entities.TRUTH_DOOR_SILLS, entities.INVENTED_DOORS]
    space = [entities.TRUTH_WALLS, entities.TRUTH_DOORS, entities.INVENTED_DOORS]
    trajectory = [entities.TRAJECTORY, f"{entities.BASE}/**"]
    above_and_in_space = rrb.Tabs(
        views.space(
            "What is wrong, from above",
            [*plan, f"{entities.PLAN_ERRORS}/**", *trajectory],
            eye,
        ),
        views.space(
            "The same in space",
            [*space, f"{entities.ERRORS}/**", *trajectory],
            aslant(centre_m, extent_m),
        ),
        active_tab=0,
    )
    grid, overlay = (f"{path}/{entities.FURNITURE_FREE}" for path in (entities.GRID, entities.OVERLAYS))
    return rrb.Vertical(
        above_and_in_space,
        views.space("Grid map: right cells green, false red, missed orange", [*plan, grid, f"{overlay}/**"], eye),
    )


def _errors_in_scan() -> rrb.Container:
    verdicts = _mapped(rr.Points3D.from_fields(), "Points3D:colors", entities.POINT_VERDICT_COLOR)
    return rrb.Vertical(
        _scan_view("This scan: what is wrong", [entities.POINTS], (entities.POINTS, verdicts)),
        _scan_view("Its labels", [entities.POINTS]),
    )


def _errors_over_time() -> rrb.Container:
    kinds = (
        ("Walls", (Verdict.FALSE_WALL, Verdict.MISSED_WALL)),
        ("Doors", (Verdict.FALSE_DOOR, Verdict.MISSED_DOOR)),
        ("Other labels", (Verdict.OTHER,)),
    )
    return rrb.Horizontal(
        *(
            rrb.TimeSeriesView(
                origin=entities.SCAN_ERRORS,
                contents=[entities.scan_error(verdict) for verdict in verdicts],
                name=f"{what}: wrong returns in each scan, %",
            )
            for what, verdicts in kinds
        )
    )


def _method(line_pairs: int) -> rrb.Container:
    """The paper's figures, step by step."""
    return rrb.Vertical(
        rrb.Horizontal(
            _scan_view(
                "1. Floor and ceiling removed, here faint (Fig. 3)",
                [entities.POINTS, entities.FLOOR, entities.CEILING],
                (entities.POINTS, _mapped(rr.Points3D.from_fields(), "Points3D:radii", entities.POINT_RADIUS_UPRIGHT)),
            ),
            _scan_view(
                "2. Point lines (Fig. 5a): green wall, blue above a door, orange refused", [f"{entities.LINES}/**"]
            ),
            _curves(line_pairs, "3. Forward differences (eq. 2, Fig. 5b)"),
        ),
        rrb.Horizontal(
            _scan_view("4. Up-most structures: candidates (Fig. 6a)", [entities.UPMOST]),
            _scan_view("5. Bottom-most, for comparison (Fig. 6b)", [entities.BOTTOMMOST]),
            _scan_view(
                "6. Wall planes grown (Fig. 7); gray: refused",
                [entities.UPMOST, entities.PLANES],
                (
                    entities.UPMOST,
                    _mapped(rr.LineStrips3D.from_fields(), "LineStrips3D:colors", entities.CANDIDATE_PLANE_COLOR),
                ),
            ),
            _scan_view(
                "7. Door conditions: 1 gray, 2 orange, all 3 blue", [f"{entities.SCAN_DOORS}/**", entities.PLANES]
            ),
        ),
        name="Step by step",
    )


def _building(centre_m: tuple[float, float], extent_m: float, first: bool) -> rrb.Container:
    """first: it is the first tab, which says what it shows."""
    content = rrb.Horizontal(
        views.space(
            "Fused cloud, walls and doors (ceiling hidden)",
            [
                entities.CLOUD,
                entities.WALLS,
                entities.DOORS,
                entities.DOOR_LEAVES,
                entities.WINDOWS,
                entities.MULLIONS,
                entities.BLINDS,
                entities.FUSED_WALLS,
                entities.REFUSED_WALLS,
                entities.AGAINST_WALLS,
                f"{entities.LEVELS}/**",
            ],
            aslant(centre_m, extent_m),
            overrides={
                entities.DOORS: rr.LineStrips3D.from_fields(show_labels=True),
                # They hide what lies below; a click on their eye shows them.
                **{f"{entities.LEVELS}/{surface}": rrb.EntityBehavior(visible=False) for surface in entities.OVERHEAD},
            },
        ),
        rrb.Vertical(
            _grid(centre_m, extent_m),
            rrb.TextDocumentView(origin=entities.BUILDING_REASONS, name="Why: doors, refused faces, windows, surfaces"),
        ),
        column_shares=[3, 2],
    )
    strip = rrb.Horizontal(_label_legend(), _glance()) if first else _label_legend()
    return _below_legend(strip, content, "Building")


def _poses(eye: rrb.EyeControls3D | None, registered: bool) -> Part:
    """eye: None where nothing says how large the place is."""
    given = rrb.Spatial3DView(
        origin=entities.WORLD,
        contents=[entities.TRAJECTORY, f"{entities.BASE}/**"],
        name="Trajectory as given",
        eye_controls=eye,
        overrides={entities.TRAJECTORY: until_now()},
    )
    if not registered:
        return given
    quality = (
        ("weak", "Alarm: registration is weak (1 yes, 0 no)", (-0.1, 1.1)),
        ("refined_inlier_share", "Share of the sweep that fits the map (0 to 1)", (0.0, 1.05)),
        ("weakest_share", "Hold of the weakest direction / of the best (0 to 1)", (0.0, 1.05)),
        ("loops_moved_m", "How far closing the loops moved the pose, m", None),
        ("residual_m", "KISS-ICP: median distance to the local map, m", None),
        ("correction_m", "KISS-ICP: correction of the predicted pose, m", None),
        ("threshold_m", "KISS-ICP: adaptive threshold, m", None),
        ("milliseconds", "Registering a sweep, milliseconds", None),
    )
    return rrb.Horizontal(
        rrb.Spatial3DView(
            origin=entities.WORLD,
            contents=[f"{entities.ODOMETRY}/**", f"{entities.POSE_GRAPH}/**", entities.TRAJECTORY],
            name="Registered sweep yellow, its local map gray; trajectory blue, loops teal",
            eye_controls=eye,
            overrides={entities.TRAJECTORY: until_now()},
        ),
        rrb.Grid(*(_curve(entities.REGISTRATION, *curve) for curve in quality), grid_columns=2),
        name="Odometry",
    )


def _curve(group: str, name: str, title: str, range_y: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
    """One curve alone: its title says what it is, and a peak flattens nothing else."""
    return rrb.TimeSeriesView(
        origin=f"{group}/{name}",
        name=title,
        axis_y=rrb.ScalarAxis(range=range_y) if range_y else None,
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _metrics() -> rrb.Container:
    counted = (
        ("Lines, structures, candidates in each scan", ("lines", "structures", "candidates", "door_lines")),
        ("Wall planes and doors in each scan", ("planes", "openings")),
    )
    return rrb.Vertical(
        rrb.TimeSeriesView(origin=entities.LABEL_COUNTS, name="Number of returns of each label in each scan"),
        rrb.Horizontal(
            *(
                rrb.TimeSeriesView(
                    origin=entities.COUNTS, contents=[f"{entities.COUNTS}/{series}" for series in own], name=title
                )
                for title, own in counted
            )
        ),
        rrb.Horizontal(
            _curve(entities.RANGES, "scatter_mm", "Scatter of the ranges, mm"),
            _curve(entities.RANGES, "measured_alone_percent", "Returns on no facet, whose range stays as measured, %"),
        ),
        rrb.Horizontal(
            *(
                _curve(entities.MILLISECONDS, stage, f"{stage.capitalize()} a scan, milliseconds")
                for stage in ("reading", "smoothing", "placing", "labelling")
            )
        ),
        _warnings(),
        row_shares=[3, 3, 2, 2, 2],
        name="Metrics and warnings",
    )


def _warnings() -> rrb.Container:
    return rrb.Horizontal(
        rrb.TextDocumentView(origin=entities.WARNINGS, name="Warnings of the run"),
        rrb.TextLogView(origin=entities.MESSAGES, name="Scans skipped or weakly registered (empty: none)"),
        name="Warnings",
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
