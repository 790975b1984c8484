"""Ctrl-C ends the program with one line wherever it arrives: in processes of their own."""

import subprocess
import sys

import pytest

_HEAD = """
import signal, subprocess, sys, time
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


@pytest.mark.parametrize("body", [_MASKED, _DROPPED], ids=["masked", "dropped"])
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
