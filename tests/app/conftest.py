"""A short drive, a run of it, and a Dask cluster."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import ffmap_here, with_cache


@pytest.fixture(scope="session")
def small_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 5 s; its folder has the cache of the runs that share their odometry."""
    path = tmp_path_factory.mktemp("small") / "drive.bag"
    simulate(path, SimulationSettings(building="small", seed=3, sensor="vlp16", duration_s=5.0))
    return path


@pytest.fixture(scope="session")
def small_run(small_bag: Path) -> Path:
    """A run of that drive by two workers, without evaluation."""
    out = small_bag.parent / "run"
    environment = with_cache(small_bag.parent / "cache")
    done = ffmap_here(environment, "run", small_bag, "--out", out, "--no-evaluate")
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler with two workers, started from the command line."""
    pytest.importorskip("distributed")
    scheduler_file = tmp_path_factory.mktemp("cluster") / "scheduler.json"
    dask = Path(sys.executable).parent / "dask"
    paths = [str(Path.cwd()), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    commands = (
        [
            "scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            scheduler_file,
        ],
        [
            "worker",
            "--scheduler-file",
            scheduler_file,
            "--nthreads",
            "1",
            "--nworkers",
            "2",
            "--no-dashboard",
        ],
    )
    started = [
        subprocess.Popen(
            [str(dask), *map(str, command)],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        for command in commands
    ]
    try:
        end = time.monotonic() + 60
        while not scheduler_file.exists() and time.monotonic() < end:
            time.sleep(0.1)
        yield json.loads(scheduler_file.read_text())["address"]
    finally:
        for process in started:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
