"""Runs that are measured: each in processes of its own, with an empty cache of odometries, by any version of the program."""

import io
import os
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import BinaryIO

import psutil

from ffmap.app.folder.names import LABELLED_BAG, LABELLED_FOLDER, RECORDING, RunFolder
from ffmap.app.run.odometry_cache import CACHE_VARIABLE
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

STAGES = ("odometry", "scans", "building", "final")
PARTS = 4
"""Number of parts of a run whose peak memory is told."""

_FOLDERS = ("algorithms", "app", "blueprints", "loaders")
_PACKAGE, _PACKAGED = "ffmap", b'"ffmap.app"'
"""The package that the folders are parts of, and what pyproject.toml says since they are; before, each was one of its own."""
_SAMPLE_S = 0.2
_MISTAKE, _INTERRUPTED = 2, 130
_ENDS_BY_ITSELF_S, _ENDS_S = 2.0, 5.0
"""Time in seconds for a run to end that Ctrl-C has reached too, and for one that is told to end."""


@dataclass(frozen=True)
class Program:
    """A version of this program.

    command_line: the module whose `main` it is. import_path: the folder that it is imported from; None for the version that
        runs now.
    """

    name: str
    command_line: str
    import_path: Path | None = None


@dataclass(frozen=True)
class MeasuredRun:
    """What one run took, or the medians of several.

    whole_s: from the start of the program to its end. timings_s: as in its run.json. labelling_ms: smoothing and labelling
        of a scan, the mean, by workers side by side; None where the version does not tell.
    peaks_mib: the most memory in each quarter of this time, all processes together by their proportional set sizes.
    """

    whole_s: float
    timings_s: Mapping[str, float]
    labelling_ms: float | None
    peaks_mib: tuple[float, ...]
    recording_bytes: int
    labelled_bytes: int

    @property
    def peak_mib(self) -> float:
        """The most memory at any time."""
        return max(self.peaks_mib)


def medians(runs: Sequence[MeasuredRun]) -> MeasuredRun:
    """The median of each figure; the sizes of files are those of the first run."""
    names = [name for name in runs[0].timings_s if all(name in run.timings_s for run in runs)]
    labelling_ms = [run.labelling_ms for run in runs if run.labelling_ms is not None]
    return replace(
        runs[0],
        whole_s=median(run.whole_s for run in runs),
        timings_s={name: median(run.timings_s[name] for run in runs) for name in names},
        labelling_ms=median(labelling_ms) if labelling_ms else None,
        peaks_mib=tuple(median(peaks) for peaks in zip(*(run.peaks_mib for run in runs), strict=True)),
    )


def measure_run(
    program: Program, bag: BagPath, folder: Path, workers: int, cache: Path, trajectory: Path | None = None
) -> MeasuredRun:
    """One run, whose folder is removed by whoever owns `folder`. cache: where it keeps its odometry.

    Raises InputError where the run ends with a mistake of the user's, or where another version cannot run.
    """
    out, errors = folder / "run", folder / "errors.txt"
    words = ["run", *map(str, bag.resolve().parts), "--out", str(out)]
    words += ["--workers", str(workers), "--no-evaluate", "--quiet"]
    words += [] if trajectory is None else ["--trajectory", str(trajectory)]
    started = time.perf_counter()
    samples: list[tuple[float, float]] = []
    with errors.open("wb") as stderr, _ended_with_us(_start(program, words, cache, stderr)) as process:
        while True:
            samples.append((time.perf_counter() - started, _memory_mib(process.pid)))
            try:
                code = process.wait(_SAMPLE_S)
                break
            except subprocess.TimeoutExpired:
                continue
    whole_s = time.perf_counter() - started
    if code:
        raise _failure(program, code, errors.read_text("utf-8", "replace").strip())
    record = RunFolder(out).read_json()
    labelled = [path for name in (LABELLED_BAG, LABELLED_FOLDER) for path in (out / name, *(out / name).rglob("*"))]
    return MeasuredRun(
        whole_s,
        {name: float(seconds) for name, seconds in record["timings_s"].items()},
        record.get("statistics", {}).get("milliseconds_per_cloud", {}).get("mean"),
        _peaks(samples, whole_s),
        (out / RECORDING).stat().st_size,
        sum(path.stat().st_size for path in labelled if path.is_file()),
    )


