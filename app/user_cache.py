"""The folder of this user's caches."""

import os
from pathlib import Path

CACHE_VARIABLE = "FFMAP_CACHE"
"""The environment variable that names another folder for the odometry cache."""


def user_cache() -> Path:
    """Return the program's folder in $XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "furniture-free-mapping"
