"""The words that call this program from the user's shell, however it was installed, for what is printed to be copied."""

import os
import shlex
import shutil
import sys
from pathlib import Path

_NAME = "ffmap"


def own_command() -> str:
    """`ffmap` where the shell finds this very installation by that name, else the path of its script."""
    script = _script()
    found = shutil.which(_NAME)
    if script is None or (found is not None and Path(found).resolve() == script.resolve()):
        return _NAME
    return shlex.quote(_short(script))


def view_command(place: Path) -> str:
    """What shows a run, in a window or, where there is no display, in a browser."""
    return f"{own_command()} view {'' if has_display() else '--web '}{shlex.quote(str(place))}"


def has_display() -> bool:
    """Whether a window can be opened, as far as the environment tells."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def pip_command(package: str) -> str:
    """What installs a package beside this program."""
    return f"{shlex.quote(_short(Path(sys.executable)))} -m pip install {package}"


def _script() -> Path | None:
    """The script that started this process, or the one beside the interpreter; None where there is neither."""
    suffix = ".exe" if sys.platform == "win32" else ""
    for script in (Path(sys.argv[0]), Path(sys.executable).with_name(_NAME + suffix)):
        if script.stem == _NAME and script.is_file():
            return script
    return None


def _short(program: Path) -> str:
    """Relative to the working directory where it lies in a folder below it, absolute elsewhere."""
    whole, here = Path(os.path.abspath(program)), Path.cwd()  # noqa: PTH100 - a link is not followed out of its environment
    return str(whole.relative_to(here)) if here in whole.parent.parents else str(whole)
