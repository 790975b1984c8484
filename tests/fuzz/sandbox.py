"""Commands in a process of their own: a crash, a hang or full memory is a failure."""

import faulthandler
import multiprocessing
import os
import resource
import signal
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import psutil

from ffmap.loaders.errors import InputError
from tests.program import ffmap_here

_PROCESSOR_S = 10
_WALL_S = 120
"""For commands that take no processor time, such as reading a pipe that has no writer."""
_MEMORY_MAX = 2 << 30
_NO_MEMORY = ("Unable to allocate", "bad_alloc", "out of memory")
_LINE_MAX = 2000
_CASES = 500
"""Of a process: libraries keep some memory of each case."""


class Sandbox:
    """Runs commands in a process, with a new one after a crash. folder: for files of one case."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._pool = self._start()

    def ffmap(self, *words: object) -> None:
        """Raise unless `ffmap WORDS` succeeds, or fails with one line and exit code 2."""
        self.run(_ffmap, *map(str, words))

    def run(self, function: Callable[..., object], *arguments: object) -> None:
        """Raise unless a function returns, or raises an InputError of one line."""
        try:
            self._pool.submit(_attempt, function, arguments).result()
        except BrokenProcessPool:
            self._pool = self._start()
            raise

    def close(self) -> None:
        self._pool.shutdown()

    def _start(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, context, _limit, max_tasks_per_child=_CASES)


def _limit() -> None:
    """Limit the memory beyond that of libraries, which reserve much and use little.

    Out of time, the process prints where it is, and ends.
    """
    from tests.fuzz import reading  # noqa: F401

    most = psutil.Process().memory_info().data + 2 * _MEMORY_MAX
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    for out_of_time in (signal.SIGPROF, signal.SIGALRM):
        faulthandler.register(out_of_time, chain=True)


def _attempt(function: Callable[..., object], arguments: tuple[object, ...]) -> None:
    signal.setitimer(signal.ITIMER_PROF, _PROCESSOR_S)
    signal.alarm(_WALL_S)
    try:
        function(*arguments)
    except InputError as error:
        _check(str(error))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
    used = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert used < _MEMORY_MAX, f"{used:,} bytes of memory were used"


def _ffmap(*words: str) -> None:
    done = ffmap_here(dict(os.environ), *words)
    if done.returncode:
        assert done.returncode == 2
        *_, last = done.stderr.splitlines()
        assert last.startswith("ffmap: ")
        _check(last)


def _check(line: str) -> None:
    assert len(line) < _LINE_MAX
    assert not any(words in line for words in _NO_MEMORY), line
