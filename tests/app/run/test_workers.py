"""Killed processes are reported in one line, and no worker outlives its run."""

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.program import FFMAP, with_cache

WAIT_S = 120.0


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

    def wait_for_workers(self) -> list[psutil.Process]:
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
def test_killed_worker_is_one_line_that_names_memory_and_how_to_go_on(
    small_bag: Path, tmp_path: Path
) -> None:
    running = Running(small_bag, tmp_path / "run", tmp_path / "cache")
    running.wait_for_workers()[0].kill()
    said = running.process.communicate(timeout=WAIT_S)[1].splitlines()
    assert running.process.returncode == 2
    assert said[-1].startswith("ffmap: a worker process was killed"), said
    assert "memory" in said[-1]
    assert said[-1].endswith(f"'ffmap run --resume {running.out}' continues the run")
    assert not any("Traceback" in line for line in said)


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes by their session")
def test_no_process_outlives_a_run_that_is_killed(small_bag: Path, tmp_path: Path) -> None:
    running = Running(small_bag, tmp_path / "run", tmp_path / "cache")
    running.wait_for_workers()
    running.process.kill()
    running.process.wait()
    end = time.monotonic() + WAIT_S
    while running.all() and time.monotonic() < end:
        time.sleep(0.05)
    assert running.all() == set()
