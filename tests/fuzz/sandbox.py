"""A process in which commands meet damaged input: what ends it, hangs or fills the memory is a failure, not the tests' end."""

import multiprocessing as mp
import os
import resource
import signal
import sys
import traceback
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil

from ffmap.loaders.errors import InputError

SECONDS_MAX = 10
"""Of the processor: a busy machine is no failure."""
_WAIT_S = 120.0
"""For what takes no processor, such as a pipe that nobody writes to."""
_MEMORY_MAX = 2 << 30
"""That is filled. Twice as much may be asked for: a read of as many bytes as a damaged length says fills little of it."""
_NO_MEMORY = ("Unable to allocate", "bad_alloc")
_LINE_MAX = 2000
_CASES = 500
"""Of a process: libraries keep some of what each case took, and no command meets thousands of files."""

Command = Callable[..., object]


class Sandbox:
    """Runs commands one after the other in a process of its own, with a new one after each that did not come back.

    folder: for a case's files; one case's are gone when the next begins. cases: how many ran, by the command's name.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cases: Counter[str] = Counter()
        self._process: Any = None
        self._pipe: Any = None

    def run(self, command: Command, *arguments: object) -> None:
        """Raises AssertionError where a command neither did its work nor raised an InputError of one line."""
        if self.cases.total() % _CASES == 0:
            self.close()
        self.cases[command.__name__] += 1
        if self._process is None:
            self._start()
        self._pipe.send((command, arguments))
        try:
            told: str | None = self._pipe.recv() if self._pipe.poll(_WAIT_S) else f"no answer within {_WAIT_S:g} s"
        except (EOFError, ConnectionError):
            self._process.join()
            told = f"ended the process, code {self._process.exitcode}"
        if told is not None:
            self.close()
            raise AssertionError(told)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
        self._process = None

    def _start(self) -> None:
        context = mp.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=False)
        self._process.start()
        theirs.close()


class _TooLongError(BaseException):
    """No `except Exception` stops it."""


def _serve(pipe: Connection) -> None:
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, sys.stdout.fileno())
    os.dup2(silent, sys.stderr.fileno())
    signal.signal(signal.SIGPROF, _too_long)
    most: int | None = None
    while True:
        try:
            command, arguments = pipe.recv()
        except EOFError:
            return
        if most is None:  # once the libraries are loaded, which reserve much and use little
            most = psutil.Process().memory_info().data + 2 * _MEMORY_MAX
            resource.setrlimit(resource.RLIMIT_DATA, (most, most))
        pipe.send(_told(command, arguments))


def _told(command: Command, arguments: tuple[object, ...]) -> str | None:
    signal.setitimer(signal.ITIMER_PROF, SECONDS_MAX)
    try:
        command(*arguments)
        said = ""
    except InputError as error:
        said = str(error)
    except BaseException:
        return traceback.format_exc(limit=-12)[-4000:]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    filled = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if filled > _MEMORY_MAX:
        return f"{filled:,} bytes of memory were filled"
    if "\n" in said or len(said) > _LINE_MAX or any(word in said for word in _NO_MEMORY):
        return f"an error of more than a line, or for want of memory: {said[:_LINE_MAX]}"
    return None


def _too_long(*_: object) -> None:
    raise _TooLongError(f"{SECONDS_MAX} s of the processor are over")
