"""Commands that users can copy from our output: they call this very installation."""

import os
import shlex
import shutil
import sys
from pathlib import Path

_NAME = "ffmap"


def own_command() -> str:
    """Return `ffmap` if the shell finds this installation by that name, else the script's path."""
    beside = Path(sys.executable).with_name(_NAME)
    candidates = (Path(sys.argv[0]), beside)
    scripts = [path for path in candidates if path.stem == _NAME and path.is_file()]
    found = shutil.which(_NAME)
    if not scripts or (found is not None and Path(found).resolve() == scripts[0].resolve()):
        return _NAME
    return shlex.quote(_short(scripts[0]))


def view_command(place: Path) -> str:
    """Return the command that shows a run in a window, or in a browser without a display."""
    return f"{own_command()} view {'' if has_display() else '--web '}{shlex.quote(str(place))}"


def has_display() -> bool:
    return sys.platform != "linux" or "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ


def pip_command(package: str) -> str:
    """Return the command that installs a package for this interpreter."""
    return f"{shlex.quote(_short(Path(sys.executable)))} -m pip install {package}"


def _short(program: Path) -> str:
    """Return the path relative to the working directory if it is in it, else absolute."""
    # Links are not followed: the interpreter of a virtual environment is a link out of it.
    path, here = Path(os.path.abspath(program)), Path.cwd()  # noqa: PTH100
    return str(path.relative_to(here)) if here in path.parent.parents else str(path)
