"""A few labelled scans, and a recording of them."""

from pathlib import Path

import pytest

from ffmap.algorithms.scan.labelling import label_scan
from tests import synthetic
from tests.app.record.recordings import SCANS, Labelled, write_run


@pytest.fixture(scope="module")
def labelled() -> list[Labelled]:
    trajectory = synthetic.trajectory(SCANS)
    scans = [synthetic.scan(index) for index in range(SCANS)]
    levels = [synthetic.level(scan, trajectory) for scan in scans]
    return [
        (scan, level, label_scan(scan, level.placed, synthetic.settings(), index))
        for index, (scan, level) in enumerate(zip(scans, levels, strict=True))
    ]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, labelled: list[Labelled]) -> Path:
    return write_run(tmp_path_factory.mktemp("run"), labelled)
