"""ffmap cache: what the cache of odometries holds, and clearing it."""

from datetime import datetime

import typer

from ffmap.app.run import odometry_cache
from ffmap.app.tables import make_table, table_console

_UNKNOWN = "(kept by an earlier version)"


def cache(clear: bool) -> None:
    """Show every odometry that is kept, or remove them all."""
    found = odometry_cache.clear() if clear else odometry_cache.entries()
    total = f"{len(found)} odometries, {_megabytes(sum(entry.size_bytes for entry in found))}"
    if clear:
        typer.echo(f"{odometry_cache.cache_folder()}: removed {total}")
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


def _megabytes(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:,.1f} MB"
