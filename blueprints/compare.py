"""Layout of a comparison: what differs between runs and where, then the runs side by side."""

from collections.abc import Sequence
from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb

from ffmap.blueprints import entities
from ffmap.blueprints.views import (
    Part,
    aslant,
    behind_the_robot,
    from_above,
    layout,
    opening_at,
    space,
)

_BACKDROP_COLOR = (86, 90, 98)
_LEGEND_SHARE = 0.4
"""Width for the legends of curves, as a share of that of the curves."""


@dataclass(frozen=True)
class ComparedRun:
    """A run in the layout.

    letter: its entities are below it. scans, map_points: whether its recording has single scans,
    and the growing map. compared: the subjects compared with the first run. judged: whether the
    ground truth shows which labels became right and wrong.
    """

    letter: str
    title: str
    scans: bool
    map_points: bool
    compared: frozenset[str] = frozenset()
    judged: bool = False

    def path(self, path: str) -> str:
        """Return the path of an entity of the run's recording."""
        return f"/{self.letter}{path}"


def build(
    runs: Sequence[ComparedRun],
    centre_m: tuple[float, float] = (0.0, 0.0),
    extent_m: float = 20.0,
    scan: int | None = None,
    most_changed: str | None = None,
    scans: tuple[int, int] | None = None,
) -> rrb.Blueprint:
    """Lay out a comparison of the first run with each of the others.

    Args:
        centre_m, extent_m: middle and size of the maps.
        scan, most_changed: scan and letter of the run to open at.
        scans: the first and the last scan of curves.
    """
    first, *others = runs
    above = from_above(centre_m, extent_m)
    tabs: list[Part] = [_differences(first, other, above, scans) for other in others]
    shown = [run for run in runs if run.scans or run.map_points]
    if shown:
        eye = aslant(centre_m, extent_m, (-0.3, -0.65, 0.65))
        columns = [rrb.Vertical(*_scan_views(run), _growing_map(run, eye)) for run in runs]
        tabs.append(rrb.Horizontal(*columns, name="Side by side"))
    tabs.append(rrb.TextDocumentView(origin="/changes/runs", name="Runs, settings, figures"))
    active = next((k for k, other in enumerate(others) if other.letter == most_changed), 0)
    time = opening_at(entities.SCAN_TIMELINE, scan)
    return layout(rrb.Tabs(*tabs, active_tab=active), time)


def _differences(
    first: ComparedRun,
    other: ComparedRun,
    above: rrb.EyeControls3D,
    scans: tuple[int, int] | None,
) -> rrb.Container:
    """What differs between two runs: where, when, and in figures."""
    letter, grid = other.letter, f"{entities.GRID}/{first.letter}"
    where: list[Part] = []
    when: list[Part] = []
    if other.judged:
        name = f"Became right green, wrong red, {first.letter} → {letter}, by ground truth"
        judged = [grid, f"/changes/{letter}/became_right", f"/changes/{letter}/became_wrong"]
        where.append(space(name, judged, above, origin="/"))
    if "labels" in other.compared:
        name = f"Where labels changed, {first.letter} → {letter}, over the map of {first.letter}"
        changed = [grid, f"/changes/{letter}/cubes"]
        where.append(space(name, changed, above, origin="/"))
        when.append(_changed_points(first, other, above))
        title = "Changed labels, percent of each scan, in the colours of the points"
        when.append(_curve("/changes/{}/percent", other, title, scans))
        if other.judged:
            title = "Became right, wrong, percent"
            when.append(_curve("/changes/{}/percent_judged", other, title, scans))
        title = "Changed in single scans, percent"
        when.append(_curve("/changes/{}/percent_of_single_scans", other, title, scans))
    if other.compared & {"walls", "doors", "grid", "trajectory"}:
        name = "Walls, doors, cells: lost red, gained green, altered yellow; lines: trajectories"
        changed = [f"/changes/{letter}/building/**"]
        paths = [f"/paths/{own}" for own in (first.letter, letter)]
        where.append(space(name, [grid, *changed, *paths], above, origin="/"))
    if "trajectory" in other.compared:
        title = "Distance of poses, m"
        when.append(_curve("/changes/{}/pose_distance_m", other, title, scans))
    if len(when) > 2:
        when = [*when[:2], rrb.Tabs(*when[2:])]
    columns = [rrb.Vertical(*part) for part in (where, when) if part]
    name = f"What differs: {other.title}"
    text = rrb.TextDocumentView(origin=f"/changes/{letter}/text", name=name)
    shares = [3] * len(columns) + [2.4]
    title = f"{letter} against {first.letter}"
    return rrb.Horizontal(*columns, text, column_shares=shares, name=title)


def _changed_points(
    first: ComparedRun, other: ComparedRun, above: rrb.EyeControls3D
) -> rrb.Spatial3DView:
    """The changed points before the scan's others, or before the map without scans."""
    name = f"This scan: its changed points, {first.letter} → {other.letter}"
    changed = f"/changes/{other.letter}/points"
    backdrop = first if first.scans or not other.scans else other
    if not backdrop.scans:
        return space(name, [f"{entities.GRID}/{first.letter}", changed], above, origin="/")
    points, origin = backdrop.path(entities.POINTS), backdrop.path("/scan")
    faint = rr.Points3D.from_fields(colors=_BACKDROP_COLOR, radii=rr.Radius.ui_points(1.0))
    overrides = {points: faint}
    return space(name, [points, changed], behind_the_robot(), origin=origin, overrides=overrides)


def _curve(
    path: str, run: ComparedRun, title: str, scans: tuple[int, int] | None
) -> rrb.TimeSeriesView:
    """A curve over the scans, with room for its legend at the right."""
    axis = None
    if scans is not None:
        first, last = scans
        end = last + max(round(_LEGEND_SHARE * (last - first)), 1)
        boundary = rr.TimeRangeBoundary.absolute
        view_range = rr.TimeRange(start=boundary(seq=first), end=boundary(seq=end))
        axis = rrb.archetypes.TimeAxis(view_range=view_range)
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
    origin = path.format(run.letter)
    return rrb.TimeSeriesView(origin=origin, name=title, plot_legend=legend, axis_x=axis)


def _growing_map(run: ComparedRun, eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    shown = (
        entities.MAP_POINTS,
        entities.TRAJECTORY,
        "/world/base/**",
        f"{entities.WALLS}/**",
        "/world/building/doors",
        "/world/building/windows",
    )
    paths, origin = [run.path(path) for path in shown], run.path("/world")
    return space(f"{run.title}: growing map", paths, eye, origin=origin)


def _scan_views(run: ComparedRun) -> list[rrb.View]:
    if not run.scans:
        return []
    openings, origin = run.path(entities.OPENINGS), run.path("/scan")
    labelled = [run.path(entities.POINTS), openings]
    reasons = ["/scan/candidates/upmost", entities.PLANES, "/scan/doors/**"]
    without_names = {openings: rr.LineStrips3D.from_fields(show_labels=False)}
    title = f"{run.letter}: wall candidates, planes, doors (hover for the reason)"
    return [
        space(f"{run.title}: labelled scan", labelled, behind_the_robot(), origin=origin),
        space(
            title,
            [run.path(path) for path in reasons],
            behind_the_robot(),
            origin=origin,
            overrides=without_names,
        ),
    ]
