"""Each layout shows what its recording has, and every view has a name."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import rerun.blueprint as rrb

from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.maps.grid import GridMap
from ffmap.blueprints import compare, inspect, rooms, run
from ffmap.blueprints.entities import POINTS


def views(part: rrb.Container | rrb.View) -> Iterator[rrb.View]:
    if isinstance(part, rrb.View):
        yield part
    else:
        for inner in part.contents:
            yield from views(inner)


def shown(part: rrb.Container | rrb.View) -> set[str]:
    """The queries of all views."""
    found = set()
    for view in views(part):
        whole = view.contents == "$origin/**"
        found |= {str(view.origin)} if whole else {str(path) for path in view.contents}
    return found


def names(root: rrb.Container) -> list[str]:
    return [str(tab.name) for tab in root.contents]


def test_every_view_has_a_name():
    assert all(view.name for view in views(run.build().root_container))
    assert all(view.name for view in views(inspect.build((5.0, 3.0), 7).root_container))


def test_tabs_of_a_run():
    usual = ["At a glance", "Step by step", "Building", "Maps", "Rooms", "Odometry"]
    last = ["Metrics and warnings", "Evaluation", "Read me"]
    assert names(run.build().root_container) == usual + last
    evaluated = names(run.build(evaluated=True).root_container)
    assert evaluated[0] == "Evaluation"
    assert sorted(evaluated) == sorted(usual + last)
    assert "Step by step" not in names(run.build(lines=False).root_container)
    map_only = names(run.build(scans=False).root_container)
    assert map_only[:3] == ["Building", "Maps", "Rooms"]
    assert "Trajectory as given" in names(run.build(registered=False).root_container)
    poses = run.build(labelled=False).root_container
    assert names(poses) == ["Odometry", "Warnings", "Read me"]
    # Views of scans would be empty.
    assert not any(path.startswith("/scan") for path in shown(poses))


def test_the_first_tab_says_what_it_shows():
    for root in (run.build(), run.build(scans=False), run.build(labelled=False)):
        assert "/glance" in shown(root.root_container.contents[0])


def test_without_lines_nothing_of_lines_is_shown():
    of_lines = ("/scan/lines", "/scan/differences", "/scan/candidates", "/scan/structures")
    assert any(path.startswith(of_lines) for path in shown(run.build().root_container))
    layout = run.build(lines=False).root_container
    assert not any(path.startswith(of_lines) for path in shown(layout))


@pytest.mark.parametrize("flag", [True, False])
def test_what_depends_on_the_run(flag: bool) -> None:
    lidars = shown(run.build(several_lidars=flag).root_container)
    assert ("/scan/lidar" in lidars) == flag
    growing = shown(run.build(growing=flag).root_container.contents[0])
    assert ("/world/odometry/local_map" in growing) == flag
    registered = shown(run.build(registered=flag).root_container)
    assert any(path.startswith("/metrics/registration") for path in registered) == flag
    evaluated = shown(run.build(evaluated=flag).root_container)
    assert {"/legend/errors", "/evaluation/figures"} <= evaluated
    assert ("/evaluation/help" in evaluated) != flag


def test_the_view_is_of_all_maps():
    first = GridMap(np.zeros((10, 20), np.uint8), np.array([1.0, 2.0]), 0.1)
    second = GridMap(np.zeros((10, 10), np.uint8), np.array([5.0, 0.0]), 0.1)
    assert run.view_of(first, None, second) == ((3.5, 1.5), 5.0)
    assert run.view_of(None) == ((0.0, 0.0), 20.0)


def test_rooms_have_a_layout_of_their_own_and_those_of_fig_10_beside_them():
    own = shown(rooms.build((3.0, 4.0), 10.0).root_container)
    assert {"/world/rooms/**", "/world/grid/segmented", "/rooms/graph"} <= own
    compared = shown(rooms.tab((3.0, 4.0), 10.0, compared=True))
    others = set(Segmented) - {Segmented.FURNITURE_FREE}
    assert {f"/world/rooms_compared/{name}/**" for name in others} <= compared


def test_a_scan_shows_the_line_its_curve_its_profile_and_why():
    assert {"/scan/differences", "/profile", "/why/line", "/why/scan", "/scan/line/**"} <= shown(
        inspect.build((5.0, 3.0), 7).root_container
    )


def titles(root: rrb.Container) -> list[str]:
    return [str(view.name) for view in views(root)]


def test_a_comparison_shows_what_was_compared_and_no_more():
    first = compare.ComparedRun("A", "A: usual", scans=True, map_points=True)
    parts = frozenset({"labels", "trajectory", "walls", "doors", "grid"})
    other = replace(first, letter="B", title="B: other", compared=parts)
    found = titles(compare.build([first, other], scan=17).root_container)
    words = ("Where labels changed, A → B", "its changed points", "Distance of poses", "lost red")
    for word in words:
        assert any(word in title for title in found)
    bare = [compare.ComparedRun(letter, letter, False, False) for letter in "AB"]
    shown_of_bare = views(compare.build(bare).root_container)
    assert [type(view) for view in shown_of_bare] == [rrb.TextDocumentView] * 2
    labels_only = compare.ComparedRun("B", "B", True, False, frozenset({"labels"}))
    found = titles(compare.build([first, labels_only]).root_container)
    assert not any("Walls, doors" in title or "poses" in title for title in found)


def test_a_comparison_opens_on_what_changed_most_and_its_legends_hide_no_curve():
    parts = frozenset({"labels", "trajectory"})
    runs_shown = [compare.ComparedRun(letter, letter, True, True, parts) for letter in "ABC"]
    tabs = compare.build(runs_shown, most_changed="C").root_container
    assert names(tabs)[tabs.active_tab] == "C against A"
    bare = compare.build(runs_shown).root_container
    assert bare.active_tab == 0
    layout = compare.build(runs_shown, scans=(10, 110)).root_container
    plots, bare_plots = (
        [view for view in views(root) if isinstance(view, rrb.TimeSeriesView)]
        for root in (layout, bare)
    )
    assert len(plots) == 6
    for plot in plots:
        corner = plot.properties["PlotLegend"].corner.as_arrow_array().to_pylist()
        assert corner == [rrb.Corner2D.RightTop.value]
        (axis,) = plot.properties["TimeAxis"].view_range.as_arrow_array().to_pylist()
        assert (axis["start"], axis["end"]) == (10, 150)
    assert all("TimeAxis" not in plot.properties for plot in bare_plots)


@pytest.mark.parametrize("scans", [True, False])
def test_changed_points_are_seen_against_the_scan_or_else_the_map(scans: bool) -> None:
    parts = frozenset({"labels"})
    runs = [compare.ComparedRun(k, k, scans, map_points=False, compared=parts) for k in "AB"]
    found = views(compare.build(runs).root_container)
    changed = next(view for view in found if str(view.name).startswith("This scan"))
    contents = [str(path) for path in changed.contents]
    assert (runs[0].path(POINTS) in contents) == scans
    assert ("/world/grid/A" in contents) != scans
    # An override of what is not there is an error that the viewer shows.
    assert (runs[0].path(POINTS) in changed.visualizer_overrides) == scans
