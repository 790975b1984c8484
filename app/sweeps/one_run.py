"""One run of a sweep, in a process of its own: it shares nothing with the others, and its death harms none of them.

The process reads its job from standard input, and keeps on listening: when the other end closes, for whatever reason
(the sweep was killed, a cluster's worker died), it ends with all that it started. A run that somebody else is at is
waited for rather than made twice.
"""

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import deque
from contextlib import ExitStack, suppress
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from ffmap.app.compiled_code import compiled_code
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.names import ERROR_LOG, METRICS, RunFolder, held
from ffmap.app.run.odometry import Odometry
from ffmap.app.run.odometry_cache import CACHE_VARIABLE
from ffmap.app.run.start import Arguments, carry_out, make_ready, stored
from ffmap.app.run.workers import ENVIRONMENT
from ffmap.app.setup.inputs import find_inputs
from ffmap.app.setup.settings import Settings, load_settings
from ffmap.loaders.errors import InputError

_LOCKS = ".locks"
_USERS_MISTAKE = 2


class Job(BaseModel):
    """What a process of a sweep is to do: a bag's odometry, or one run whose odometry is in the cache."""

    model_config = ConfigDict(frozen=True)

    arguments: Arguments
    """Of the run; for the odometry alone its folder is not touched."""
    bag_digest: str
    settings_hash: str
    cache: Path
    """Folder that takes the place of the user's cache folder."""
    odometry: str | None = None
    """The name of the odometry to compute, as the cache knows it; None for a run."""

    @property
    def out(self) -> Path:
        assert self.arguments.out is not None
        return self.arguments.out

    @property
    def name(self) -> str:
        return self.out.name

    @property
    def lock(self) -> Path:
        """Held by the process that is at it."""
        return self.out.parent / _LOCKS / (self.odometry or self.name)


class Outcome(BaseModel):
    """What became of a job."""

    model_config = ConfigDict(frozen=True)

    seconds: float
    error: str | None = None
    """One line; None where all went well."""


def overrides_of(settings: Settings) -> tuple[str, ...]:
    """What tells settings from the defaults, as --set takes it."""
    defaults = Settings().flat()
    return tuple(f"{name}={json.dumps(value)}" for name, value in settings.flat().items() if value != defaults[name])


def is_finished(job: Job) -> bool:
    """Whether the run's folder holds just this run, complete and evaluated."""
    return _is_complete(job) and (not job.arguments.evaluate or (job.out / METRICS).exists())


def _is_complete(job: Job) -> bool:
    try:
        record = RunFolder(job.out).read_json()
    except InputError:
        return False
    return (
        record.get("outcome") == "complete"
        and record.get("settings_hash") == job.settings_hash
        and record.get("bag", {}).get("digest") == job.bag_digest
        and record.get("options") == json.loads(json.dumps(stored(job.arguments)))
    )


_children: dict[subprocess.Popen[bytes], Path] = {}
"""Processes of this one, and the folder of the sweep that each is at work for."""


def perform(job: Job) -> Outcome:
    """Do a job in a process of its own and wait for it; never raises for what happens there."""
    started = time.monotonic()
    with tempfile.TemporaryFile() as stderr:
        process = subprocess.Popen(
            [sys.executable, "-P", "-c", "from ffmap.app.sweeps.one_run import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            env={**ENVIRONMENT, **os.environ, **compiled_code(), CACHE_VARIABLE: str(job.cache)},
            start_new_session=True,
        )
        _children[process] = job.out.parent
        try:
            assert process.stdin is not None
            with suppress(BrokenPipeError):
                process.stdin.write(job.model_dump_json().encode() + b"\n")
                process.stdin.flush()
            code = process.wait()
        finally:
            del _children[process]
            _end(process)
            process.communicate()
        stderr.seek(0)
        said = stderr.read().decode(errors="replace").strip().splitlines()
    error = None
    if code < 0:
        error = f"ended by {signal.Signals(-code).name}" + (" (out of memory?)" if code == -signal.SIGKILL else "")
    elif code > 0:
        error = said[-1] if said else f"ended with exit code {code}"
    return Outcome(seconds=time.monotonic() - started, error=error)


def stop_all(folder: Path) -> None:
    """End every process that `perform` waits for in a sweep into this folder."""
    for process, sweep in list(_children.items()):
        if sweep == folder:
            _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)


def main() -> None:
    """The process: take the job, do it, say on standard error what went wrong."""
    job = Job.model_validate_json(sys.stdin.buffer.readline())
    threading.Thread(target=_end_with_the_other_side, daemon=True).start()
    try:
        job.lock.parent.mkdir(parents=True, exist_ok=True)
        job.lock.touch()
        with held(job.lock, patience_s=math.inf):
            _do(job)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(_USERS_MISTAKE)
    except Exception as error:
        if job.odometry is None and job.out.is_dir():
            (job.out / ERROR_LOG).write_text(traceback.format_exc())
        sys.stderr.write(f"{traceback.format_exc()}\n{type(error).__name__}: {' '.join(str(error).split())}\n")
        sys.exit(1)


def _do(job: Job) -> None:
    if job.odometry is not None:
        _register(job)
    elif not _is_complete(job):
        with ExitStack() as stack:
            carry_out(make_ready(job.arguments, stack))
    if job.odometry is None and not is_finished(job):
        from ffmap.app.analysis.evaluation import evaluate_run, has_truth

        run = open_run(job.out)
        if has_truth(run):
            evaluate_run(run, None, 1)


def _register(job: Job) -> None:
    """Leave the bag's odometry in the cache."""
    assert job.arguments.bag is not None
    inputs = find_inputs(job.arguments.bag, job.arguments.bag_options)
    settings = load_settings(None, job.arguments.overrides)
    if inputs.horizontal is None:
        raise InputError(
            f"{inputs.bag_path}: no horizontal lidar gives poses; name one with --horizontal, or give --trajectory"
        )
    odometry = Odometry(inputs, inputs.horizontal, settings)
    deque(odometry, maxlen=0)
    if not odometry.kept:
        raise InputError(
            f"{job.cache}: the odometry cannot be kept there; set {CACHE_VARIABLE} to a folder that can be written"
        )


def _end_with_the_other_side() -> None:
    # Not by sys.stdin, whose lock the interpreter would wait for when it ends.
    while os.read(0, 1):
        pass
    if sys.platform != "win32":
        os.killpg(0, signal.SIGKILL)
    os._exit(1)
