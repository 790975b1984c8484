"""What a run says of the parts of a drive that it could not join."""

import numpy as np

from ffmap.app.run.odometry import unjoined_parts

PERIOD_NS = 100_000_000
CLOUDS_NS = 5_000_000_000 + np.array([*range(10), *range(30, 50)]) * PERIOD_NS


def parts(numbers: list[int], doubts: list[tuple[int, str]]) -> list[str]:
    return unjoined_parts(
        [int(CLOUDS_NS[n]) for n in numbers], numbers, doubts, CLOUDS_NS, 2.5 * PERIOD_NS
    )


def test_a_gap_alone_is_no_unjoined_part() -> None:
    assert parts([*range(30)], []) == []
    assert parts([n for n in range(30) if n not in (4, 12)], []) == []


def test_what_was_left_out_is_named_with_its_time() -> None:
    (line,) = parts([*range(10), *range(20, 30)], [])
    assert line.startswith(
        "the 3.1 s after 0.9 s (10 scans) could not be joined to the map and are left out"
    )
    (line,) = parts([*range(10)], [])
    assert line.startswith(
        "the 4.0 s after 0.9 s (20 scans) could not be joined to the map and are left out"
    )


def test_what_may_be_at_a_wrong_place_is_named_with_its_time_and_why() -> None:
    (line,) = parts([*range(30)], [(10, "it is dark")])
    assert line == (
        "the 4.0 s after 0.9 s (20 scans) could not be joined to the map for certain, and may be "
        "at a wrong place: it is dark"
    )
