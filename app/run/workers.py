"""Worker processes of a run, as an executor: here, or on a Dask cluster (see `cluster`)."""

import multiprocessing as mp
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, forkserver, resource_tracker
from pathlib import Path
from typing import Any, TypeVar

from ffmap.app.interruption import unheard
from ffmap.loaders.errors import InputError

T = TypeVar("T")

ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(4 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(16 << 20),
}
"""Read by NumPy and the C library at their start: the processes themselves fill the cores, and
every cloud needs the memory again that the last one freed. Larger arrays are given back: otherwise
the memory of the odometry is kept through the run."""


class WorkerLostError(InputError):
    """A worker process was killed; mostly by the system, when memory runs out."""


@contextmanager
def make_pool(workers: int) -> Iterator[Executor]:
    """Run jobs in processes; with one worker in this process, so that a run is one thread's work.

    Raises WorkerLostError where a worker is killed.
    """
    if workers == 1:
        yield _Serial()
        return
    # Forked from a server, for this process has threads. It imports while the odometry runs.
    context = mp.get_context("forkserver")
    context.set_forkserver_preload(["ffmap.app.run.final"])
    resource_tracker.ensure_running()  # lets signals through again after its start
    with unheard():
        forkserver.ensure_running()
    pool = ProcessPoolExecutor(workers, context, _start_as_worker)
    try:
        with _main_hidden():
            yield pool
    except BaseException as error:
        pool.shutdown(wait=False, cancel_futures=True)
        if isinstance(error, KeyboardInterrupt | BrokenProcessPool):
            # Files are complete or absent: unfinished jobs are not needed. The pool waits for
            # ever for a worker that it was starting when another one was killed.
            for process in mp.active_children():
                process.terminate()
        if isinstance(error, BrokenProcessPool):
            raise WorkerLostError(
                "a worker process was killed, most likely because memory ran out. Free memory, or "
                "use fewer --workers"
            ) from None
        raise
    finally:
        pool.shutdown()


@contextmanager
def _main_hidden() -> Iterator[None]:
    """Keep workers from importing the user's script, which would start the run again in each."""
    main = sys.modules["__main__"]
    spec, file = main.__spec__, main.__dict__.pop("__file__", None)
    main.__spec__ = None
    try:
        yield
    finally:
        main.__spec__ = spec
        if file is not None:
            main.__file__ = file


class _Serial(Executor):
    """Runs each job of `map` in this process when its result is requested."""

    def map(
        self,
        fn: Callable[..., T],
        *iterables: Iterable[Any],
        timeout: float | None = None,
        chunksize: int = 1,
    ) -> Iterator[T]:
        return map(fn, *iterables)


@contextmanager
def run_executor(
    workers: int, scheduler: str | None, needed: list[Path], say: Callable[[str], None]
) -> Iterator[Executor]:
    """Run jobs here, or on the cluster of a scheduler. needed: files that its workers read."""
    if scheduler is None:
        with make_pool(workers) as pool:
            yield pool
        return
    from ffmap.app.run.cluster import connect

    with connect(scheduler, needed) as cluster:
        say(f"cluster: {cluster.slots} blocks of scans at once")
        yield cluster.executor


def _start_as_worker() -> None:
    """End when the run is killed."""
    threading.Thread(target=_end_with_the_run, daemon=True).start()


def _end_with_the_run() -> None:
    parent = mp.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)
