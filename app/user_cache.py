"""The folder of this user's caches."""

import os
import sys
from pathlib import Path

CACHE_VARIABLE = "FFMAP_CACHE"
"""The environment variable that names another folder for the odometry cache."""


def user_cache() -> Path:
    """Return the folder in $XDG_CACHE_HOME, ~/.cache or the system's equivalent."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "furniture-free-mapping"
