"""A sweep: quality against time with the front, each figure against each parameter, the table, the run at the cursor."""

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb

from ffmap.blueprints import entities
from ffmap.blueprints.entities import Panel
from ffmap.blueprints.views import layout, opening_at


def build(panels: Mapping[str, Sequence[tuple[str, str]]], front: str, best: int) -> rrb.Blueprint:
    """The layout of a sweep's recording. panels: for each parameter its panels' entity paths and what they show. front:
    what the Pareto panel shows. best: the run to open at.
    """
    rows = [
        rrb.Horizontal(*(_panel(path, title) for path, title in shown), name=parameter)
        for parameter, shown in panels.items()
    ]
    overview = rrb.Horizontal(
        rrb.Vertical(_panel(entities.SWEEP_FRONT, front), rrb.Grid(*_firsts(panels)), row_shares=[3, 2]),
        _run_at_cursor(),
        column_shares=[3, 1],
        name="Which settings are worth it",
    )
    parameters = rrb.Horizontal(
        rrb.Vertical(*rows), _run_at_cursor(), column_shares=[4, 1], name="Every figure against every parameter"
    )
    table = rrb.TextDocumentView(origin=entities.SWEEP_TABLE, name="All runs, best first")
    return layout(rrb.Tabs(overview, parameters, table, active_tab=0), opening_at(entities.RUN_TIMELINE, best))


def _run_at_cursor() -> rrb.TextDocumentView:
    return rrb.TextDocumentView(origin=entities.SWEEP_RUN, name="The run at the cursor (timeline run)")


def _firsts(panels: Mapping[str, Sequence[tuple[str, str]]]) -> list[rrb.Spatial2DView]:
    """The objective against each parameter."""
    return [_panel(*shown[0]) for shown in panels.values()]


def _panel(path: str, title: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=path,
        name=title,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-Panel.MARGIN_LEFT, Panel.WIDTH + Panel.MARGIN_RIGHT],
            y_range=[-Panel.MARGIN_TOP, Panel.HEIGHT + Panel.MARGIN_BOTTOM],
        ),
    )
