"""ffmap demo: simulate a small building and map it."""

import time
from pathlib import Path

import typer

from ffmap.app.commands import run as run_command
from ffmap.app.commands.simulate import simulate
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.names import RUN_JSON, require_writable
from ffmap.app.own_command import own_command, view_command
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

SECONDS = 16.0


def demo(out: Path) -> None:
    """Simulate `out`/small.bag, map it in `out`/run, and print the command that views it.

    Raises InputError if `out` cannot be written, or holds another bag of this name.
    """
    started = time.monotonic()
    require_writable(out, "give another folder to --out")
    bag, run = out / "small.bag", out / "run"
    if bag.exists():
        # Only a bag of an earlier demonstration is replaced.
        if not (run / RUN_JSON).exists() or open_run(run).bag_path != BagPath((bag.resolve(),)):
            raise InputError(f"{bag}: exists already; remove it, or give another folder to --out")
        bag.unlink()
    typer.echo(f"simulating {SECONDS:.0f} s of driving in a small furnished building ...")
    simulate(bag, {"building": "small", "seed": 3, "duration_s": SECONDS})
    typer.echo("labelling every scan, mapping the building, recording every intermediate ...")
    run_command.run(BagPath((bag,)), Settings(), RunOptions(), out=run, overwrite=True)
    typer.echo(f"\ndone in {time.monotonic() - started:.0f} s. Look at every scan, step by step:\n")
    typer.echo(f"    {view_command(run)}\n")
    command = own_command()
    typer.echo(f"Your own bag: '{command} run BAG'; '{command} info BAG' lists what it lacks.")
