"""Means and medians of finite values."""

import numpy as np
import pytest

from ffmap.algorithms.base.known import mean_known, median_known, row_means, row_medians

NAN = float("nan")
ROWS = np.array(
    [[1.0, 2.0, 9.0, 4.0], [5.0, NAN, NAN, NAN], [1.0, 3.0, NAN, NAN], [NAN, NAN, NAN, NAN]]
)


@pytest.mark.parametrize(
    ("known_min", "rows"), [(0.0, [0, 1, 2]), (0.25, [0, 1, 2]), (0.3, [0, 2]), (0.6, [0])]
)
def test_rows_with_too_few_finite_values_are_nan(known_min: float, rows: list[int]) -> None:
    known = np.isin(np.arange(4), rows)
    for of, expected in ((row_means, [4.0, 5.0, 2.0, NAN]), (row_medians, [3.0, 5.0, 2.0, NAN])):
        np.testing.assert_array_equal(of(ROWS, known_min), np.where(known, expected, NAN))


def test_only_finite_values_count() -> None:
    assert (mean_known(ROWS[2]), median_known(ROWS[0])) == (2.0, 3.0)
    assert np.isnan([mean_known(ROWS[3]), median_known(ROWS[3]), mean_known(np.zeros(0))]).all()
    assert row_means(np.zeros((0, 4))).shape == (0,)
    np.testing.assert_array_equal(row_medians(np.zeros((2, 0))), [NAN, NAN])
