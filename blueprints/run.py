"""One run: a labelled scan, its lines and differences, the building, maps, rooms, and figures."""

from collections.abc import Mapping, Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from ffmap.algorithms.base.labels import Verdict
from ffmap.blueprints import entities, maps, rooms
from ffmap.blueprints.entities import FURNITURE_FREE, GRID, OPENINGS, OVERHEAD, PLANES, POINTS
from ffmap.blueprints.views import (
    ROBOT,
    WITHOUT_NAMES,
    Part,
    aslant,
    behind_the_robot,
    differences,
    following,
    from_above,
    layout,
    legend,
    space,
    text,
    view_of,
)

__all__ = ["build", "view_of"]

_FURNITURE_FREE_GRID = f"{GRID}/{FURNITURE_FREE}"
_DIFFERENCES = "Forward differences (eq. 2, Fig. 5b)"
Centre = tuple[float, float]


def build(
    labelled: bool = True,
    centre_m: Centre = (0.0, 0.0),
    extent_m: float = 20.0,
    evaluated: bool = False,
    scans: bool = True,
    several: bool = False,
    registered: bool = True,
    lines: bool = True,
    several_lidars: bool = False,
    growing: bool = False,
) -> rrb.Blueprint:
    """Return the layout of a run's recording.

    labelled: scans were labelled; else there are poses only.
    centre_m, extent_m: of what the maps show.
    evaluated: with the errors of `evaluation.rrd`, as the first tab.
    scans, lines: the recording has single scans, and their point lines.
    several: for several runs, with the list of recordings open.
    registered: the poses are from the odometry.
    several_lidars: scans are from several lidars; the layout names the lidar of each scan.
    growing: for a run under way without a map: the map of the odometry is shown.
    """
    readme = text("/readme", "Read me")
    if not labelled:
        poses = _poses(None, registered)
        name = "Odometry" if registered else "Trajectory as given"
        only = rrb.Vertical(_glance(), poses, row_shares=[1, 12], name=name)
        return _tabs([only, _warnings(), readme], entities.STAMP_TIMELINE, several)
    place = centre_m, extent_m
    tabs: list[Part] = [
        _building(*place, first=not scans),
        maps.tab(*place, evaluated),
        rooms.tab(*place, compared=True),
        _poses(aslant(*place), registered),
    ]
    if scans:
        steps = [_step_by_step()] if lines else []
        tabs = [_overview(*place, lines, several_lidars, growing), *steps, *tabs]
    else:
        tabs.insert(3, _map(*place))
    errors = _evaluation(*place, scans, evaluated)
    last: list[Part] = [_metrics(), readme] if evaluated else [_metrics(), errors, readme]
    tabs = [*([errors] if evaluated else []), *tabs, *last]
    return _tabs(tabs, entities.SCAN_TIMELINE, several)


def _tabs(tabs: Sequence[Part], timeline: str, several: bool) -> rrb.Blueprint:
    return layout(rrb.Tabs(*tabs, active_tab=0), following(timeline), recordings=several)


def _overview(
    centre_m: Centre, extent_m: float, lines: bool, several_lidars: bool, growing: bool
) -> rrb.Container:
    # The viewer reports an error for an override of an entity without data.
    names = None if growing else WITHOUT_NAMES
    detected: list[Part] = [_scan("Wall planes and doors of the scan", [PLANES, OPENINGS], names)]
    if lines:
        title = "Lines, wall planes; violet: line of the curve"
        scan = _scan(title, ["/scan/lines/**", PLANES, OPENINGS], names)
        detected = [scan, differences(_DIFFERENCES)]
    labels = (
        "Labels by the scan alone; final ones follow" if growing else "Final labels of the scan"
    )
    lidar = [text("/scan/lidar", "Lidar of the scan")] if several_lidars else []
    return rrb.Vertical(
        rrb.Horizontal(_label_legend(), _glance(), *lidar),
        rrb.Horizontal(_scan(labels, [POINTS, OPENINGS]), _map(centre_m, extent_m, growing)),
        rrb.Horizontal(
            *detected,
            _grid(centre_m, extent_m, growing),
            column_shares=[1, 1.25, 1] if lines else [1, 1],
        ),
        row_shares=[1.8, 5, 5],
        name="At a glance",
    )


def _label_legend() -> rrb.View:
    return legend("/legend/labels", "Colours of the labels", 6)


def _glance() -> rrb.View:
    return text("/glance", "What this shows")


def _scan(
    name: str, contents: list[str], overrides: Mapping[Any, Any] | None = None
) -> rrb.Spatial3DView:
    return space(name, contents, behind_the_robot(), "/scan", overrides)


