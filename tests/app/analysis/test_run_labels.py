"""Clouds of two runs meet by their stamps, and their points by their place."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.app.analysis.run_labels import CloudLabels, pair


def cloud(stamp_ns: int, every_place: bool = True) -> CloudLabels:
    label = np.array([1, NO_RETURN, 3, 4, NO_RETURN, 0], np.uint8)
    if not every_place:
        label = label[label != NO_RETURN]
    points = np.arange(3.0 * len(label)).reshape(-1, 3)
    return CloudLabels(stamp_ns // 100, stamp_ns, label, label, points, every_place)


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
    assert [p.a.stamp_ns for p in found if p.a and p.b] == both
    assert [p.a.stamp_ns for p in found if p.a and not p.b] == only_first
    assert [p.b.stamp_ns for p in found if p.b and not p.a] == only_second
    for met in found:
        assert met.same_cloud == (met.a is not None and met.b is not None)
        if met.a and met.b:
            assert met.a.stamp_ns == met.b.stamp_ns


def test_a_recordings_rows_are_the_labelled_bags_without_its_empty_places() -> None:
    (met,) = pair(iter([cloud(100)]), iter([cloud(100, every_place=False)]))
    assert met.same_cloud
    assert met.a is not None
    assert met.b is not None
    assert met.a.label_scan.tolist() == met.b.label_scan.tolist() == [1, 3, 4, 0]
    assert met.a.points_map is not None
    assert met.a.points_map[:, 0].tolist() == [0.0, 6.0, 9.0, 15.0]
    # Where both have every place, nothing is left out.
    (met,) = pair(iter([cloud(100)]), iter([cloud(100)]))
    assert met.a is not None
    assert len(met.a.label_scan) == 6
