"""A sweep's layout: every view says what it shows, and stands in one place only."""

from collections.abc import Iterator

import rerun.blueprint as rrb

from ffmap.blueprints import entities, sweep

PANELS = {
    "similarity_m": [("/sweep/parameters/a/wall_f1", "wall_f1 against a"), ("/sweep/parameters/a/seconds", "seconds")],
    "lines_min": [("/sweep/parameters/b/wall_f1", "wall_f1 against b"), ("/sweep/parameters/b/seconds", "seconds")],
}


def views(part: rrb.Container | rrb.View) -> Iterator[rrb.View]:
    if isinstance(part, rrb.View):
        yield part
    else:
        for inner in part.contents:
            yield from views(inner)


def test_views() -> None:
    tabs = sweep.build(PANELS, "wall_f1 against seconds", best=3).root_container.contents
    shown = [view for tab in tabs for view in views(tab)]
    assert all(view.name for view in shown)
    # The viewer refuses a view that has two parents.
    assert len({view.id for view in shown}) == len(shown)
    first = [str(view.origin) for view in views(tabs[0])]
    assert first[0] == entities.SWEEP_FRONT
    assert [origin for origin in first if "wall_f1" in origin] == [shown[0][0] for shown in PANELS.values()]
    second = {str(view.origin) for view in views(tabs[1])}
    assert {path for panels in PANELS.values() for path, _ in panels} <= second
    assert str(tabs[2].origin) == entities.SWEEP_TABLE
