"""The folder in which Numba keeps compiled code: one for each state of the sources.

Numba compares only the file of a function. It does not notice when a function in another file,
which is compiled into it, changes. The folder has to be set before Numba is imported.
"""

import atexit
import hashlib
import os
import shutil
import tempfile
from pathlib import Path

from ffmap.app.user_cache import user_cache

VARIABLE = "NUMBA_CACHE_DIR"
"""Environment variable of Numba; a folder that the user has set takes precedence."""
SOURCES = Path(__file__).resolve().parents[1] / "algorithms"
"""Folder of all compiled functions."""


def compiled_code() -> dict[str, str]:
    """Return the environment in which Numba keeps its code; empty if a folder is set already."""
    if os.environ.get(VARIABLE):
        return {}
    state = hashlib.sha256()
    for file in sorted(SOURCES.rglob("*.py")):
        state.update(str(file.relative_to(SOURCES)).encode() + file.read_bytes())
    try:
        folder = user_cache() / "compiled" / state.hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError):  # no home, or a cache that cannot be written
        folder = Path(tempfile.mkdtemp(prefix="ffmap-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return {VARIABLE: str(folder)}
