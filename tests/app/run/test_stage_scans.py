"""What a run says of its scans."""

import numpy as np
import pytest

from ffmap.app.run.stage_scans import ranges


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ([4], "4"),
        ([0, 1, 2, 7, 9, 10], "0 to 2, 7, 9 to 10"),
        (range(0, 20, 2), "0, 2, 4, 6, 8, ..."),
    ],
)
def test_scans_are_named_by_ranges(numbers: range, text: str) -> None:
    assert ranges(np.array(numbers)) == text
