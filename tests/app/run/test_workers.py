"""Processes that are killed: one line says so, nobody waits for ever, and no worker outlives its run."""

import multiprocessing as mp
import os
import pickle  # noqa: TID251 - of objects that the test made
import signal
import subprocess
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

import psutil
import pytest

from ffmap.app.run import odometry as odometry_stage
from ffmap.app.run.odometry import Odometry
from ffmap.app.run.workers import WorkerLostError
from ffmap.app.setup.inputs import find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import FFMAP, with_cache

WAIT_S = 120.0


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "duration_s": 4.0}
    simulate(path, SimulationSettings.model_validate(values))
    return path


class Running:
    """`ffmap run` as a user starts it, and the processes that it has started."""

    def __init__(self, bag: Path, out: Path, cache: Path) -> None:
        self.out = out
        self.process = subprocess.Popen(
            [*FFMAP, "run", str(bag), "--out", str(out), "--workers", "2", "--no-evaluate"],
            env=with_cache(cache),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def all(self) -> set[psutil.Process]:
        return {p for p in psutil.process_iter() if _is_alive_in(p, self.process.pid)}

    def workers(self) -> list[psutil.Process]:
        """What the workers' server has forked."""
        try:
            own = psutil.Process(self.process.pid).children()
            return [worker for server in own for worker in server.children()]
        except psutil.NoSuchProcess:
            return []

    def wait_for_workers(self, stage_done: str | None) -> list[psutil.Process]:
        """stage_done: the stage whose end was told before; None for the first."""
        assert self.process.stderr is not None
        line = ""
        while stage_done is not None and not line.startswith(stage_done):
            line = self.process.stderr.readline()
            assert line, "ended early"
        end = time.monotonic() + WAIT_S
        while not self.workers() and time.monotonic() < end:
            time.sleep(0.01)
        return self.workers()


def _is_alive_in(process: psutil.Process, session: int) -> bool:
    try:
        return os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE
    except (ProcessLookupError, psutil.NoSuchProcess):
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes by their session")
@pytest.mark.parametrize(("what", "stage_done"), [("the odometry's process", None), ("a worker process", "odometry:")])
def test_killed_worker_is_one_line_that_names_memory_and_how_to_go_on(
    what: str, stage_done: str | None, bag: Path, tmp_path: Path
) -> None:
    running = Running(bag, tmp_path / "run", tmp_path / "cache")
    running.wait_for_workers(stage_done)[0].kill()
    said = running.process.communicate(timeout=WAIT_S)[1].splitlines()
    assert running.process.returncode == 2
    assert said[-1].startswith(f"ffmap: {what}"), said
    assert "memory" in said[-1]
    assert said[-1].endswith(f"'ffmap run --resume {running.out}' goes on with the run")
    assert not any("Traceback" in line for line in said)


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes by their session")
@pytest.mark.parametrize("stage_done", [None, "odometry:"])
def test_no_process_outlives_a_run_that_is_killed(stage_done: str | None, bag: Path, tmp_path: Path) -> None:
    running = Running(bag, tmp_path / "run", tmp_path / "cache")
    running.wait_for_workers(stage_done)
    running.process.kill()
    running.process.wait()
    end = time.monotonic() + WAIT_S
    while running.all() and time.monotonic() < end:
        time.sleep(0.05)
    assert running.all() == set()


def _die_in_the_middle_of_a_message(*arguments: object) -> None:
    connection = arguments[-1]
    assert isinstance(connection, Connection)
    message = pickle.dumps(bytes(100_000))
    os.write(connection.fileno(), len(message).to_bytes(4, "big") + message[:1000])
    os.kill(os.getpid(), signal.SIGKILL)


def _meet_a_damaged_file(*arguments: object) -> None:
    connection = arguments[-1]
    assert isinstance(connection, Connection)
    connection.send(InputError("drive.bag: the file is damaged; repair it"))


@pytest.mark.skipif(sys.platform == "win32", reason="forks")
@pytest.mark.parametrize(
    ("process", "error", "text"),
    [
        (_die_in_the_middle_of_a_message, WorkerLostError, r"killed \(SIGKILL\).*memory"),
        (_meet_a_damaged_file, InputError, "^drive.bag: the file is damaged; repair it$"),
    ],
)
def test_odometry_that_ends_early_says_why(
    process, error: type[Exception], text: str, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FFMAP_CACHE", str(tmp_path))
    monkeypatch.setattr(odometry_stage, "_odometry_process", process)
    monkeypatch.setattr(odometry_stage, "process_context", lambda: mp.get_context("fork"))
    inputs = find_inputs(bag, RunOptions())
    assert inputs.horizontal is not None
    with pytest.raises(error, match=text):
        list(Odometry(inputs, inputs.horizontal, Settings()))
    assert not any((tmp_path / "odometry").iterdir())


def test_server_that_still_imports_ends_when_its_run_has_gone() -> None:
    load = "import threading; from ffmap.app.run.worker_server import _end_with"
    command = f"{load}; _end_with(-1, threading.Event()); print('is there')"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=False, timeout=WAIT_S)
    assert done.returncode == 1
    assert "is there" not in done.stdout
