"""Where a layout opens on a timeline of numbers."""

import rerun.blueprint as rrb


def time_panel(timeline: str, at: int | None) -> rrb.TimePanel:
    """A timeline of numbers that opens at its start, or at one of them.

    A layout cannot place the time cursor; it can play a selection, and one of a single number stays there.
    """
    if at is None:
        return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="paused")
    return rrb.TimePanel(
        state="collapsed",
        timeline=timeline,
        play_state="playing",
        loop_mode="selection",
        time_selection=rrb.components.AbsoluteTimeRange(at, at),
    )
