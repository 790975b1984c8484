"""The folder in which this user's caches lie."""

import os
import sys
from pathlib import Path

CACHE_VARIABLE = "FFMAP_CACHE"
"""The environment variable that names the folder of the cache, before anything else does."""


def user_cache() -> Path:
    """In $XDG_CACHE_HOME or ~/.cache, or what the system uses instead; $FFMAP_CACHE is not asked."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "furniture-free-mapping"
