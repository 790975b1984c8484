"""Legends: a strip above what they explain."""

import rerun.blueprint as rrb

from ffmap.blueprints.entities import Legend


def above(legend: rrb.View | rrb.Container, content: rrb.View | rrb.Container, name: str) -> rrb.Container:
    """A tab with a strip above it."""
    return rrb.Vertical(legend, content, row_shares=[1, 12], name=name)


def view(origin: str, entries: int, name: str) -> rrb.Spatial2DView:
    """The strip itself; entries: how many names `origin` has."""
    return rrb.Spatial2DView(
        origin=origin,
        name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=[0, entries * Legend.STEP], y_range=[-Legend.ABOVE, Legend.BELOW]),
    )