def _map(centre_m: Centre, extent_m: float, growing: bool = False) -> rrb.Spatial3DView:
    hidden = "cloud", "ceiling", "fused_walls", "against_walls", "levels/**", "sills", "faces/**"
    return space(
        "Map of the odometry; the labelled map follows"
        if growing
        else "Map up to the time cursor (ceiling hidden)",
        [
            entities.MAP_POINTS,
            *ROBOT,
            "/world/building/**",
            *(f"- /world/building/{name}" for name in hidden),
            *(["/world/odometry/local_map"] if growing else []),
        ],
        aslant(centre_m, extent_m, (-0.35, -0.8, 0.85)),
    )


def _grid(centre_m: Centre, extent_m: float, growing: bool = False) -> rrb.Spatial3DView:
    return space(
        "From above; the grid map follows"
        if growing
        else "Grid map: wall black, unseen gray, door blue",
        [
            _FURNITURE_FREE_GRID,
            "/world/building/sills",
            *ROBOT,
            *(["/world/odometry/local_map"] if growing else []),
        ],
        from_above(centre_m, extent_m),
    )


def _step_by_step() -> rrb.Container:
    """Return the figures of the paper, step by step."""
    upright = _mapped(rr.Points3D, "Points3D:radii", entities.POINT_RADIUS_UPRIGHT)
    by_plane = _mapped(rr.LineStrips3D, "LineStrips3D:colors", entities.CANDIDATE_PLANE_COLOR)
    upmost = "/scan/candidates/upmost"
    return rrb.Vertical(
        rrb.Horizontal(
            _scan(
                "1. Floor and ceiling removed, here outlines (Fig. 3)",
                [POINTS, "/scan/floor", "/scan/ceiling"],
                {POINTS: upright},
            ),
            _scan(
                "2. Fig. 5a: wall green, door blue, refused orange",
                ["/scan/lines/**"],
            ),
            differences(f"3. {_DIFFERENCES}"),
        ),
        rrb.Horizontal(
            _scan("4. Fig. 6a: up-most structures", [upmost]),
            _scan("5. Fig. 6b: bottom-most ones", ["/scan/candidates/bottommost"]),
            _scan("6. Fig. 7: planes; refused gray", [upmost, PLANES], {upmost: by_plane}),
            _scan("7. Door: 1 gray, 2 orange, 3 blue", ["/scan/doors/**", PLANES]),
        ),
        name="Step by step",
    )


def _mapped(
    archetype: type[rr.Points3D | rr.LineStrips3D], target: str, component: str
) -> rrb.Visualizer:
    """Return a visualizer that draws another component of the entity in place of a standard one."""
    mapping = VisualizerComponentMapping(
        target=target,
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=component,
    )
    return archetype.from_fields().visualizer(mappings=[mapping])


def _building(centre_m: Centre, extent_m: float, first: bool) -> rrb.Container:
    """Return the whole building. first: as the first tab, which explains what it shows."""
    # They hide the rooms below; a click on their eye symbol shows them.
    overhead = {
        f"/world/building/levels/{surface}": rrb.EntityBehavior(visible=False)
        for surface in OVERHEAD
    }
    names = {"/world/building/doors": rr.LineStrips3D.from_fields(show_labels=True)}
    cloud = space(
        "Fused cloud, walls and doors (ceiling hidden)",
        [
            *("/world/building/**", "- /world/building/ceiling", "- /world/building/sills"),
            f"- {entities.FACES}/**",
        ],
        aslant(centre_m, extent_m),
        overrides={**names, **overhead},
    )
    faces = space(
        "Cells of faces: solid green, recess blue, open white, hidden orange, unseen black",
        [f"{entities.FACES}/**"],
        aslant(centre_m, extent_m),
    )
    reasons = text(entities.REASONS, "Evidence for doors, refused faces, walls, windows")
    labels = _label_legend()
    return rrb.Vertical(
        rrb.Horizontal(labels, _glance()) if first else labels,
        rrb.Horizontal(
            rrb.Tabs(cloud, faces),
            rrb.Vertical(_grid(centre_m, extent_m), reasons),
            column_shares=[3, 2],
        ),
        row_shares=[2, 12],
        name="Building",
    )


def _poses(eye: rrb.EyeControls3D | None, registered: bool) -> Part:
    """Return the tab of the poses. eye: None if the size of the place is not known."""
    if not registered:
        return space("Trajectory as given", ROBOT, eye)
    quality = (
        ("weak", "Alarm: registration is weak (1 yes, 0 no)", (-0.1, 1.1)),
        ("refined_inlier_share", "Share of the sweep that fits the map", (0.0, 1.05)),
        ("weakest_share", "Constraint: weakest / best direction", (0.0, 1.05)),
        ("loops_moved_m", "Correction of the pose by loop closure, m", None),
        ("residual_m", "KISS-ICP: median distance to the map, m", None),
        ("correction_m", "KISS-ICP: correction of the prediction, m", None),
        ("threshold_m", "KISS-ICP: adaptive threshold, m", None),
        ("milliseconds", "Registration of a sweep, milliseconds", None),
    )
    return rrb.Horizontal(
        space(
            "Sweep yellow, local map gray; trajectory blue, loops teal",
            ["/world/odometry/**", "/world/pose_graph/**", entities.TRAJECTORY],
            eye,
        ),
        rrb.Grid(
            *(
                _curve(f"/metrics/registration/{name}", title, axis)
                for name, title, axis in quality
            ),
            grid_columns=2,
        ),
        column_shares=[2, 3],
        name="Odometry",
    )


