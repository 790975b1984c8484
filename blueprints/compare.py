"""Runs side by side on one time cursor, and before that what differs between them and where."""

from collections.abc import Sequence
from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb

from ffmap.blueprints import entities
from ffmap.blueprints.maps import from_above, until_now
from ffmap.blueprints.timeline import time_panel

_LEGEND_SHARE = 0.4
"""Width left for the legends of curves, as a share of the curves' own: their views are narrow."""


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
    tabs: list[rrb.Container | rrb.View] = [_differences(first, other, centre_m, extent_m, scans) for other in others]
    if any(run.scans or run.map_points for run in runs):
        tabs.append(_side_by_side(runs, centre_m, extent_m))
    tabs.append(rrb.TextDocumentView(origin=entities.RUNS_TEXT, name="Runs, settings, figures"))
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=next((k for k, other in enumerate(others) if other.letter == most_changed), 0)),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time_panel(entities.SCAN_TIMELINE, scan),
        auto_views=False,
        auto_layout=False,
    )


def _differences(
    first: ComparedRun,
    other: ComparedRun,
    centre_m: tuple[float, float],
    extent_m: float,
    scans: tuple[int, int] | None,
) -> rrb.Container:
    letter = other.letter
    text = rrb.TextDocumentView(origin=entities.CHANGES_TEXT.format(letter), name=f"What differs: {other.title}")
    name = f"{letter} against {first.letter}"
    above = from_above(centre_m, extent_m)
    grid = f"{entities.GRID}/{first.letter}"
    where = [
        rrb.Spatial3DView(
            origin="/",
            contents=[grid, entities.CHANGED_CUBES.format(letter)],
            name=f"Where labels changed, {first.letter} → {letter}, over the map of {first.letter}",
            eye_controls=above,
            line_grid=rrb.LineGrid3D(visible=False),
        )
    ] * ("labels" in other.compared)
    where += [
        rrb.Spatial3DView(
            origin="/",
            contents=[
                grid,
                f"{entities.CHANGED_WALLS.format(letter)}/**",
                f"{entities.CHANGED_DOORS.format(letter)}/**",
                f"{entities.CHANGED_CELLS.format(letter)}/**",
                f"{entities.PATHS}/{first.letter}",
                f"{entities.PATHS}/{letter}",
            ],
            name="Walls, doors, map cells: lost red, gained green, altered yellow; lines: the robot's ways",
            eye_controls=above,
            line_grid=rrb.LineGrid3D(visible=False),
        )
    ] * bool(other.compared & {"walls", "doors", "grid", "trajectory"})
    backdrop = first if first.scans or not other.scans else other
    when: list[rrb.Container | rrb.View] = []
    if "labels" in other.compared:
        when += [
            rrb.Spatial3DView(
                origin=backdrop.path(entities.SCAN) if backdrop.scans else "/",
                # Without the scans' returns the map is what the changed ones are seen against.
                contents=[
                    backdrop.path(entities.POINTS) if backdrop.scans else grid,
                    entities.CHANGED_POINTS.format(letter),
                ],
                name=f"This scan: its changed points, {first.letter} → {letter}",
                overrides={
                    backdrop.path(entities.POINTS): rr.Points3D.from_fields(
                        colors=entities.BACKDROP_COLOR, radii=rr.Radius.ui_points(1.0)
                    )
                }
                if backdrop.scans
                else None,
                eye_controls=_behind_the_robot() if backdrop.scans else above,
                line_grid=rrb.LineGrid3D(visible=False),
            ),
            rrb.TimeSeriesView(
                origin=entities.CHANGED_PERCENT.format(letter),
                name="Changed labels in each scan, percent, in the colours of the points",
                plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
                axis_x=_beside_legend(scans),
            ),
        ]
    # What differs comes first: a line along zero tells nothing.
    by_scan = sorted(
        (
            ("trajectory", entities.POSE_DISTANCE, "Distance of the poses, metres"),
            ("planes", entities.CHANGED_PLANES, "Wall planes lost and gained"),
            ("labels", entities.CHANGED_PERCENT_SCAN, "Changed labels of single scans, percent"),
        ),
        key=lambda curve: curve[0] not in other.differing,
    )
    curves = [
        rrb.TimeSeriesView(
            origin=path.format(letter),
            name=title,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
            axis_x=_beside_legend(scans),
        )
        for what, path, title in by_scan
        if what in other.compared
    ]
    if curves:
        when.append(rrb.Tabs(*curves, active_tab=0))
    columns: list[rrb.Container | rrb.View] = [rrb.Vertical(*part) for part in (where, when) if part]
    return rrb.Horizontal(*columns, text, column_shares=[3] * len(columns) + [2.4], name=name)


def _beside_legend(scans: tuple[int, int] | None) -> rrb.archetypes.TimeAxis | None:
    """The time axis of curves over these scans, with room for the legend at their right."""
    if scans is None:
        return None
    first, last = scans
    end = last + max(round(_LEGEND_SHARE * (last - first)), 1)
    boundary = rr.TimeRangeBoundary.absolute
    return rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=boundary(seq=first), end=boundary(seq=end)))


def _side_by_side(runs: Sequence[ComparedRun], centre_m: tuple[float, float], extent_m: float) -> rrb.Container:
    x, y = centre_m
    return rrb.Horizontal(
        *(
            rrb.Vertical(
                *_scan_views(run),
                rrb.Spatial3DView(
                    origin=run.path(entities.WORLD),
                    contents=[
                        run.path(path)
                        for path in (
                            entities.MAP_POINTS,
                            entities.TRAJECTORY,
                            f"{entities.BASE}/**",
                            entities.WALLS,
                            entities.DOORS,
                            entities.WINDOWS,
                        )
                    ],
                    name=f"{run.title}: growing map",
                    overrides={
                        run.path(entities.MAP_POINTS): until_now(),
                        run.path(entities.TRAJECTORY): until_now(),
                    },
                    eye_controls=rrb.EyeControls3D(
                        position=(x - 0.3 * extent_m, y - 0.65 * extent_m, 0.65 * extent_m), look_target=(x, y, 0.0)
                    ),
                    line_grid=rrb.LineGrid3D(visible=False),
                ),
            )
            for run in runs
        ),
        name="Side by side",
    )


def _scan_views(run: ComparedRun) -> list[rrb.View]:
    if not run.scans:
        return []
    return [
        rrb.Spatial3DView(
            origin=run.path(entities.SCAN),
            contents=[run.path(entities.POINTS), run.path(entities.OPENINGS)],
            name=f"{run.title}: labelled scan",
            eye_controls=_behind_the_robot(),
            line_grid=rrb.LineGrid3D(visible=False),
        ),
        rrb.Spatial3DView(
            origin=run.path(entities.SCAN),
            contents=[run.path(entities.UPMOST), run.path(entities.PLANES), run.path("/scan/doors/**")],
            name=f"{run.letter}: wall candidates, planes, doors (rest the pointer on one: why)",
            overrides={run.path(entities.OPENINGS): rr.LineStrips3D.from_fields(show_labels=False)},
            eye_controls=_behind_the_robot(),
            line_grid=rrb.LineGrid3D(visible=False),
        ),
    ]


def _behind_the_robot() -> rrb.EyeControls3D:
    return rrb.EyeControls3D(position=(-4.8, -3.9, 4.3), look_target=(0.2, 0.0, 1.1))
