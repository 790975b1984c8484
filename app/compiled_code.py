"""Where Numba keeps compiled code: a folder for each installation and state of its sources, so that none is ever stale.

Numba asks only whether the file of a function is as it was. What the function took from other files is compiled into it:
called functions, constants, classes. So the folder is named after the text of all that compiled code can depend on.
It has to be chosen before Numba is imported.
"""

import atexit
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from ffmap.app.user_cache import CACHE_VARIABLE, user_cache

VARIABLE = "NUMBA_CACHE_DIR"
"""Numba's environment variable. Where the user has set it, that counts."""
SOURCES = (
    "algorithms",
    "loaders/dual_returns.py",
    "loaders/firing_times.py",
    "loaders/pointcloud2.py",
    "loaders/rings.py",
    "app/analysis/bench_floors.py",
)
"""Folders and files that hold compiled functions and what these use."""

_FOLDER = "compiled"
_PACKAGE = Path(__file__).resolve().parents[1]
_INSTALLATION = "installation"
"""A file that says where the program lies whose code a folder holds."""
_KEPT = 2
"""States of one installation whose code is kept: to go back to the state before costs nothing."""
_IN_USE_S = 3600.0
"""Time in seconds after its last start in which a program may still compile into its folder."""
_FORGOTTEN_S = 30 * 24 * 3600.0


def compiled_code() -> dict[str, str]:
    """The environment that lets Numba keep its code where it belongs; empty where the user has chosen a folder."""
    named, name = os.environ.get(VARIABLE), _name(_PACKAGE)
    if named and not _is_ours(Path(named)):
        return {}
    if named and Path(named).name == name:
        return {VARIABLE: named}
    for base in _bases():
        if _prepare(base / name):
            return {VARIABLE: str(base / name)}
    return {VARIABLE: _for_now(name)}


def is_kept() -> bool:
    """Whether later runs find what this process compiles."""
    chosen = Path(os.environ[VARIABLE])
    return not _is_ours(chosen) or chosen.parent in _bases()


def folders() -> list[Path]:
    """Those of all installations and states, the last used first."""
    found = [path for base in _bases() if base.is_dir() for path in base.iterdir() if (path / _INSTALLATION).is_file()]
    return sorted(found, key=_used_s, reverse=True)


def size_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def clear_others() -> int:
    """Remove the code of all installations and states but this one's; returns how many bytes that were."""
    removed = 0
    for folder in folders():
        if folder.name != _name(_PACKAGE):
            removed += size_bytes(folder)
            _remove(folder)
    return removed


def _bases() -> Iterator[Path]:
    """The folders to try, the best first. $FFMAP_CACHE comes last, for it is set for odometries, often to an empty folder."""
    with suppress(RuntimeError):  # where there is no home
        yield user_cache() / _FOLDER
    if named := os.environ.get(CACHE_VARIABLE):
        yield Path(named) / _FOLDER


def _is_ours(folder: Path) -> bool:
    """Whether this program has chosen it, maybe another version that has started this one."""
    return (folder / _INSTALLATION).is_file()


def _name(package: Path) -> str:
    """The name of the folder for an installation as its sources are now."""
    state = hashlib.sha256()
    for source in SOURCES:
        place = package / source
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            text = file.read_bytes()
            state.update(f"{file.relative_to(package)}\0{len(text)}\0".encode() + text)
    return f"{_prefix(package)}{state.hexdigest()[:16]}"


def _prefix(package: Path) -> str:
    return hashlib.sha256(os.fsencode(package)).hexdigest()[:8] + "-"


def _prepare(folder: Path) -> bool:
    """Make a folder, and room for it; whether code can be kept there."""
    note = folder / _INSTALLATION
    try:
        if not note.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            note.write_text(str(_PACKAGE), "utf-8")
            _prune(folder.parent)
        tempfile.TemporaryFile(dir=folder).close()
        os.utime(note)
    except OSError:
        return False
    return True


def _prune(base: Path) -> None:
    """Remove what is used no more: older states of this installation, and all of those that are gone or forgotten."""
    own = 0
    for folder in folders():
        if folder.parent != base:
            continue
        own += folder.name.startswith(_prefix(_PACKAGE))
        unused_s = time.time() - _used_s(folder)
        superseded = folder.name.startswith(_prefix(_PACKAGE)) and own > _KEPT
        if unused_s > _IN_USE_S and (superseded or unused_s > _FORGOTTEN_S or _is_gone(folder)):
            _remove(folder)


def _is_gone(folder: Path) -> bool:
    """Whether the program whose code it holds lies no more where it did."""
    try:
        return not Path((folder / _INSTALLATION).read_text("utf-8")).exists()
    except (OSError, ValueError):
        return True


def _used_s(folder: Path) -> float:
    """When a program last started with it, in seconds since 1970; 0 where another has just removed it."""
    try:
        return (folder / _INSTALLATION).stat().st_mtime
    except OSError:
        return 0.0


def _remove(folder: Path) -> None:
    """Who uses it yet compiles again what it misses."""
    shutil.rmtree(folder, ignore_errors=True)


def _for_now(name: str) -> str:
    """A folder for this process and those that it starts, for where none can be kept."""
    folder = Path(tempfile.mkdtemp(prefix="ffmap-")) / name
    folder.mkdir()
    (folder / _INSTALLATION).write_text(str(_PACKAGE), "utf-8")
    atexit.register(shutil.rmtree, folder.parent, ignore_errors=True)
    return str(folder)
