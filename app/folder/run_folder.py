"""The folder of a run: who may write to it, and how it is replaced.

Nothing is ever removed but files that runs write.
"""

import fcntl
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ffmap.app.folder.names import LABELLED_FOLDER, RUN_JSON, SPOOL, file_names, require_writable
from ffmap.app.folder.record import PROGRAM, read_record
from ffmap.loaders.errors import InputError

_LABELLED = ("metadata.yaml", f"{LABELLED_FOLDER}*.db3", f"{LABELLED_FOLDER}*.mcap")
"""The files of a labelled ROS 2 bag."""
_TRIES, _TRY_AGAIN_S = 4, 0.05
"""How often, and after how many seconds, a lock is tried: `is_held` locks for a moment."""


def create(folder: Path, overwrite: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Create the folder of a new run if need be; its files stay until `clear`.

    overwrite: whether it may contain an earlier run. inputs: files that the run reads.
    Raises InputError where the earlier run must not be replaced or is an input, where there is
    anything but a run, and where the folder cannot be written.
    """
    instead = "give another folder to --out"
    try:
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder}: is a file; give a folder to --out")
        names = [entry.name for entry in folder.iterdir()] if folder.exists() else []
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}); {instead}") from error
    if RUN_JSON in names:
        _check_replaceable(folder, overwrite, inputs)
    elif names:
        raise InputError(f"{folder}: has files that are no run; give an empty folder to --out")
    require_writable(folder, instead)


def _check_replaceable(folder: Path, overwrite: bool, inputs: Iterable[Path]) -> None:
    record = read_record(folder)
    if record.program != PROGRAM:
        raise InputError(
            f"{folder}: has a {RUN_JSON} that ffmap did not write; give an empty folder to --out"
        )
    if not overwrite:
        kind = "a finished run"
        if record.outcome != "complete":
            kind = f"a run that is not finished ('ffmap run --resume {folder}' continues it)"
        raise InputError(
            f"{folder}: contains {kind}; give another folder to --out, or replace it with "
            "--overwrite"
        )
    own = {folder.resolve() / name for name in file_names()}
    for read in inputs:
        if own & {read.resolve(), *read.resolve().parents}:
            raise InputError(
                f"{read}: is an input, and belongs to the run that --overwrite replaces; give "
                "another folder to --out"
            )


def clear(folder: Path) -> None:
    """Remove what an earlier run has written."""
    shutil.rmtree(folder / SPOOL, ignore_errors=True)
    labelled = folder / LABELLED_FOLDER
    if labelled.is_dir() and not labelled.is_symlink():
        for pattern in _LABELLED:
            for file in labelled.glob(pattern):
                file.unlink()
        with suppress(OSError):
            labelled.rmdir()
    for name in file_names():
        for path in (folder / name, folder / f"{name}.part"):
            if path.is_symlink() or not path.is_dir():
                path.unlink(missing_ok=True)


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Lock a run folder until the context or the process ends; network drives may not lock.

    Raises InputError where another run has locked it.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        _lock(descriptor, folder)
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, folder: Path) -> None:
    for _ in range(_TRIES):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_TRY_AGAIN_S)
        except OSError:
            return
        else:
            return
    raise InputError(
        f"{folder}: another run is writing there; wait for its end, or give another folder to --out"
    )


def is_held(folder: Path) -> bool:
    """Return whether a run is writing to a folder; True where folders cannot be locked."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    else:
        return False
    finally:
        os.close(descriptor)


def written_files(folder: Path) -> tuple[str, ...]:
    """List the files of a run that exist."""
    known = file_names() - {SPOOL}
    return tuple(sorted(entry.name for entry in folder.iterdir() if entry.name in known))


def point_latest_at(folder: Path) -> None:
    """Point the link `latest` beside a run folder at it, unless `latest` is no link to a run."""
    latest = folder.parent / "latest"
    if latest.exists() and not (latest.is_symlink() and (latest / RUN_JSON).exists()):
        return
    link = folder.parent / f".latest-{os.getpid()}"
    try:
        link.symlink_to(folder.name, target_is_directory=True)
        link.replace(latest)
    except OSError:
        link.unlink(missing_ok=True)
