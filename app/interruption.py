"""Ctrl-C, which libraries drop or turn into errors of their own."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_AGAIN_S = 0.05
_BETWEEN = {"__enter__", "__exit__"}
"""Functions that an exception must not end: a lock that `threading.Condition` has just taken would
never be released."""
_pressed = threading.Event()


def listen() -> None:
    """Make sure that Ctrl-C ends the program, and at a place where an exception breaks nothing."""
    signal.signal(signal.SIGINT, _press)
    signal.signal(signal.SIGALRM, _press)
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
    if frame is not None and frame.f_code.co_name in _BETWEEN:
        _press_in(_AGAIN_S)
    else:
        _press_in(0)
        raise KeyboardInterrupt


def _press_in(seconds: float) -> None:
    """Repeat the interruption after this time; never with 0."""
    signal.setitimer(signal.ITIMER_REAL, seconds)


def _meet_dropped(dropped: "sys.UnraisableHookArgs") -> None:
    if isinstance(dropped.exc_value, KeyboardInterrupt):
        _press_in(_AGAIN_S)
    elif not _pressed.is_set():  # Unfinished objects complain when they are deleted.
        sys.__unraisablehook__(dropped)
