"""How worker processes are made."""

import multiprocessing as mp
import signal
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import forkserver
from multiprocessing.context import ForkServerContext, SpawnContext
from types import TracebackType
from typing import Any, TypeVar

_T = TypeVar("_T")

ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(64 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(256 << 20),
}
"""What numpy and the C library read when they start.

One thread for each process's linear algebra, for the processes themselves fill the cores; and freed memory is kept
rather than given back, for every cloud asks for the same again.
"""


def process_context() -> ForkServerContext | SpawnContext:
    """Workers fork from a server that has loaded what they need, where the system can: that takes two seconds each.

    Nothing forks from the run's own process, whose threads a fork would not survive.
    """
    if sys.platform != "linux":
        return mp.get_context("spawn")
    context = mp.get_context("forkserver")
    context.set_forkserver_preload(["app.worker_server", "algorithms.odometry", "app.warm_up"])
    return context


def start_server() -> None:
    """Let the workers' server import what it needs while this process still imports what itself needs."""
    if isinstance(process_context(), ForkServerContext):
        forkserver.ensure_running()


def make_pool(workers: int) -> Executor:
    """Processes that take jobs; a single worker is this process itself, so that the whole run is one thread's work."""
    return _InTurn() if workers == 1 else _Processes(workers, process_context(), leave_interrupts_to_the_run)


def leave_interrupts_to_the_run() -> None:
    """Called by a worker process as it starts: Ctrl-C reaches all processes of a terminal, and the run ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class _Processes(ProcessPoolExecutor):
    """Nobody waits for what its workers are at when the user interrupts: every file that they write is whole or not there."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if kind is not None and issubclass(kind, KeyboardInterrupt):
            self.shutdown(wait=False, cancel_futures=True)
            for process in mp.active_children():
                process.terminate()
        super().__exit__(kind, error, tb)


class _InTurn(Executor):
    """Does each job when its result is asked for."""

    def submit(self, fn: Callable[..., _T], /, *args: Any, **kwargs: Any) -> Future[_T]:  # noqa: ANN401
        return _Deferred(lambda: fn(*args, **kwargs))


class _Deferred(Future[_T]):
    """`done` from the start, for whoever asks waits for nobody else."""

    def __init__(self, job: Callable[[], _T]) -> None:
        super().__init__()
        self._job: Callable[[], _T] | None = job

    def done(self) -> bool:
        return True

    def result(self, timeout: float | None = None) -> _T:
        if self._job is not None:
            job, self._job = self._job, None
            self.set_result(job())
        return super().result(timeout)
