"""The user's cache of odometries: one folder for each bag and setting, believed only when every byte of it is as written.

An entry is named after its key (settings, sensors, times of the clouds) and after the digest of every byte of the clouds
that it was made from. A cache that cannot be read or written costs time, nothing else.
"""

import io
import json
import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import xxhash

from ffmap.app.run.arrays import Arrays
from ffmap.app.user_cache import CACHE_VARIABLE as CACHE_VARIABLE
from ffmap.app.user_cache import user_cache

LIMIT_BYTES = 5_000_000_000
"""The cache is kept below this size; what was not used for longest goes first."""

_COMPLETE = "complete"
_ENTRY = re.compile(r"[0-9a-f]{24}(-[0-9a-f]{32})?")
_PART = re.compile(_ENTRY.pattern + r"\.\d+\.part")
_ABANDONED_S = 24 * 3600.0
"""Age in seconds at which an unfinished part is taken for that of a run that was killed."""
_IN_USE_S = 60.0
"""Time in seconds after its last use in which another run may still read an entry."""


def cache_folder() -> Path:
    """Where odometries are kept: in $FFMAP_CACHE, else in $XDG_CACHE_HOME or ~/.cache, or what the system uses instead."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named) / "odometry"
    return user_cache() / "odometry"


@dataclass(frozen=True)
class Entry:
    """One odometry in the cache. used_s: when it was made or last taken, in seconds since 1970."""

    path: Path
    size_bytes: int
    used_s: float


def entry_name(key: str, content: str) -> str:
    """What the folder of an odometry is called. content: the digest of all clouds that it was made from."""
    return f"{key}-{content}"


def entries() -> list[Entry]:
    """What the cache holds, last used first; empty where there is no cache."""
    folder = cache_folder()
    found = [_describe(path) for path in folder.iterdir() if _ENTRY.fullmatch(path.name)] if folder.is_dir() else []
    return sorted((entry for entry in found if entry is not None), key=lambda entry: -entry.used_s)


def has_any(key: str) -> bool:
    """Whether the cache holds an odometry with this key, of whatever clouds."""
    return any(cache_folder().glob(f"{key}-*/{_COMPLETE}"))


@dataclass(frozen=True)
class Lookup:
    """What the cache had for a key and the digest of the clouds.

    files: the arrays of each file, in the order in which they were written; None where there is no sound entry.
    damage: what was wrong with an entry, which is gone now; None where nothing was.
    """

    files: list[Arrays] | None
    damage: str | None = None


def look_up(key: str, content: str) -> Lookup:
    """The odometry of these clouds; an entry that is not as it was written is removed."""
    path = cache_folder() / entry_name(key, content)
    if not path.is_dir():
        return Lookup(None)
    try:
        checksums = json.loads((path / _COMPLETE).read_text())["files"]
        written = {name: (path / name).read_bytes() for name in checksums}
        wrong = [name for name, data in written.items() if _checksum(data) != checksums[name]]
        if wrong:
            raise ValueError(f"{wrong[0]} is not as it was written")
        files = [_arrays(data) for data in written.values()]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        _remove(path)
        return Lookup(None, " ".join(str(error).split()) or type(error).__name__)
    with suppress(OSError):
        os.utime(path / _COMPLETE)
    return Lookup(files)


class Writer:
    """Keeps the files of one odometry in the cache, all of them or none.

    failure: why nothing is kept, in the system's words; None so far.
    """

    def __init__(self, key: str) -> None:
        self._key = key
        self._part = cache_folder() / f"{key}.{os.getpid()}.part"
        self._checksums: dict[str, str] = {}
        self.failure: str | None = None

    def __enter__(self) -> Self:
        with self._noting_failure():
            shutil.rmtree(self._part, ignore_errors=True)
            self._part.mkdir(parents=True)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        shutil.rmtree(self._part, ignore_errors=True)

    def add(self, arrays: Arrays) -> None:
        """Keep some arrays under their names in a file of their own."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays)
        name = f"{len(self._checksums):06d}.npz"
        self._write(name, buffer.getvalue())
        self._checksums[name] = _checksum(buffer.getvalue())

    def complete(self, content: str) -> None:
        """Let the entry appear, for the clouds with this digest; then make room where the cache is too large."""
        self._write(_COMPLETE, json.dumps({"files": self._checksums}).encode())
        if self.failure is not None:
            return
        path = cache_folder() / entry_name(self._key, content)
        with self._noting_failure():
            _remove(path)
            self._part.replace(path)
        _remove_parts(older_than_s=_ABANDONED_S)
        _keep_below(LIMIT_BYTES)

    def _write(self, name: str, data: bytes) -> None:
        if self.failure is not None:
            return
        with self._noting_failure(), (self._part / name).open("wb") as file:
            file.write(data)
            file.flush()
            # What is named complete must be on the disk, should the power go.
            os.fsync(file.fileno())

    @contextmanager
    def _noting_failure(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.failure = str(error.strerror or error)


def _keep_below(limit_bytes: int) -> None:
    total = 0
    for entry in entries():
        total += entry.size_bytes
        if total > limit_bytes and time.time() - entry.used_s > _IN_USE_S:
            _remove(entry.path)


def _describe(path: Path) -> Entry | None:
    """None where another process has just removed it."""
    try:
        size = sum(file.stat().st_size for file in path.iterdir())
        complete = path / _COMPLETE
        used_s = (complete if complete.exists() else path).stat().st_mtime
    except OSError:
        return None
    return Entry(path, size, used_s)


def _remove(path: Path) -> None:
    """First out of its name, so that nobody takes half an entry for one."""
    away = path.with_name(f"{path.name[:24]}.{time.time_ns()}.part")
    try:
        path.replace(away)
    except OSError:
        return
    shutil.rmtree(away, ignore_errors=True)


def _remove_parts(older_than_s: float) -> None:
    folder = cache_folder()
    for path in folder.iterdir() if folder.is_dir() else ():
        try:
            if _PART.fullmatch(path.name) and time.time() - path.stat().st_mtime >= older_than_s:
                shutil.rmtree(path, ignore_errors=True)
        except OSError:
            continue


def _arrays(data: bytes) -> Arrays:
    with np.load(io.BytesIO(data)) as stored:
        return {name: stored[name] for name in stored.files}


def _checksum(data: bytes) -> str:
    return str(xxhash.xxh3_128_hexdigest(data))
