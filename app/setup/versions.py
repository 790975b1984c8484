"""Which program made a run."""

import platform
import subprocess
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("rerun-sdk", "numpy", "scipy", "numba", "rosbags", "kiss-icp", "small_gicp", "gtsam")


def versions() -> dict[str, str]:
    """Versions of the program, of Python and of what decides results."""
    return {
        "furniture-free-mapping": version("furniture-free-mapping"),
        "git_revision": git_revision(),
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }


def git_revision() -> str:
    """The checkout's commit, with + where files differ from it; empty where this is no checkout."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        return subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--abbrev=12", "--dirty=+", "--exclude=*"],
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        ).stdout.strip()
    except OSError:
        return ""
