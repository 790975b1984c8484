"""One hash of a bag's content, to recognise the bag of an earlier run."""

import hashlib
from pathlib import Path

import xxhash

from ffmap.loaders.bag_path import BagPath

_PARTS = {".bag", ".mcap", ".db3", ".db3-wal"}


def fingerprint(bag: BagPath) -> str:
    """Hash the bytes of a bag's files with XXH3 (128 bits).

    The hash does not depend on the names or the order of the files. XXH3 detects accidental
    changes, and is no protection against forged files.
    """
    return xxhash.xxh3_128_hexdigest(b"".join(sorted(_digest(file) for file in files_of(bag))))


def files_of(bag: BagPath) -> list[Path]:
    """List the files that contain a bag's messages, including the write-ahead log of a database."""
    files = []
    for part in bag.parts:
        if part.is_dir():
            files += [f for f in part.iterdir() if f.is_file() and _PARTS & {*f.suffixes}]
        else:
            wal = part.with_name(f"{part.name}-wal")
            files += [part, wal] if wal.exists() else [part]
    return files


def _digest(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, xxhash.xxh3_128).digest()
