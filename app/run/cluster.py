"""A Dask cluster as an executor; imported only where a scheduler is named."""

import asyncio
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ffmap.app.own_command import pip_command
from ffmap.app.setup.versions import versions
from ffmap.loaders.errors import InputError

_CONNECT_S = 5.0
_PROGRAM = ("furniture-free-mapping", "git_revision")


@dataclass(frozen=True)
class Cluster:
    """A cluster whose workers have the program and all files. slots: number of jobs at once."""

    executor: Executor
    slots: int


@contextmanager
def connect(address: str, needed: Sequence[Path]) -> Iterator[Cluster]:
    """Connect to the scheduler at an address.

    needed: files that workers read, under the same path as here.
    Raises InputError where Dask is not installed, no scheduler answers, a worker cannot do the
    work, or the cluster loses a part of it.
    """
    try:
        import distributed  # noqa: TID251 - its one place
    except ImportError:
        raise InputError(
            f"--scheduler: Dask is not installed; install it with '{pip_command('distributed')}', "
            "or omit --scheduler"
        ) from None
    try:
        # A client that finds no scheduler takes longer, and prints more than one line.
        asyncio.run(asyncio.wait_for(_knock(address), _CONNECT_S))
        client: Any = distributed.Client(  # type: ignore[no-untyped-call]
            address, timeout=_CONNECT_S, set_as_default=False
        )
    except (OSError, ValueError, TypeError) as error:
        reason = " ".join(str(error).split()) or "no answer"
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({reason}); 'dask scheduler' "
            "starts one and prints its address, as in tcp://127.0.0.1:8786"
        ) from None
    try:
        _check(client, address, needed)
        try:
            slots = sum(client.nthreads().values())
            yield Cluster(client.get_executor(pure=False), slots)
        except (distributed.KilledWorker, CancelledError):
            raise InputError(
                f"--scheduler {address}: lost its workers, most likely because memory ran out"
            ) from None
    finally:
        client.close(timeout=_CONNECT_S)


async def _knock(address: str) -> None:
    """Raise OSError or ValueError where no scheduler answers."""
    from distributed.comm.core import connect as reach  # noqa: TID251 - its one place

    comm = await reach(address, timeout=_CONNECT_S)  # type: ignore[no-untyped-call]
    await comm.close()


def _check(client: Any, address: str, needed: Sequence[Path]) -> None:  # noqa: ANN401
    try:
        client.wait_for_workers(1, timeout=_CONNECT_S)
    except TimeoutError:
        raise InputError(
            f"--scheduler {address}: has no worker; start some with 'dask worker {address}'"
        ) from None
    try:
        found: dict[str, dict[str, str]] = client.run(versions)
    except Exception as error:
        raise InputError(
            f"--scheduler {address}: a worker cannot import furniture-free-mapping "
            f"({type(error).__name__}: {error}); start the workers in an environment that has it"
        ) from None
    own = " ".join(versions()[name] for name in _PROGRAM)
    for worker, of_worker in found.items():
        theirs = " ".join(of_worker.get(name, "") for name in _PROGRAM)
        if theirs != own:
            raise InputError(
                f"--scheduler {address}: worker {worker} has another version of the program "
                f"({theirs}; here {own}); install the same on all"
            )
    for path in needed:
        if not all(client.run(os.path.exists, str(path)).values()):
            raise InputError(
                f"--scheduler {address}: a worker does not see {path}; bags and --out need the "
                "same path on all workers"
            )
