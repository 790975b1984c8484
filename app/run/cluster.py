"""Work on a Dask cluster: its scheduler, workers and executor; imported only where one is named."""

import asyncio
import os
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ffmap.app.own_command import pip_command
from ffmap.app.setup.versions import versions
from ffmap.loaders.errors import InputError

_CONNECT_S = 5.0
_PROGRAM = ("furniture-free-mapping", "git_revision")


class _Remote(Executor):
    """Dask's executor, which may be told to cancel what has not begun as those of the standard library are."""

    def __init__(self, client: Any) -> None:  # noqa: ANN401 - distributed.Client
        self._executor = client.get_executor(pure=False)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        future: Future[Any] = self._executor.submit(fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._executor.shutdown(wait=wait and not cancel_futures)


class Cluster:
    """A cluster whose workers were seen to have the program and all files that they need."""

    def __init__(self, client: Any) -> None:  # noqa: ANN401 - distributed.Client
        self._client = client
        self.executor: Executor = _Remote(client)

    @property
    def slots(self) -> int:
        """How many jobs it takes at once: one for each thread of each worker that is there now."""
        return sum(self._client.nthreads().values())

    def all_see(self, path: Path) -> bool:
        return all(self._client.run(os.path.exists, str(path)).values())


@contextmanager
def connect(address: str, needed: list[Path], stop: Callable[[], None] | None = None) -> Iterator[Cluster]:
    """The cluster at a scheduler's address, if all its workers can do the work.

    needed: files that every worker has to see under the same path. stop: called on every worker where the work ends early.
    Raises InputError in seconds where Dask is not installed, no scheduler answers, or a worker cannot do the work; and where
    the cluster loses a part of it.
    """
    try:
        import distributed  # noqa: TID251 - its one place
    except ImportError:
        raise InputError(
            f"--scheduler: Dask is not installed; '{pip_command('distributed')}' installs it (in a checkout, pip install "
            "'.[cluster]' does too), or leave --scheduler out"
        ) from None
    try:
        # A client that finds nobody takes its time, and says more than one line.
        asyncio.run(asyncio.wait_for(_knock(address), _CONNECT_S))
        client: Any = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        reason = " ".join(str(error).split()) or "it says nothing"
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({reason}); 'dask scheduler' starts one and prints its "
            "address, as in tcp://127.0.0.1:8786"
        ) from None
    try:
        cluster = Cluster(client)
        _check(client, cluster, address, needed)
        try:
            yield cluster
        except BaseException as error:
            # Dask takes back what has not begun; what has would go on to its end.
            cluster.executor.shutdown(wait=False)
            if stop is not None:
                client.run(stop, on_error="ignore")
            if isinstance(error, distributed.KilledWorker | CancelledError):
                raise InputError(
                    f"--scheduler {address}: lost its workers, most likely because memory ran out"
                ) from None
            raise
    finally:
        client.close(timeout=_CONNECT_S)


async def _knock(address: str) -> None:
    """Raises OSError or ValueError where nobody speaks Dask's protocol."""
    from distributed.comm.core import connect as reach  # noqa: TID251 - its one place

    comm = await reach(address, timeout=_CONNECT_S)  # type: ignore[no-untyped-call]
    await comm.close()


def _check(client: Any, cluster: Cluster, address: str, needed: list[Path]) -> None:  # noqa: ANN401
    try:
        client.wait_for_workers(1, timeout=_CONNECT_S)
    except TimeoutError:
        raise InputError(f"--scheduler {address}: it has no worker; start some with 'dask worker {address}'") from None
    try:
        found: dict[str, dict[str, str]] = client.run(versions)
    except Exception as error:
        raise InputError(
            f"--scheduler {address}: a worker cannot import furniture-free-mapping ({type(error).__name__}: {error}); "
            "start the workers in an environment that has it"
        ) from None
    own = " ".join(versions()[name] for name in _PROGRAM)
    for worker, of_worker in found.items():
        theirs = " ".join(of_worker.get(name, "") for name in _PROGRAM)
        if theirs != own:
            raise InputError(
                f"--scheduler {address}: worker {worker} has another version of the program ({theirs}; here {own}); "
                "install the same on all"
            )
    for path in needed:
        if not cluster.all_see(path):
            raise InputError(
                f"--scheduler {address}: a worker does not see {path}; bags and --out have to lie where all workers "
                "reach them under the same path"
            )
