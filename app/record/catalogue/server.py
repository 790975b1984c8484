"""Rerun's catalogue server in a process of its own: a damaged recording can end it, and is to end nothing else."""

import subprocess
import sys
from contextlib import suppress

from ffmap.loaders.errors import InputError

LOOPBACK = "127.0.0.1"


class CatalogueServer:
    """A server on a loopback port, which ends with this process, however that ends.

    url: where it listens; the same after `restart`.
    """

    def __init__(self) -> None:
        """Raises InputError where no server can be started."""
        self._start(0)

    def ended(self) -> bool:
        """Whether it has ended by itself; waits a moment for what is about to."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_SOON_S)
        return self._process.poll() is not None

    def restart(self) -> None:
        """Start it anew, empty, at the same address."""
        self.close()
        self._start(int(self.url.rpartition(":")[2]))

    def close(self) -> None:
        """End it; killed only where it does not end by itself, since it then leaves a folder among the temporary ones."""
        try:
            self._process.communicate(timeout=_ORDERLY_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()

    def _start(self, port: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", "from ffmap.app.record.catalogue.server import main; main()", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,  # Ctrl-C is for us
        )
        assert self._process.stdout is not None
        self.url = self._process.stdout.readline().strip()
        if not self.url:
            self.close()
            raise InputError(f"{LOOPBACK}: Rerun's server does not start; 'python -m rerun server' says why")


_SOON_S = 0.5
_ORDERLY_S = 5.0


def main() -> None:
    """Serve until whoever started this process ends, or closes its standard input."""
    from rerun.server import Server

    with Server(host=LOOPBACK, port=int(sys.argv[1])) as server:
        sys.stdout.write(f"{server.url()}\n")
        sys.stdout.flush()
        sys.stdin.read()