def _curve(
    origin: str, title: str, range_y: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    """Return one curve alone: its title names it, and its peaks flatten no other curve."""
    return rrb.TimeSeriesView(
        origin=origin,
        name=title,
        axis_y=rrb.ScalarAxis(range=range_y) if range_y else None,
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _curves(origin: str, names: Sequence[str], title: str) -> rrb.TimeSeriesView:
    contents = [f"{origin}/{name}" for name in names]
    return rrb.TimeSeriesView(origin=origin, contents=contents, name=title)


def _metrics() -> rrb.Container:
    counts, ranges, stages = "/metrics/counts", "/metrics/ranges", "/metrics/milliseconds"
    labels = "Returns of each label in each scan, by the scan alone (label_scan)"
    lines = "lines", "structures", "candidates", "door_lines"
    return rrb.Vertical(
        rrb.TimeSeriesView(origin="/metrics/labels", name=labels),
        rrb.Horizontal(
            _curves(counts, lines, "Lines, structures, candidates in each scan"),
            _curves(counts, ("planes", "openings"), "Wall planes and doors in each scan"),
        ),
        rrb.Horizontal(
            _curve(f"{ranges}/scatter_mm", "Scatter of the ranges, mm"),
            _curve(f"{ranges}/measured_alone_percent", "Returns whose range is not smoothed, %"),
        ),
        rrb.Horizontal(
            *(
                _curve(f"{stages}/{stage}", f"{stage.capitalize()} a scan, milliseconds")
                for stage in ("reading", "smoothing", "placing", "labelling")
            )
        ),
        _warnings(),
        row_shares=[6, 4.5, 2.2, 2.2, 2],
        name="Metrics and warnings",
    )


def _warnings() -> rrb.Container:
    messages = "Scans skipped or weakly registered (empty: none)"
    return rrb.Horizontal(
        text("/warnings", "Warnings of the run"),
        rrb.TextLogView(origin="/messages", name=messages),
        name="Warnings",
    )


def _evaluation(centre_m: Centre, extent_m: float, scans: bool, evaluated: bool) -> rrb.Container:
    """Return errors and figures; if not evaluated, after a text on where to find them."""
    figures = text("/evaluation/figures", "Figures")
    errors: list[Part] = [_errors_on_map(centre_m, extent_m)]
    if scans:
        verdicts = _mapped(rr.Points3D, "Points3D:colors", entities.POINT_VERDICT_COLOR)
        in_scan = _scan("This scan: errors", [POINTS], {POINTS: verdicts})
        errors.append(rrb.Vertical(in_scan, _scan("Its labels", [POINTS])))
    parts: list[Part] = [
        legend("/legend/errors", "Colours of errors", 7),
        rrb.Horizontal(*errors, column_shares=[4, 3][: len(errors)]),
    ]
    if scans:
        parts.append(_errors_over_time())
    where = rrb.Vertical(*parts, row_shares=[2, 10, 3][: len(parts)], name="Errors")
    if not evaluated:
        about = text("/evaluation/help", "What this needs")
        return rrb.Tabs(about, figures, where, active_tab=0, name="Evaluation")
    return rrb.Horizontal(where, figures, column_shares=[7, 3], name="Evaluation")


def _errors_on_map(centre_m: Centre, extent_m: float) -> rrb.Container:
    above, invented = from_above(centre_m, extent_m), "/world/errors/invented_doors"
    plan = ["/world/truth/walls", "/world/truth/door_sills", invented]
    in_space = ["/world/truth/walls", "/world/truth/doors", invented]
    overlay = f"/world/overlay/{FURNITURE_FREE}/**"
    grid = "Grid map: right cells green, false red, missed orange"
    return rrb.Vertical(
        rrb.Tabs(
            space("Errors from above", [*plan, "/world/errors/plan/**", *ROBOT], above),
            space(
                "Errors in space",
                [*in_space, "/world/errors/space/**", *ROBOT],
                aslant(centre_m, extent_m),
            ),
            active_tab=0,
        ),
        space(grid, [*plan, _FURNITURE_FREE_GRID, overlay], above),
    )


def _errors_over_time() -> rrb.Container:
    kinds = {
        "Walls": (Verdict.FALSE_WALL, Verdict.MISSED_WALL),
        "Doors": (Verdict.FALSE_DOOR, Verdict.MISSED_DOOR),
        "Other": (Verdict.OTHER,),
    }
    return rrb.Horizontal(
        *(
            rrb.TimeSeriesView(
                origin="/metrics/errors",
                contents=[entities.scan_error(verdict) for verdict in verdicts],
                name=f"{what}: wrong returns, %",
            )
            for what, verdicts in kinds.items()
        )
    )
