"""A process for commands on damaged input: a crash, a hang or full memory is a failure."""

import multiprocessing as mp
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil

from ffmap.loaders.errors import InputError

SECONDS_MAX = 10
"""Processor time."""
_WAIT_S = 120.0
"""For commands that take no processor time, such as reading a pipe that nobody writes."""
_MEMORY_MAX = 2 << 30
_NO_MEMORY = ("Unable to allocate", "bad_alloc")
_LINE_MAX = 2000
_CASES = 500
"""Of a process: libraries keep some memory of each case."""

Command = Callable[..., object]


class Sandbox:
    """Runs commands in a process, with a new one after each that did not return.

    folder: for the files of one case.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._cases = 0
        self._process: Any = None
        self._pipe: Any = None

    def run(self, command: Command, *arguments: object) -> None:
        """Raise AssertionError unless a command returns or raises an InputError of one line."""
        self._cases += 1
        if self._cases % _CASES == 0:
            self.close()
        if self._process is None:
            context = mp.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs,), daemon=False)
            self._process.start()
            theirs.close()
        self._pipe.send((command, arguments))
        try:
            answer: str | None = f"no answer within {_WAIT_S:g} s"
            if self._pipe.poll(_WAIT_S):
                answer = self._pipe.recv()
        except (EOFError, ConnectionError):
            self._process.join()
            answer = f"ended the process, code {self._process.exitcode}"
        if answer is not None:
            self.close()
            raise AssertionError(answer)

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
        self._process = None


class _TooLongError(BaseException):
    """Passes every `except Exception`."""


def _serve(pipe: Connection) -> None:
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, sys.stdout.fileno())
    os.dup2(silent, sys.stderr.fileno())
    signal.signal(signal.SIGPROF, _too_long)
    limited = False
    while True:
        try:
            command, arguments = pipe.recv()
        except EOFError:
            return
        if not limited:  # Once the libraries are loaded, which reserve much and use little
            most = psutil.Process().memory_info().data + 2 * _MEMORY_MAX
            resource.setrlimit(resource.RLIMIT_DATA, (most, most))
            limited = True
        pipe.send(_problem(command, arguments))


def _problem(command: Command, arguments: tuple[object, ...]) -> str | None:
    line = ""
    signal.setitimer(signal.ITIMER_PROF, SECONDS_MAX)
    try:
        command(*arguments)
    except InputError as error:
        line = str(error)
    except BaseException:
        return traceback.format_exc(limit=-12)[-4000:]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    used = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if used > _MEMORY_MAX:
        return f"{used:,} bytes of memory were used"
    if "\n" in line or len(line) > _LINE_MAX or any(word in line for word in _NO_MEMORY):
        return f"an error of more than a line, or for lack of memory: {line[:_LINE_MAX]}"
    return None


def _too_long(*_: object) -> None:
    raise _TooLongError(f"more than {SECONDS_MAX} s of processor time")
