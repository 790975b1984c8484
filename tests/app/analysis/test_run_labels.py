"""Clouds of two runs meet by their stamps."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.app.analysis.run_labels import CloudLabels, pair


def cloud(stamp_ns: int, topic: str = "/a") -> CloudLabels:
    label = np.array([1, NO_RETURN, 3, 4, NO_RETURN, 0], np.uint8)
    return CloudLabels(stamp_ns // 100, topic, stamp_ns, label, label, None)


@pytest.mark.parametrize(
    ("first", "second", "both", "only_first", "only_second"),
    [
        ([100, 200, 300], [100, 200, 300], [100, 200, 300], [], []),
        ([100, 300, 400], [200, 300, 500], [300], [100, 400], [200, 500]),
        ([100, 200], [100, 150, 160, 200], [100, 200], [], [150, 160]),
        ([], [100], [], [], [100]),
        ([100, 200], [], [], [100, 200], []),
    ],
)
def test_clouds_meet_by_their_stamps(
    first: list[int], second: list[int], both: list[int], only_first: list[int], only_second: list[int]
) -> None:
    found = list(pair(map(cloud, first), map(cloud, second)))
    assert [(a.stamp_ns, b.stamp_ns) for a, b in found if a and b] == [(stamp, stamp) for stamp in both]
    assert [a.stamp_ns for a, b in found if a and not b] == only_first
    assert [b.stamp_ns for a, b in found if b and not a] == only_second


def test_of_two_lidars_that_fire_together_each_meets_its_own() -> None:
    both = [cloud(stamp, topic=topic) for stamp in (100, 200) for topic in ("/a", "/b")]
    found = list(pair(iter(both), iter([cloud(100, topic="/b"), cloud(200, topic="/b"), cloud(300, topic="/b")])))
    told = [(a.topic if a else None, b.topic if b else None) for a, b in found]
    assert told == [("/a", None), ("/b", "/b"), ("/a", None), ("/b", "/b"), (None, "/b")]
