"""Runs side by side on one time cursor, and before that what differs between them and where."""

from collections.abc import Sequence
from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb

from ffmap.blueprints import entities
from ffmap.blueprints.views import Part, aslant, behind_the_robot, from_above, layout, opening_at, space

_LEGEND_SHARE = 0.4  # Width left for the legends of curves, as a share of the curves' own: their views are narrow


@dataclass(frozen=True)
class ComparedRun:
    """A run as the layout shows it.

    letter: its entities lie below it. scans: whether single scans are there. map_points: whether its growing map is.
    compared: what was compared with the first run: labels, planes, trajectory, walls, doors, grid. differing: of labels,
    planes and trajectory, what differs.
    """

    letter: str
    title: str
    scans: bool
    map_points: bool
    compared: frozenset[str] = frozenset()
    differing: frozenset[str] = frozenset()

    def path(self, path: str) -> str:
        """Where an entity of the run's recording lies in the comparison."""
        return f"/{self.letter}{path}"


def build(
    runs: Sequence[ComparedRun],
    centre_m: tuple[float, float] = (0.0, 0.0),
    extent_m: float = 20.0,
    scan: int | None = None,
    most_changed: str | None = None,
    scans: tuple[int, int] | None = None,
) -> rrb.Blueprint:
    """The layout of a comparison of the first run with each of the others.

    centre_m, extent_m: middle and size of what the maps show. scan: the one to open at; None for the first.
    most_changed: letter of the run whose tab is open at first; None for the first. scans: number of the first and of the
    last one that curves show; None where that is not known.
    """
    first, *others = runs
    above = from_above(centre_m, extent_m)
    tabs: list[Part] = [_differences(first, other, above, scans) for other in others]
    if any(run.scans or run.map_points for run in runs):
        tabs.append(_side_by_side(runs, centre_m, extent_m))
    tabs.append(rrb.TextDocumentView(origin=entities.RUNS_TEXT, name="Runs, settings, figures"))
    active = next((k for k, other in enumerate(others) if other.letter == most_changed), 0)
    return layout(rrb.Tabs(*tabs, active_tab=active), opening_at(entities.SCAN_TIMELINE, scan))


def _differences(
    first: ComparedRun, other: ComparedRun, above: rrb.EyeControls3D, scans: tuple[int, int] | None
) -> rrb.Container:
    """What differs between two runs: where, when, and in words."""
    columns = [rrb.Vertical(*part) for part in (_where(first, other, above), _when(first, other, above, scans)) if part]
    text = rrb.TextDocumentView(origin=entities.CHANGES_TEXT.format(other.letter), name=f"What differs: {other.title}")
    return rrb.Horizontal(
        *columns, text, column_shares=[3] * len(columns) + [2.4], name=f"{other.letter} against {first.letter}"
    )


def _where(first: ComparedRun, other: ComparedRun, above: rrb.EyeControls3D) -> list[Part]:
    letter, grid = other.letter, f"{entities.GRID}/{first.letter}"
    views: list[Part] = []
    if "labels" in other.compared:
        name = f"Where labels changed, {first.letter} → {letter}, over the map of {first.letter}"
        views.append(space(name, [grid, entities.CHANGED_CUBES.format(letter)], above, origin="/"))
    if other.compared & {"walls", "doors", "grid", "trajectory"}:
        contents = [
            grid,
            f"{entities.CHANGED_WALLS.format(letter)}/**",
            f"{entities.CHANGED_DOORS.format(letter)}/**",
            f"{entities.CHANGED_CELLS.format(letter)}/**",
            f"{entities.PATHS}/{first.letter}",
            f"{entities.PATHS}/{letter}",
        ]
        name = "Walls, doors, map cells: lost red, gained green, altered yellow; lines: the robot's ways"
        views.append(space(name, contents, above, origin="/"))
    return views


