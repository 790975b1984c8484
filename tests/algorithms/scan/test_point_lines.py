"""The point lines of an analytic corridor (eq. 1)."""

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.scan.point_lines import SAMPLES, make_point_lines
from tests.corridor import T_BASE_SENSOR, labelled
from tests.synthetic import scan_of


def test_point_lines_have_exactly_200_returns_from_below_upwards() -> None:
    scan, _, _, found = labelled()
    lines = found.lines
    assert lines.samples.shape == (64, SAMPLES)
    assert sorted(lines.order.tolist()) == list(range(len(scan)))
    # Eq. 1, unfolded: the angle about the spin axis from straight down, in single precision.
    down = transforms.invert(T_BASE_SENSOR)[:3, :3] @ np.array([0.0, 0.0, -1.0])
    radial = scan.points_sensor[:, :2] / np.linalg.norm(scan.points_sensor[:, :2], axis=1)[:, None]
    angle_rad = np.arccos(np.clip(radial @ down[:2], -1, 1))
    for line in range(64):
        own = lines.order[lines.starts[line] : lines.starts[line + 1]]
        assert np.all(scan.ring[own] == line // 2)
        assert np.all(np.diff(angle_rad[own]) > -1e-3)
    full = lines.samples[lines.samples[:, 0] >= 0]
    assert np.all(np.diff(angle_rad[full], axis=1) > -1e-3)
    is_horizontal = np.isin(found.label[full], [Label.FLOOR, Label.CEILING])
    assert not np.any(is_horizontal & (found.plane[full] < 0))


@pytest.mark.parametrize(("tilt_deg", "has_lines"), [(0.0, False), (14.9, False), (15.1, True)])
def test_an_upright_spin_axis_has_no_lines_of_emitters(tilt_deg: float, has_lines: bool) -> None:
    scan, _, _, _ = labelled()
    down = np.array([np.sin(np.radians(tilt_deg)), 0.0, -np.cos(np.radians(tilt_deg))])
    inputs = scan, down, np.zeros(len(scan), bool)
    if has_lines:
        assert len(make_point_lines(*inputs).order) == len(scan)
    else:
        with pytest.raises(ValueError, match="upright"):
            make_point_lines(*inputs)


@pytest.mark.parametrize("down_deg", [-180.0, -179.0, -90.0, -0.01, 0.0, 30.0, 179.0, 180.0])
def test_a_ring_is_cut_at_straight_down_and_straight_up(down_deg: float) -> None:
    """Three rings: a whole turn, one within a half turn, one without returns."""
    random = np.random.default_rng(7)
    half = np.linspace(40.0, 50.0, 30) + down_deg
    azimuth_deg = np.concatenate([random.permutation(360) - 179.75, half])
    azimuth_rad = np.radians(azimuth_deg)
    points = np.column_stack([np.cos(azimuth_rad), np.sin(azimuth_rad), np.zeros(390)])
    scan = scan_of(points, np.repeat([0, 2], [360, 30]), 3)
    down = np.array([np.cos(np.radians(down_deg)), np.sin(np.radians(down_deg)), 0.0])
    lines = make_point_lines(scan, down, np.zeros(len(scan), bool))
    from_down_deg = (azimuth_deg - down_deg + 180.0) % 360.0 - 180.0
    for ring, rows in ((0, np.arange(360)), (1, np.arange(0)), (2, np.arange(360, 390))):
        for side, sign in ((0, 1.0), (1, -1.0)):
            line = 2 * ring + side
            own = rows[sign * from_down_deg[rows] > 0.0]
            expected = own[np.argsort(np.abs(from_down_deg[own]))]
            found = lines.order[lines.starts[line] : lines.starts[line + 1]]
            np.testing.assert_array_equal(found, expected)
