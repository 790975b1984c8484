"""How worker processes are made."""

import atexit
import multiprocessing as mp
import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import connection, forkserver
from multiprocessing.context import ForkServerContext, SpawnContext
from types import TracebackType
from typing import Any, Self, TypeVar

from ffmap.loaders.errors import InputError

_T = TypeVar("_T")


class WorkerLostError(InputError):
    """A worker process was ended from outside; mostly by the system, when memory runs out."""

    @classmethod
    def of(cls, what: str, exit_code: int | None = None) -> Self:
        """what: the process, as the subject of a sentence. exit_code: as multiprocessing tells it, where it is known."""
        how = (
            f"was killed ({signal.Signals(-exit_code).name})"
            if exit_code is not None and exit_code < 0
            else "has ended"
        )
        return cls(
            f"{what} {how} before its work was done, most likely because memory ran out; free some, or give fewer --workers"
        )


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
    context.set_forkserver_preload(["ffmap.app.run.worker_server"])
    return context


def start_server() -> None:
    """Let the workers' server import what it needs while this process still imports what itself needs."""
    if isinstance(process_context(), ForkServerContext):
        forkserver.ensure_running()
        atexit.register(_end_server)


def _end_server() -> None:
    """Not when it has imported all: until then it would hold what this process writes to, and whoever reads that would wait."""
    server = getattr(forkserver, "_forkserver", None)
    if (pid := getattr(server, "_forkserver_pid", None)) is not None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def make_pool(workers: int) -> Executor:
    """Processes that take jobs; a single worker is this process itself, so that the whole run is one thread's work."""
    return _InTurn() if workers == 1 else _Processes(workers, process_context(), start_as_worker)


def start_as_worker() -> None:
    """Called by a worker process as it starts.

    Ctrl-C reaches all processes of a terminal, and the run ends the others. A run that is killed ends nobody: its workers
    see to that themselves.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_run, daemon=True).start()


def _end_with_the_run() -> None:
    parent = mp.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)


class _Processes(ProcessPoolExecutor):
    """Nobody waits for what its workers are at when the user interrupts, or when one of them was killed.

    Every file that they write is whole or not there. Raises WorkerLostError, at its end, where one was killed.
    """

    def __enter__(self) -> Self:
        # Kept here, for the pool forgets it as soon as it is told to shut down.
        self._jobs_reader = getattr(getattr(self, "_call_queue", None), "_reader", None)
        return super().__enter__()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if isinstance(error, KeyboardInterrupt | BrokenProcessPool):
            self.shutdown(wait=False, cancel_futures=True)
            # All of them: the pool itself forgets one that it was starting when another was killed, and waits for it for ever.
            for process in mp.active_children():
                process.terminate()
            # Before Python 3.11.5 the pool waits for ever to hand out a large job that nobody is left to read; since then it
            # closes that end itself, and must not find it closed halfway.
            if self._jobs_reader is not None and sys.version_info < (3, 11, 5):
                self._jobs_reader.close()
        super().__exit__(kind, error, tb)
        if isinstance(error, BrokenProcessPool):
            raise WorkerLostError.of("a worker process") from None


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