def _when(
    first: ComparedRun, other: ComparedRun, above: rrb.EyeControls3D, scans: tuple[int, int] | None
) -> list[Part]:
    views: list[Part] = []
    if "labels" in other.compared:
        percent = "Changed labels in each scan, percent, in the colours of the points"
        views = [_changed_points(first, other, above), _curve(entities.CHANGED_PERCENT, other, percent, scans)]
    curves = (
        ("trajectory", entities.POSE_DISTANCE, "Distance of the poses, metres"),
        ("planes", entities.CHANGED_PLANES, "Wall planes lost and gained"),
        ("labels", entities.CHANGED_PERCENT_SCAN, "Changed labels of single scans, percent"),
    )
    # What differs comes first: a line along zero tells nothing.
    by_interest = sorted(curves, key=lambda curve: curve[0] not in other.differing)
    shown = [_curve(path, other, title, scans) for what, path, title in by_interest if what in other.compared]
    return [*views, rrb.Tabs(*shown, active_tab=0)] if shown else views


def _changed_points(first: ComparedRun, other: ComparedRun, above: rrb.EyeControls3D) -> rrb.Spatial3DView:
    """The changed returns before the scan's others, or before the map where the recordings have no scans."""
    name = f"This scan: its changed points, {first.letter} → {other.letter}"
    changed = entities.CHANGED_POINTS.format(other.letter)
    backdrop = first if first.scans or not other.scans else other
    if not backdrop.scans:
        return space(name, [f"{entities.GRID}/{first.letter}", changed], above, origin="/")
    points = backdrop.path(entities.POINTS)
    faint = rr.Points3D.from_fields(colors=entities.BACKDROP_COLOR, radii=rr.Radius.ui_points(1.0))
    return space(
        name, [points, changed], behind_the_robot(), origin=backdrop.path(entities.SCAN), overrides={points: faint}
    )


def _curve(path: str, run: ComparedRun, title: str, scans: tuple[int, int] | None) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=path.format(run.letter),
        name=title,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
        axis_x=_beside_legend(scans),
    )


def _beside_legend(scans: tuple[int, int] | None) -> rrb.archetypes.TimeAxis | None:
    """The time axis of curves over these scans, with room for the legend at their right."""
    if scans is None:
        return None
    first, last = scans
    end = last + max(round(_LEGEND_SHARE * (last - first)), 1)
    boundary = rr.TimeRangeBoundary.absolute
    return rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=boundary(seq=first), end=boundary(seq=end)))


def _side_by_side(runs: Sequence[ComparedRun], centre_m: tuple[float, float], extent_m: float) -> rrb.Container:
    eye = aslant(centre_m, extent_m, (-0.3, -0.65, 0.65))
    columns = [rrb.Vertical(*_scan_views(run), _growing_map(run, eye)) for run in runs]
    return rrb.Horizontal(*columns, name="Side by side")


def _growing_map(run: ComparedRun, eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    base = f"{entities.BASE}/**"
    shown = (entities.MAP_POINTS, entities.TRAJECTORY, base, entities.WALLS, entities.DOORS, entities.WINDOWS)
    return space(
        f"{run.title}: growing map",
        [run.path(path) for path in shown],
        eye,
        origin=run.path(entities.WORLD),
    )


def _scan_views(run: ComparedRun) -> list[rrb.View]:
    if not run.scans:
        return []
    return [
        space(
            f"{run.title}: labelled scan",
            [run.path(entities.POINTS), run.path(entities.OPENINGS)],
            behind_the_robot(),
            origin=run.path(entities.SCAN),
        ),
        space(
            f"{run.letter}: wall candidates, planes, doors (rest the pointer on one: why)",
            [run.path(entities.UPMOST), run.path(entities.PLANES), run.path(f"{entities.SCAN_DOORS}/**")],
            behind_the_robot(),
            origin=run.path(entities.SCAN),
            overrides={run.path(entities.OPENINGS): rr.LineStrips3D.from_fields(show_labels=False)},
        ),
    ]
