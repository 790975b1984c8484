"""Options of a run: what --outputs names, and what run.json has kept of them."""

import pytest

from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import RUN_OUTPUTS, Output, parse_outputs
from ffmap.loaders.errors import InputError


def test_outputs_are_those_that_are_named_or_those_too() -> None:
    assert parse_outputs(None, RUN_OUTPUTS) == RUN_OUTPUTS
    assert parse_outputs("maps, labels,maps", RUN_OUTPUTS) == (Output.LABELS, Output.MAPS)
    assert set(parse_outputs("+labelled-bag", RUN_OUTPUTS)) == set(Output)
    assert parse_outputs("+labels,cloud", (Output.MAPS,)) == (
        Output.LABELS,
        Output.CLOUD,
        Output.MAPS,
    )
    for wrong in ("labelled", "+labelled", "+", "", "maps,+cloud"):
        with pytest.raises(InputError, match="there is no output"):
            parse_outputs(wrong, RUN_OUTPUTS)


def test_a_run_that_is_resumed_has_what_was_kept_and_what_is_given_now() -> None:
    begun = RunOptions(horizontal="/up", detail="map", workers=7, quiet=True)
    again = begun.with_digests().resumed_with(RunOptions(workers=3))
    assert (again.horizontal, again.detail) == ("/up", "map")
    assert (again.workers, again.quiet) == (3, False)
