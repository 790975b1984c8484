"""An SQLite database and its -wal as one, without a change to their folder.

Recorders that are killed leave messages in the -wal. SQLite itself merges them, but writes beside the database. Here the newest
committed pages of the -wal replace those of the database while it is read (https://www.sqlite.org/fileformat2.html#walformat).
"""

from copy import copy
from pathlib import Path

import numba
import numpy as np
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from ffmap.algorithms.base.scan import IntArray, UInt8Array

_HEAD_BYTES, _FRAME_HEAD_BYTES = 32, 24
_MAGIC = 0x377F0682
"""The first word of a -wal; its last bit is set where checksums take words as big-endian."""


class SqliteReader(Sqlite3Reader):
    """rosbags' reader, which ignores a -wal by itself."""

    def __init__(self, path: Path) -> None:
        wal = path.with_name(path.name + "-wal")
        has_pages = wal.is_file() and wal.stat().st_size > _HEAD_BYTES
        super().__init__(_Merged(path, wal) if has_pages else path)  # type: ignore[arg-type]


class _Merged:
    """A database with its -wal: what rosbags asks of a path that is no file of the system, and of the file there."""

    def __init__(self, path: Path, wal: Path) -> None:
        self._path, self._position = path, 0
        self._bytes, self._wal = (np.memmap(file, np.uint8, "r") for file in (path, wal))
        self._frame_of, self._page_bytes, pages = _committed(self._wal)
        self.st_size = pages * self._page_bytes or len(self._bytes)

    def __str__(self) -> str:
        return str(self._path)

    def stat(self) -> "_Merged":
        return self

    def open(self, _mode: str) -> "_Merged":
        return copy(self)

    def seek(self, position: int) -> None:
        self._position = position

    def read(self, size: int) -> bytes:
        """At the last `seek`; SQLite reads within one page."""
        page, offset = divmod(self._position, self._page_bytes)
        content, frame = self._bytes[self._position :], self._frame_of.get(page + 1)
        if frame is not None:
            content = self._wal[_HEAD_BYTES + frame * (_FRAME_HEAD_BYTES + self._page_bytes) + _FRAME_HEAD_BYTES + offset :]
        return content[:size].tobytes()

    def close(self) -> None:
        """Nothing is open but memory."""


def _committed(wal: UInt8Array) -> tuple[dict[int, int], int, int]:
    """The frame that holds each page, bytes of a page, and pages of the database, as of the last commit; 0 without one."""
    head = wal[:_HEAD_BYTES].view(">u4").astype(np.int64)
    page_bytes = int(head[2])
    if head[0] & ~1 != _MAGIC or not 512 <= page_bytes <= 65536:
        return {}, 4096, 0
    step = _FRAME_HEAD_BYTES + page_bytes
    frames = wal[_HEAD_BYTES:][: (len(wal) - _HEAD_BYTES) // step * step].reshape(-1, step)
    page, pages, *salt_and_sum = frames[:, :_FRAME_HEAD_BYTES].view(">u4").astype(np.int64).T
    order = ">u4" if head[0] & 1 else "<u4"
    words = (np.asarray(part.view(order).astype(np.uint32, copy=False)) for part in (wal[:24], frames))
    # Another salt is from before the last checkpoint, a wrong checksum is of a page that was written in part.
    expected = np.column_stack([np.tile(head[4:6], (len(frames), 1)), _checksums(*words)])
    sound = np.logical_and.accumulate((np.column_stack(salt_and_sum) == expected).all(axis=1))
    commits = np.flatnonzero(sound & (pages > 0))
    count = int(commits[-1]) + 1 if len(commits) else 0
    return {int(page[k]): k for k in range(count)}, page_bytes, int(pages[count - 1]) if count else 0


@numba.njit(cache=True, nogil=True)
def _checksums(head: IntArray, frames: IntArray) -> IntArray:  # pragma: no cover
    """(k, 2) sums after each frame (k, w) of uint32 words; a frame's own salt and sums, words 2 to 5, are left out."""
    sums = np.empty((len(frames), 2), np.int64)
    a, b = np.uint32(0), np.uint32(0)
    for i in range(0, len(head), 2):
        a = np.uint32(a + head[i] + b)
        b = np.uint32(b + head[i + 1] + a)
    for frame in range(len(frames)):
        for i in range(0, frames.shape[1], 2):
            if i < 2 or i > 5:
                a = np.uint32(a + frames[frame, i] + b)
                b = np.uint32(b + frames[frame, i + 1] + a)
        sums[frame] = a, b
    return sums
