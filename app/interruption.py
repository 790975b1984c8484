"""Ctrl-C, which libraries drop or turn into errors of their own."""

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_AGAIN_S = 0.1
_pressed = threading.Event()


def listen() -> None:
    """Make sure that Ctrl-C ends the program, though a destructor may drop the first exception."""
    signal.signal(signal.SIGINT, _press)
    sys.unraisablehook = _meet_dropped


@contextmanager
def interruption_alone() -> Iterator[None]:
    """Raise KeyboardInterrupt in place of the errors that follow from it.

    A compiled module that was being imported ends with an ImportError.
    """
    try:
        yield
    except Exception as error:
        if _pressed.is_set():
            raise KeyboardInterrupt from error
        raise


@contextmanager
def unheard() -> Iterator[None]:
    """Start processes that never hear Ctrl-C, which reaches all processes of a terminal."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _press(number: int, frame: FrameType | None) -> None:
    _pressed.set()
    raise KeyboardInterrupt


def _meet_dropped(dropped: "sys.UnraisableHookArgs") -> None:
    if isinstance(dropped.exc_value, KeyboardInterrupt):
        threading.Timer(_AGAIN_S, _thread.interrupt_main).start()
    elif not _pressed.is_set():  # Unfinished objects complain when they are deleted.
        sys.__unraisablehook__(dropped)
