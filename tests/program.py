"""The program as a user starts it, and the rig files that users write."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from unittest import mock

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.app import cli
from ffmap.loaders.bag import open_bag
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.rig import Rig

FFMAP = [sys.executable, "-c", "from ffmap.app.cli import main; main()"]
_WITH_SIGINT = (
    "import os, signal, sys; signal.signal(signal.SIGINT, signal.{}); "
    "os.execv(sys.argv[1], sys.argv[1:])"
)
# An interpreter sets the signal, as a preexec_fn crashes now and then beside threads of gRPC.
FFMAP_IN_FRONT = [sys.executable, "-c", _WITH_SIGINT.format("SIG_DFL"), *FFMAP]
"""Interrupted by Ctrl-C, also if the tests themselves run in the background."""
FFMAP_BEHIND = [sys.executable, "-c", _WITH_SIGINT.format("SIG_IGN"), *FFMAP]
"""As 'nohup ffmap run ... &' in a script."""


def with_cache(folder: Path) -> dict[str, str]:
    """The environment of a program with its own cache of odometries."""
    return {**os.environ, "FFMAP_CACHE": str(folder)}


def ffmap(
    environment: dict[str, str], *words: object, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own."""
    command = [*FFMAP, *map(str, words)]
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False
    )


def ffmap_here(
    environment: dict[str, str], *words: object, cwd: Path = Path()
) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, where modules are loaded and workers fork quickly."""
    arguments, out, err, code = ["ffmap", *map(str, words)], StringIO(), StringIO(), 0
    with (
        mock.patch.object(sys, "argv", arguments),
        mock.patch.dict(os.environ, environment, clear=True),
        chdir(cwd),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            cli.main()
        except SystemExit as ended:
            code = int(ended.code or 0)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def kill_once(environment: dict[str, str], there: Callable[[], object], *words: object) -> None:
    """Start the program; kill it with its workers as soon as `there` is true."""
    process = subprocess.Popen(
        [*FFMAP, *map(str, words)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    end = time.monotonic() + 120
    while not there() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def rig_of(bag: Path, file: Path | None = None) -> Rig:
    with open_bag(bag) as opened:
        return find_rig(opened, file)


def write_rig(file: Path, rig: Rig, vertical_off: FloatArray, clock_s: float = 0.0) -> None:
    """Write a rig file of two lidars with the vertical one off, by (4, 4) in the base frame."""
    assert rig.horizontal is not None
    assert rig.vertical is not None
    T_vertical = vertical_off @ rig.vertical.T_base_sensor
    text = f'base = "{rig.base_frame}"\n'
    for topic, T in (
        (rig.horizontal.topic, rig.horizontal.T_base_sensor),
        (rig.vertical.topic, T_vertical),
    ):
        text += f'[[lidar]]\ntopic = "{topic}"\ntranslation = {T[:3, 3].tolist()}\n'
        text += f"quaternion_xyzw = {transforms.quaternion_xyzw(T).tolist()}\n"
    file.write_text(f"{text}clock_s = {clock_s}\n")
