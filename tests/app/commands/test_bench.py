"""The bench: what it measures is not helped by an earlier run."""

import os
from pathlib import Path

import pytest

from ffmap.app.commands import bench as bench_command
from ffmap.app.run.odometry_cache import CACHE_VARIABLE, cache_folder


@pytest.mark.parametrize("named", [True, False])
def test_odometries_come_from_no_earlier_run(named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if named:
        monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "mine"))
    else:
        monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    usual, environment = cache_folder(), dict(os.environ)
    asked: list[Path] = []
    monkeypatch.setattr(bench_command, "_bench_run", lambda *_: asked.append(cache_folder()))
    monkeypatch.setattr(bench_command, "_bench_labelling", lambda *_: asked.append(cache_folder()))

    bench_command.bench(tmp_path / "drive.bag", 60.0)

    assert len(set(asked)) == 1
    assert len(asked) == 2, "the labelling takes the odometry that the run has left"
    assert asked[0] != usual
    assert not asked[0].exists()
    assert dict(os.environ) == environment
