"""The layout names only what the recorder writes, and every view says what it shows."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import rerun.blueprint as rrb

from ffmap.algorithms.base.labels import Verdict
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.blueprints import compare, entities, inspect, rooms, run
from ffmap.blueprints.entities import CurveSheet


def views(part: rrb.Container | rrb.View) -> Iterator[rrb.View]:
    if isinstance(part, rrb.View):
        yield part
    else:
        for inner in part.contents:
            yield from views(inner)


def test_every_view_has_a_name_and_an_origin_that_is_written():
    known = {value for value in vars(entities).values() if isinstance(value, str) and value.startswith("/")}
    shown = list(views(run.build().root_container))
    assert len(shown) > 10
    for view in shown:
        assert view.name
        assert any(
            path == str(view.origin) or path.startswith(f"{view.origin}/") or str(view.origin).startswith(f"{path}/")
            for path in known
        )


def test_which_lidar_a_scan_is_from_is_told_where_there_are_several():
    for several in (False, True):
        origins = [str(view.origin) for view in views(run.build(several_lidars=several).root_container)]
        assert (entities.SCAN_LIDAR in origins) == several
    rig = {"horizontal": {"topic": "/h"}, "vertical": {"topic": "/l"}, "vertical_2": {"topic": "/r"}}
    assert "Three lidars, two tasks." in entities.explain({"rig": rig})
    assert "The vertical 2 one, `/r`, sweeps walls" in entities.explain({"rig": rig})


def test_a_comparison_shows_what_was_compared_and_no_more():
    first = compare.ComparedRun("A", "A: usual", scans=True, map_points=True)
    parts = frozenset({"labels", "planes", "trajectory", "walls", "doors", "grid"})
    other = compare.ComparedRun("B", "B: other", scans=True, map_points=True, compared=parts)
    layout = compare.build([first, other], scan=17)
    names = [str(view.name) for view in views(layout.root_container)]
    for word in ("Where labels changed, A → B", "its changed points", "Distance of the poses", "lost red"):
        assert any(word in name for name in names)
    curves = [name for name in names if name.startswith(("Distance", "Wall planes", "Changed labels of single"))]
    assert curves[0].startswith("Distance")
    moved = replace(other, differing=frozenset({"planes"}))
    names = [str(view.name) for view in views(compare.build([first, moved]).root_container)]
    assert next(name for name in names if name in curves).startswith("Wall planes")
    nothing = compare.ComparedRun("B", "B: other", scans=False, map_points=False)
    bare = compare.build([compare.ComparedRun("A", "A", False, False), nothing])
    assert [type(view) for view in views(bare.root_container)] == [rrb.TextDocumentView] * 2
    labels_only = compare.ComparedRun("B", "B", True, False, frozenset({"labels"}))
    shown = [str(view.name) for view in views(compare.build([first, labels_only]).root_container)]
    assert not any("Walls, doors" in name or "poses" in name for name in shown)


def test_a_comparison_opens_on_what_changed_most_and_its_legends_hide_no_curve():
    parts = frozenset({"labels", "planes", "trajectory"})
    runs_shown = [compare.ComparedRun(letter, letter, True, True, parts) for letter in "ABC"]
    tabs = compare.build(runs_shown, most_changed="C").root_container
    assert [str(tab.name) for tab in tabs.contents][tabs.active_tab] == "C against A"
    assert compare.build(runs_shown).root_container.active_tab == 0
    layout = compare.build(runs_shown, scans=(10, 110))
    plots = [view for view in views(layout.root_container) if isinstance(view, rrb.TimeSeriesView)]
    assert len(plots) == 8
    for plot in plots:
        assert plot.properties["PlotLegend"].corner.as_arrow_array().to_pylist() == [rrb.Corner2D.RightTop.value]
        (shown,) = plot.properties["TimeAxis"].view_range.as_arrow_array().to_pylist()
        assert shown["start"] == 10
        assert shown["end"] == 150
    bare = [view for view in views(compare.build(runs_shown).root_container) if isinstance(view, rrb.TimeSeriesView)]
    assert all("TimeAxis" not in plot.properties for plot in bare)


def test_a_scan_shows_the_line_its_curve_its_profile_and_why():
    names = " ".join(str(view.name) for view in views(inspect.build((5.0, 3.0), 7).root_container))
    for word in ("The line in its scan", "eq. 2, Fig. 5b", "profile", "Why: this line", "Why: the whole scan"):
        assert word in names


def test_rooms_have_a_tab_and_a_layout_of_their_own():
    tabs = run.build().root_container.contents
    assert "Rooms" in [str(tab.name) for tab in tabs]
    own = list(views(rooms.build((3.0, 4.0), 10.0).root_container))
    shown = {path for view in own for path in view.contents} | {str(view.origin) for view in own}
    assert {f"{entities.ROOMS}/{part}" for part in (entities.ROOM_FLOORS, entities.ROOM_NAMES)} <= shown
    assert f"{entities.GRID}/{entities.SEGMENTED}" in shown
    assert any(isinstance(view, rrb.GraphView) and view.origin == entities.ROOM_GRAPH for view in own)


def test_maps_and_rooms_have_tabs_with_and_without_scans():
    for scans in (True, False):
        names = [str(tab.name) for tab in run.build(scans=scans).root_container.contents]
        assert {"Building", "Maps", "Rooms"} <= set(names)


def test_rooms_of_the_maps_of_fig_10_stand_side_by_side():
    tab = rooms.tab((3.0, 4.0), 10.0, compared=True)
    shown = {path for view in views(tab) for path in view.contents}
    assert f"{entities.ROOMS}/{entities.ROOM_FLOORS}" in shown
    for name in set(Segmented) - {Segmented.FURNITURE_FREE}:
        assert f"{entities.ROOMS_COMPARED}/{name}/floors" in shown
        assert f"{entities.ROOMS_COMPARED}/{name}/names" in shown


def test_the_first_tab_shows_scan_lines_curves_map_and_grid():
    overview = run.build().root_container.contents[0]
    names = " ".join(str(view.name) for view in views(overview))
    for word in ("Labelled scan", "Point lines", "Forward differences", "Map up to the time cursor", "Grid map"):
        assert word in names


@pytest.mark.parametrize(
    ("rings", "scans", "legends"),
    [(32, True, [entities.LABEL_LEGEND]), (32, False, [entities.LABEL_LEGEND]), (None, True, [])],
)
def test_the_first_tab_says_what_it_shows_and_where_all_is_explained(
    rings: int | None, scans: bool, legends: list[str]
) -> None:
    tabs = run.build(rings, scans=scans).root_container.contents
    origins = [str(view.origin) for view in views(tabs[0])]
    assert origins[: len(legends) + 1] == [*legends, entities.GLANCE]
    assert str(tabs[-1].name) == "Read me"
    text = entities.glance(rings is not None, scans)
    assert f"**{tabs[-1].name}**" in text
    assert text.startswith(
        {(32, True): "**One scan", (32, False): "**The building", (None, True): "**The way"}[rings, scans]
    )


def test_until_there_is_a_map_the_odometrys_is_shown():
    for growing in (False, True):
        shown = [view for view in views(run.build(growing=growing).root_container) if entities.TRAJECTORY in view.contents]
        maps = [str(view.name) for view in shown if entities.LOCAL_MAP in view.contents]
        assert maps == (["Odometry's map; the labelled map follows", "From above; the grid map follows"] if growing else [])


def test_the_evaluation_explains_its_colours():
    for evaluated in (True, False):
        for scans in (True, False):
            tabs = {str(tab.name): tab for tab in run.build(evaluated=evaluated, scans=scans).root_container.contents}
            assert entities.ERROR_LEGEND in [str(view.origin) for view in views(tabs["Evaluation"])]


def test_whichever_layout_the_viewer_takes_has_the_evaluation():
    usual, evaluated = (run.build(evaluated=evaluated).root_container for evaluated in (False, True))
    assert sorted(str(tab.name) for tab in usual.contents) == sorted(str(tab.name) for tab in evaluated.contents)
    assert str(evaluated.contents[0].name) == "Evaluation"
    assert str(usual.contents[0].name) == "At a glance"
    own = [list(views(tab)) for layout in (usual, evaluated) for tab in layout.contents if tab.name == "Evaluation"]
    assert {str(view.name) for view in own[0]} - {str(view.name) for view in own[1]} == {"What this needs"}
    assert {str(view.name) for view in own[1]} < {str(view.name) for view in own[0]}
    # A recording alone has no errors: what is shown first says what is missing.
    assert str(own[0][0].origin) == entities.EVALUATION_HELP


def test_curves_whose_peak_would_flatten_others_stand_alone():
    shown = [view for view in views(run.build().root_container) if isinstance(view, rrb.TimeSeriesView)]
    alone = [str(view.origin) for view in shown if str(view.origin) in entities.SERIES]
    for group in (entities.MILLISECONDS, entities.RANGES, entities.REGISTRATION):
        assert sorted(p for p in alone if p.startswith(group)) == sorted(
            p for p in entities.SERIES if p.startswith(group)
        )
    errors = [view.contents for view in shown if str(view.origin) == entities.SCAN_ERRORS]
    assert len(errors) == 3
    # Whatever is drawn has a name in words.
    named = set(entities.SERIES) | {entities.scan_error(verdict) for verdict in Verdict}
    for view in shown:
        if view.contents != "$origin/**":
            assert set(view.contents) <= named
        elif str(view.origin) != entities.LABEL_COUNTS:
            assert str(view.origin) in named


def test_given_poses_have_no_quality_to_show():
    for rings in (32, None):
        tabs = run.build(rings, registered=False).root_container.contents
        names = [str(tab.name) for tab in tabs]
        assert "Trajectory as given" in names
        assert "Odometry" not in names
        origins = {str(view.origin) for tab in tabs for view in views(tab)}
        assert not any(origin.startswith(entities.REGISTRATION) for origin in origins)


def test_cells_of_the_curve_sheet_do_not_touch():
    for rings in (16, 32, 33, 180):
        sheet = CurveSheet(rings)
        cells = sheet.cells
        assert cells.shape == (2 * rings, 2)
        assert len(np.unique(cells, axis=0)) == 2 * rings
        assert cells[:, 0].max() + sheet.cell_width <= sheet.WIDTH + 1e-3
        assert cells[:, 1].min() - sheet.cell_height / 2 >= sheet.EXAMPLE_HEIGHT - 1e-3
        assert cells[:, 1].max() + sheet.cell_height / 2 <= sheet.height + 1e-3
        apart = np.abs(cells[:, None] - cells[None]) >= 0.999 * np.array([sheet.cell_width, sheet.cell_height])
        assert np.all(apart.any(axis=2) | np.eye(2 * rings, dtype=bool))


def test_the_explanation_names_classes_and_settings():
    text = entities.explain({"bag": {"path": "/data/drive.bag"}, "settings": {"wall_planes": {"similarity_m": 0.05}}})
    assert "# drive.bag" in text
    assert "| wall_planes | similarity_m | 0.05 |" in text
    for name, _ in list(entities.CLASSES.values())[:6]:
        assert name in text


def test_where_nothing_is_labelled_the_odometry_comes_first():
    tabs = run.build(None).root_container.contents
    assert [str(tab.name) for tab in tabs] == ["Odometry", "Warnings", "Read me"]
    # Curves of scans that were never labelled would be empty.
    curves = [view for tab in tabs for view in views(tab) if isinstance(view, rrb.TimeSeriesView)]
    assert all(str(view.origin).startswith(entities.REGISTRATION) for view in curves)


@pytest.mark.parametrize("scans", [True, False])
def test_changed_points_are_seen_against_the_scan_or_else_the_map(scans: bool) -> None:
    compared = frozenset({"labels"})
    runs = [compare.ComparedRun(letter, letter, scans, map_points=False, compared=compared) for letter in ("A", "B")]
    layout = compare.build(runs)
    changed = next(view for view in views(layout.root_container) if str(view.name).startswith("This scan"))
    contents = [str(path) for path in changed.contents]
    assert (runs[0].path(entities.POINTS) in contents) == scans
    assert (f"{entities.GRID}/A" in contents) != scans
    # An override of what is not there is an error that the viewer shows.
    assert (runs[0].path(entities.POINTS) in changed.visualizer_overrides) == scans


def test_without_lines_nothing_is_shown_that_is_drawn_from_them():
    layout = run.build(lines=False).root_container
    assert "Step by step" not in [str(tab.name) for tab in layout.contents]
    of_lines = (entities.LINES, entities.CURVES, entities.UPMOST, entities.BOTTOMMOST, entities.STRUCTURES)
    for view in views(layout):
        for path in (str(view.origin), *map(str, [view.contents] if isinstance(view.contents, str) else view.contents)):
            assert not path.startswith(of_lines)
