"""ffmap view: runs, sweeps and single recordings in the Rerun viewer, laid out for what they are."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import typer

from app import sweep_files
from app.recording import free_port
from app.run_folder import EVALUATION, RECORDING, RUN_JSON
from loaders.errors import InputError


def view(places: Sequence[Path]) -> None:
    """Open them and wait until the viewer is closed; raises InputError where there is nothing to see."""
    files = [file for place in places for file in files_of(place)]
    if len(places) > 1:
        typer.echo("the list at the left of the viewer (first button at the top right) changes from one to the other")
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", "--port", str(free_port()), "--hide-welcome-screen"]
    try:
        done = subprocess.run([*command, *map(str, files)], stderr=subprocess.PIPE, check=False)
    except KeyboardInterrupt:
        return
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        raise InputError(
            f"the Rerun viewer did not start ({said[-1] if said else f'exit code {done.returncode}'}); is there a display? "
            "'ffmap serve DIR' lets a viewer on another machine see the runs"
        )


def files_of(place: Path) -> list[Path]:
    """What the viewer opens: for a run its errors first, whose layout then holds; a sweep's drawing; a recording itself."""
    if place.is_file():
        if place.suffix not in (".rrd", ".rbl"):
            raise InputError(f"{place}: is no recording; give a run's folder, a sweep's, or a .rrd")
        return [place]
    if (place / sweep_files.RECORDING).exists():
        return [place / sweep_files.RECORDING]
    if not (place / RUN_JSON).exists():
        raise InputError(f"{place}: is no run and no sweep; 'ffmap runs DIR' lists those in a folder")
    files = [place / name for name in (EVALUATION, RECORDING) if (place / name).exists()]
    if place / RECORDING not in files:
        raise InputError(f"{place}: has no {RECORDING}; it was run without, make it again with 'ffmap run'")
    return files
