import pytest

from ffmap.algorithms.base.scan import Scan
from tests.box_drive import PERIOD_NS, T_BASE_VERTICAL, sweep


@pytest.fixture(scope="session")
def scans() -> list[tuple[int, Scan, Scan | None]]:
    """40 scans of either lidar; the vertical one turns half a sweep later."""
    vertical = [sweep(i, T_BASE_VERTICAL, 2, PERIOD_NS // 2) for i in range(40)]
    return [(i, sweep(i), vertical[i - 1] if i else None) for i in range(40)]
