"""Clouds of two runs are paired by their time stamps and topics."""

import numpy as np
import pytest

from ffmap.app.analysis.run_labels import PlacedLabels, side_by_side
from ffmap.app.folder.labels_file import ScanLabels

Clouds = list[tuple[int, str]]


def clouds(keys: Clouds) -> list[PlacedLabels]:
    label = np.zeros(6, np.uint8)
    return [(ScanLabels(stamp // 100, topic, stamp, label, label), None) for stamp, topic in keys]


A1, A2, A3, A4 = [(100 * k, "/a") for k in range(1, 5)]
B1, B2, B3 = [(100 * k, "/b") for k in range(1, 4)]


@pytest.mark.parametrize(
    ("first", "second", "both"),
    [
        ([A1, A2, A3], [A1, A2, A3], [A1, A2, A3]),
        ([A1, A3, A4], [A2, A3], [A3]),
        ([A1, A2], [A1, (150, "/a"), A2], [A1, A2]),
        ([], [A1], []),
        ([A1, A2], [], []),
        ([A1, B1, A2, B2], [B1, B2, B3], [B1, B2]),  # lidars that fire together
    ],
)
def test_clouds_are_paired(first: Clouds, second: Clouds, both: Clouds) -> None:
    found = list(side_by_side(iter(clouds(first)), iter(clouds(second))))
    keys = [tuple(own and (own[0].stamp_ns, own[0].topic) for own in pair) for pair in found]
    assert [a for a, b in keys if a is not None and b is not None] == both
    assert all(a == b for a, b in keys if a is not None and b is not None)
    assert [a for a, _ in keys if a is not None] == first
    assert [b for _, b in keys if b is not None] == second
