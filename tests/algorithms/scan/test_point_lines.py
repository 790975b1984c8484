"""The point lines of an analytic corridor (eq. 1)."""

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.scan.point_lines import SAMPLES, PointLines, make_point_lines
from tests.corridor import METHOD, T_BASE_SENSOR, labelled


def test_point_lines_have_exactly_200_returns_from_below_upwards() -> None:
    scan, _placed, _, found = labelled()
    lines = found.lines
    assert lines.samples.shape == (64, SAMPLES)
    assert sorted(lines.order.tolist()) == list(range(len(scan)))
    # Eq. 1, unfolded: the angle about the spin axis from straight down, to what single precision leaves of it.
    down = transforms.invert(T_BASE_SENSOR)[:3, :3] @ np.array([0.0, 0.0, -1.0])
    radial = scan.points_sensor[:, :2] / np.linalg.norm(scan.points_sensor[:, :2], axis=1, keepdims=True)
    angle_rad = np.arccos(np.clip(radial @ down[:2], -1, 1))
    for line in range(64):
        own = lines.order[lines.starts[line] : lines.starts[line + 1]]
        assert np.all(scan.ring[own] == line // 2)
        assert np.all(np.diff(angle_rad[own]) > -1e-3)
    full = lines.samples[lines.samples[:, 0] >= 0]
    assert np.all(np.diff(angle_rad[full], axis=1) > -1e-3)
    assert not np.any(np.isin(found.label[full], [Label.FLOOR, Label.CEILING]) & (found.plane[full] < 0))


def test_of_an_upright_spin_axis_no_emitter_has_lines() -> None:
    scan, _, _, _ = labelled()

    def lines(tilt_deg: float) -> PointLines:
        down = np.array([np.sin(np.radians(tilt_deg)), 0.0, -np.cos(np.radians(tilt_deg))])
        return make_point_lines(
            scan.points_sensor, scan.ring, 32, down, np.zeros(len(scan), bool), METHOD.rearrangement
        )

    for tilt_deg in (0.0, 15.0 - 0.1):
        with pytest.raises(ValueError, match="upright"):
            lines(tilt_deg)
    assert len(lines(15.0 + 0.1).order) == len(scan)
