"""The folder in which Numba keeps compiled code: one per state of the sources, so that none is stale.

Numba compares the file of a function alone. Called functions, constants and classes of other files
are compiled into it, so the folder is named after the text of everything that compiled code can
depend on. It has to be chosen before Numba is imported.
"""

import atexit
import hashlib
import os
import shutil
import tempfile
import time
from pathlib import Path

from ffmap.app.user_cache import user_cache

VARIABLE = "NUMBA_CACHE_DIR"
"""Numba's environment variable; a folder that the user has set counts."""
SOURCES = ("algorithms",)
"""Folders and files that hold compiled functions and what these use."""

_PACKAGE = Path(__file__).resolve().parents[1]
_UNUSED_S = 30 * 24 * 3600.0
"""Time in seconds after its last use at which the folder of another state is removed."""


def compiled_code() -> dict[str, str]:
    """Return the environment in which Numba keeps its code; empty if a folder is set already."""
    if os.environ.get(VARIABLE):
        return {}
    try:
        folder = user_cache() / "compiled" / state_of(_PACKAGE)
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        os.utime(folder)
        for other in folder.parent.iterdir():
            if time.time() - other.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(other, ignore_errors=True)
    except (OSError, RuntimeError):  # no home, or a cache that cannot be written
        folder = Path(tempfile.mkdtemp(prefix="ffmap-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return {VARIABLE: str(folder)}


def state_of(package: Path) -> str:
    """Return the hash of the sources as they are now."""
    state = hashlib.sha256()
    for source in SOURCES:
        place = package / source
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            text = file.read_bytes()
            state.update(f"{file.relative_to(package)}\0{len(text)}\0".encode() + text)
    return state.hexdigest()[:16]
