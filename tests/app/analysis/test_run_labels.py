"""Clouds of two runs meet by their stamps, and their points by their place."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.app.analysis.run_labels import CloudLabels, pair


def cloud(stamp_ns: int, every_place: bool = True, topic: str = "/a") -> CloudLabels:
    label = np.array([1, NO_RETURN, 3, 4, NO_RETURN, 0], np.uint8)
    if not every_place:
        label = label[label != NO_RETURN]
    points = np.arange(3.0 * len(label)).reshape(-1, 3)
    return CloudLabels(stamp_ns // 100, topic, stamp_ns, label, label, points, every_place)


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


def test_a_recordings_rows_are_the_labelled_bags_without_its_empty_places() -> None:
    ((a, b),) = pair(iter([cloud(100)]), iter([cloud(100, every_place=False)]))
    assert a is not None
    assert b is not None
    assert a.label_scan.tolist() == b.label_scan.tolist() == [1, 3, 4, 0]
    assert a.points_map is not None
    assert a.points_map[:, 0].tolist() == [0.0, 6.0, 9.0, 15.0]
    # Where both have every place, nothing is left out.
    ((a, b),) = pair(iter([cloud(100)]), iter([cloud(100)]))
    assert a is not None
    assert len(a.label_scan) == 6
