"""ffmap cache: what the cache of odometries holds, and clearing it."""

from datetime import datetime

import typer
from rich.table import Table

from ffmap.app.run import odometry_cache
from ffmap.app.tables import table_console


def cache(clear: bool) -> None:
    """Show every odometry that is kept, or remove them all."""
    found = odometry_cache.clear() if clear else odometry_cache.entries()
    total = f"{len(found)} odometries, {_megabytes(sum(entry.size_bytes for entry in found))}"
    if clear:
        typer.echo(f"{odometry_cache.cache_folder()}: removed {total}")
        return
    if found:
        table = Table("last used", "bag")
        table.add_column("size", justify="right")
        for entry in found:
            used = f"{datetime.fromtimestamp(entry.used_s):%Y-%m-%d %H:%M}"
            table.add_row(used, entry.bag or "(kept by an earlier version)", _megabytes(entry.size_bytes))
        table_console().print(table)
    typer.echo(
        f"{odometry_cache.cache_folder()}: {total}; above {_megabytes(odometry_cache.LIMIT_BYTES)} what was not used for "
        "longest goes. Remove all: ffmap cache --clear"
    )


def _megabytes(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:,.1f} MB"
