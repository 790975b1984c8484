"""ffmap rigs: the rigs of public data sets, as a table or as the file of one."""

import typer

from ffmap.app.tables import make_table, table_console
from ffmap.loaders.rig_file import built_in_path, built_in_rigs


def rigs(name: str | None) -> None:
    """List all, or print the file of one; raises InputError where there is none of this name."""
    if name is not None:
        typer.echo(built_in_path(name).read_text(encoding="utf-8"), nl=False)
        return
    known = built_in_rigs()
    rows = [
        (rig.name if lidar is rig.lidars[0] else "", lidar.sensor or "", lidar.topic or "", lidar.frame or "")
        for rig in known
        for lidar in rig.lidars
    ]
    table_console().print(make_table(None, ("name", "lidars", "topics", "frames"), rows, left=range(4)))
    for rig in known:
        typer.echo(f"{rig.name}: {rig.description}; source: {rig.source}")