def _start(program: Program, words: list[str], cache: Path, stderr: BinaryIO) -> "subprocess.Popen[bytes]":
    environment = {**os.environ, CACHE_VARIABLE: str(cache)}
    if program.import_path is not None:
        paths = [str(program.import_path), environment.get("PYTHONPATH", "")]
        environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    # -P: whatever folder the user is in, nothing is imported from there.
    command = [sys.executable, "-P", "-c", f"from {program.command_line} import main; main()", *words]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=stderr)


@contextmanager
def _ended_with_us(process: "subprocess.Popen[bytes]") -> Iterator["subprocess.Popen[bytes]"]:
    """After an exception nothing of the run goes on: its workers end with it, and it removes what it keeps for a while."""
    try:
        yield process
    finally:
        for wait_s, end in ((_ENDS_BY_ITSELF_S, signal.SIGINT), (_ENDS_S, signal.SIGKILL)):
            with suppress(subprocess.TimeoutExpired):
                process.wait(wait_s)
            process.send_signal(end)
        process.wait()


def _memory_mib(pid: int) -> float:
    """Proportional set sizes of a process and all below it."""
    total = 0
    try:
        family = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    except psutil.NoSuchProcess:
        return 0.0
    for process in family:
        try:
            total += process.memory_full_info().pss
        except (psutil.NoSuchProcess, psutil.AccessDenied, FileNotFoundError, ProcessLookupError):
            continue
    return total / 2**20


def _peaks(samples: Sequence[tuple[float, float]], whole_s: float) -> tuple[float, ...]:
    """The highest sample in each part of the run; in a part without one, that of the part before."""
    peaks: list[float] = []
    for part in range(PARTS):
        low, high = part * whole_s / PARTS, (part + 1) * whole_s / PARTS
        within = [mib for at_s, mib in samples if low <= at_s < high]
        peaks.append(max(within, default=peaks[-1] if peaks else 0.0))
    return tuple(peaks)


def _failure(program: Program, code: int, said: str) -> Exception:
    last = (said.splitlines() or ["it said nothing"])[-1].removeprefix("ffmap: ")
    if code == _INTERRUPTED:
        return InputError("the run that was measured was interrupted; start the measurement again")
    if program.import_path is not None:
        return InputError(
            f"--against {program.name}: its run ended with exit code {code} ({last}); name another revision"
        )
    return InputError(last) if code == _MISTAKE else RuntimeError(f"the run ended with exit code {code}:\n{said}")


def this_program() -> Program:
    """The version that runs now."""
    return Program("this version", f"{_PACKAGE}.app.cli")


def revision(name: str, folder: Path) -> Program:
    """Another revision of the checkout that this program runs from, laid out in a folder to be imported.

    Raises InputError where this is no checkout, or has no such revision.
    """
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        raise InputError(
            f"--against {name}: other revisions are in a git checkout, and this program runs from none; run it from a clone "
            "in which 'make install' was called"
        )
    found = _git(root, "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}")
    if found is None:
        raise InputError(f"--against {name}: the checkout has no such revision; 'git log' lists them")
    commit = found.decode().strip()
    packaged = _PACKAGED in (_git(root, "show", f"{commit}:pyproject.toml") or b"")
    # Not as tar, which Python 3.11 unpacks safely from 3.11.4 on only.
    archive = _git(root, "archive", "--format=zip", *([f"--prefix={_PACKAGE}/"] if packaged else []), commit, *_FOLDERS)
    if archive is None:
        raise InputError(f"--against {name}: has not the folders {', '.join(_FOLDERS)}; name a later revision")
    with zipfile.ZipFile(io.BytesIO(archive)) as packed:
        packed.extractall(folder)
    return Program(name, f"{_PACKAGE}.app.cli" if packaged else "app.cli", folder)


def _git(root: Path, *words: str) -> bytes | None:
    """What git says; None where it fails."""
    try:
        done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, check=False)
    except OSError:
        return None
    return None if done.returncode else done.stdout
