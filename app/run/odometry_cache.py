"""The user's cache of odometries: one zip file of arrays for each bag and settings.

Zip files contain checksums: a damaged or cut file is detected when it is read. A cache that cannot
be read or written costs time, nothing else.
"""

import os
import time
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.run.arrays import Arrays, pack, pack_rows, unpack, unpack_rows
from ffmap.app.user_cache import CACHE_VARIABLE as CACHE_VARIABLE
from ffmap.app.user_cache import user_cache

LIMIT_BYTES = 5_000_000_000
"""Maximum size of the cache; the odometries that were not used for longest are removed first."""
_ABANDONED_S = 24 * 3600.0
"""Age (s) of the unfinished file of a run that was killed."""
_TOGETHER = 50
"""Number of registrations in one group of arrays."""

Result = Registration | PoseGraph


def cache_folder() -> Path:
    """Return $FFMAP_CACHE/odometry, or the same in the user's folder of caches."""
    named = os.environ.get(CACHE_VARIABLE)
    return (Path(named) if named else user_cache()) / "odometry"


@dataclass(frozen=True)
class Cached:
    """The registrations and loops of a bag; None where they are not cached. damage: a warning."""

    results: Iterator[Result] | None = None
    damage: str | None = None


def read_cached(key: str, fingerprint: Callable[[], str]) -> Cached:
    """Look up an odometry; a damaged one is removed. fingerprint: of the bag, which takes time."""
    if not any(cache_folder().glob(f"{key}-*.zip")):
        return Cached()
    path = _path(key, fingerprint())
    if not path.exists():
        return Cached()
    try:
        with zipfile.ZipFile(path) as file:
            if (damaged := file.testzip()) is not None:
                raise zipfile.BadZipFile(f"wrong checksum of {damaged}")
        path.touch()
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        with suppress(OSError):
            path.unlink()
        reason = " ".join(str(error).split()) or type(error).__name__
        return Cached(
            damage=f"the odometry in the cache {cache_folder()} was damaged ({reason}). It was "
            "removed and is computed again"
        )
    return Cached(_results(path))


class CacheWriter:
    """Writes an odometry to the cache while it is computed. failure: a warning."""

    def __init__(self, key: str, fingerprint: Callable[[], str]) -> None:
        self.failure: str | None = None
        self._key, self._fingerprint = key, fingerprint
        self._part = cache_folder() / f"{key}-{os.getpid()}.part"
        self._file: zipfile.ZipFile | None = None
        self._groups = 0

    def keep(self, results: Iterable[Result]) -> Iterator[Result]:
        """Yield the results; the file appears when all have passed."""
        self._try(self._open)
        waiting: list[Registration] = []
        try:
            for result in results:
                if isinstance(result, Registration):
                    waiting.append(result)
                if isinstance(result, PoseGraph) or len(waiting) == _TOGETHER:
                    self._try(self._append, pack_rows(waiting))
                    waiting = []
                if isinstance(result, PoseGraph):
                    self._try(self._append, pack(result, "graph_"))
                yield result
            self._try(self._append, pack_rows(waiting))
            self._try(self._complete)
        finally:
            with suppress(OSError):
                if self._file is not None:
                    self._file.close()
                self._part.unlink(missing_ok=True)

    def _open(self) -> None:
        self._part.parent.mkdir(parents=True, exist_ok=True)
        self._file = zipfile.ZipFile(self._part, "w")

    def _append(self, arrays: Arrays) -> None:
        assert self._file is not None
        if not arrays:
            return
        for name, values in arrays.items():
            with self._file.open(f"{self._groups:06d}/{name}", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, values, allow_pickle=False)
        self._groups += 1

    def _complete(self) -> None:
        assert self._file is not None
        self._file.close()
        if not self._groups:
            return
        self._part.replace(_path(self._key, self._fingerprint()))
        _make_room()

    def _try(self, step: Callable[..., None], *arguments: Arrays) -> None:
        if self.failure is not None:
            return
        try:
            step(*arguments)
        except OSError as error:
            self.failure = (
                f"the odometry cannot be kept in the cache {cache_folder()} "
                f"({error.strerror or error}). The next run computes it again, unless "
                f"{CACHE_VARIABLE} names a folder that can be written"
            )


def _path(key: str, fingerprint: str) -> Path:
    return cache_folder() / f"{key}-{fingerprint}.zip"


def _results(path: Path) -> Iterator[Result]:
    with zipfile.ZipFile(path) as file:
        groups: dict[str, list[str]] = {}
        for entry in file.namelist():
            groups.setdefault(entry.partition("/")[0], []).append(entry)
        for entries in groups.values():
            arrays = {entry.partition("/")[2]: _array(file, entry) for entry in entries}
            if "index" in arrays:
                yield from unpack_rows(Registration, arrays)
            elif arrays:
                yield unpack(PoseGraph, arrays, "graph_")


def _array(file: zipfile.ZipFile, entry: str) -> npt.NDArray[Any]:
    with file.open(entry) as opened:
        return np.asarray(np.lib.format.read_array(opened, allow_pickle=False))


def _make_room() -> None:
    """Remove unfinished files of killed runs, and the odometries that were not used for longest."""
    folder, now = cache_folder(), time.time()
    for part in folder.glob("*.part"):
        if now - part.stat().st_mtime > _ABANDONED_S:
            part.unlink(missing_ok=True)
    entries = [(path.stat(), path) for path in folder.glob("*.zip")]
    total = 0
    for stat, path in sorted(entries, key=lambda entry: -entry[0].st_mtime):
        total += stat.st_size
        if total > LIMIT_BYTES:
            path.unlink(missing_ok=True)
