"""Ctrl-C ends the program with one line wherever it arrives: in processes of their own."""

import subprocess
import sys

import pytest

_HEAD = """
import signal, subprocess, sys, threading, time
from ffmap.app.interruption import interruption_alone, listen, unheard
listen()
try:
    with interruption_alone():
{body}
except KeyboardInterrupt:
    print("interrupted")
"""

_MASKED = """
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error
"""

_DROPPED = """
        class Owner:
            def __del__(self):
                signal.raise_signal(signal.SIGINT)
        Owner()
        end = time.monotonic() + 30
        while time.monotonic() < end:
            pass
        print("went on")
"""

_TAKING_A_LOCK = """
        taken = threading.Lock()
        class Owner:
            def __enter__(self):
                taken.acquire()
                signal.raise_signal(signal.SIGINT)
            def __exit__(self, *_):
                taken.release()
        try:
            with Owner():
                pass
            time.sleep(30)
        finally:
            print(end="taken for ever " if taken.locked() else "")
"""


@pytest.mark.parametrize(
    "body", [_MASKED, _DROPPED, _TAKING_A_LOCK], ids=["masked", "dropped", "lock"]
)
def test_whatever_a_library_makes_of_it_ctrl_c_interrupts(body: str) -> None:
    assert _output(_HEAD.format(body=body)) == ("interrupted\n", "")


def test_errors_without_ctrl_c_stay_what_they_are() -> None:
    said, error = _output(_HEAD.format(body="        raise ImportError('missing')"))
    assert said == ""
    assert error.endswith("ImportError: missing\n")


_CHILD = "import signal; signal.raise_signal(signal.SIGINT); print('went on')"


def test_processes_started_unheard_go_on_from_their_first_instruction() -> None:
    body = f"""
        with unheard():
            subprocess.run([sys.executable, "-c", {_CHILD!r}])
        signal.raise_signal(signal.SIGINT)
"""
    assert _output(_HEAD.format(body=body)) == ("went on\ninterrupted\n", "")


def _output(program: str) -> tuple[str, str]:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    return done.stdout, done.stderr
