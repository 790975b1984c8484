"""ffmap cache: what the caches of odometries and of compiled code hold, clearing them, and compiling all that a run needs."""

import os
import tempfile
import time
from datetime import datetime
from pathlib import Path

import typer

from ffmap.app import compiled_code
from ffmap.app.commands import run as run_command
from ffmap.app.commands.simulate import simulate
from ffmap.app.run import odometry_cache
from ffmap.app.run.start import Arguments
from ffmap.app.tables import make_table, table_console
from ffmap.app.user_cache import user_cache
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

_UNKNOWN = "(kept by an earlier version)"


_DRIVE = {"building": "office", "seed": 1, "duration_s": 4.0}
"""A drive that is simulated and run on, for its code to be compiled."""


def cache(clear: bool) -> None:
    """Show every odometry that is kept and how much compiled code, or remove all that this version does not need."""
    found = odometry_cache.clear() if clear else odometry_cache.entries()
    total = f"{len(found)} odometries, {_megabytes(sum(entry.size_bytes for entry in found))}"
    if clear:
        typer.echo(f"{odometry_cache.cache_folder()}: removed {total}")
        typer.echo(f"compiled code of other versions: removed {_megabytes(compiled_code.clear_others())}")
        return
    if found:
        rows = (
            (
                f"{datetime.fromtimestamp(entry.used_s):%Y-%m-%d %H:%M}",
                entry.bag or _UNKNOWN,
                _megabytes(entry.size_bytes),
            )
            for entry in found
        )
        table_console().print(make_table(None, ("last used", "bag", "size"), rows, left=(0, 1)))
    typer.echo(
        f"{odometry_cache.cache_folder()}: {total}; above {_megabytes(odometry_cache.LIMIT_BYTES)} what was not used for "
        "longest goes. Remove all: ffmap cache --clear"
    )
    folders = compiled_code.folders()
    compiled = _megabytes(sum(compiled_code.size_bytes(folder) for folder in folders))
    typer.echo(f"compiled code: {compiled}, of {len(folders)} versions; in {os.environ.get(compiled_code.VARIABLE)}")


def warm(workers: int) -> None:
    """Compile all that a run needs, by one that is thrown away. Raises InputError where what is compiled cannot be kept."""
    if not compiled_code.is_kept():
        raise InputError(
            f"compiled code cannot be kept in {user_cache()}; set {compiled_code.VARIABLE} to a folder that can be written"
        )
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="ffmap-") as folder:
        os.environ[odometry_cache.CACHE_VARIABLE] = folder
        bag = Path(folder) / "drive.bag"
        simulate(bag, _DRIVE)
        run_command.run(Arguments(bag=BagPath((bag,)), out=Path(folder) / "run", workers=workers, quiet=True), None)
    compiled = Path(os.environ[compiled_code.VARIABLE])
    size = _megabytes(compiled_code.size_bytes(compiled))
    typer.echo(f"{compiled}: {size} of compiled code, after {time.monotonic() - started:.0f} s")


def _megabytes(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:,.1f} MB"
