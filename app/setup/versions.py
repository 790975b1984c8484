"""The versions of the program and of what decides results."""

import platform
import subprocess
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("rerun-sdk", "numpy", "scipy", "numba", "rosbags", "kiss-icp", "small_gicp", "gtsam")


def versions() -> dict[str, str]:
    """Return the versions of the program, of Python and of packages."""
    return {
        "furniture-free-mapping": version("furniture-free-mapping"),
        "git_revision": git_revision(),
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }


def git_revision() -> str:
    """Return the commit of the checkout, with + if files differ; empty outside a checkout."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    describe = ["describe", "--always", "--abbrev=12", "--dirty=+", "--exclude=*"]
    command = ["git", "-C", str(root), *describe]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except OSError:
        return ""
    return done.stdout.strip()
