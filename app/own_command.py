"""Commands that users can copy from our output."""

import os
import shlex
import shutil
import sys
from pathlib import Path

_NAME = "ffmap"


def own_command() -> str:
    """Return `ffmap`, or the path by which the user called it if the shell does not find it."""
    script = Path(sys.argv[0])
    called = script.stem == _NAME and shutil.which(_NAME) is None
    return shlex.quote(str(script)) if called else _NAME


def view_command(place: Path) -> str:
    """Return the command that shows a run in a window, or in a browser without a display."""
    return f"{own_command()} view {'' if has_display() else '--web '}{shlex.quote(str(place))}"


def has_display() -> bool:
    return sys.platform != "linux" or "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ


def pip_command(package: str) -> str:
    """Return the command that installs a package for this interpreter."""
    return f"{shlex.quote(sys.executable)} -m pip install {package}"
