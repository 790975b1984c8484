"""ffmap view: runs, sweeps and single recordings in the Rerun viewer, laid out for what they are."""

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import typer

from app import sweep_files
from app.finished_run import FinishedRun, open_run
from app.map_files import read_map
from app.recording import free_port, open_part
from app.run_folder import EVALUATION, RECORDING, RUN_JSON, map_file
from blueprints import entities
from blueprints import run as run_blueprint
from loaders.errors import InputError


def view(places: Sequence[Path]) -> None:
    """Open them and wait until the viewer is closed; raises InputError where there is nothing to see."""
    files = [file for place in places for file in files_of(place)]
    runs = [open_run(place) for place in places if (place / RUN_JSON).exists()]
    with tempfile.TemporaryDirectory(prefix="ffmap-view-") as folder:
        if len(runs) > 1:
            # Of several files the viewer takes the layout of the last.
            files += write_common_layout(runs, Path(folder))
            typer.echo("the list at the left has the runs, by their names once they are shown:")
            for run in runs:
                typer.echo(f"  {run.record.get('recording_id')}  {run.path}")
            typer.echo("'ffmap compare' shows runs side by side, and what differs")
        _open(files)


def _open(files: Sequence[Path]) -> None:
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


def write_common_layout(runs: Sequence[FinishedRun], folder: Path) -> list[Path]:
    """For each of several runs a recording to open with it: its name, and one layout with what any of them has.

    The viewer has one layout for all runs, which would be that of the last. Raises InputError where two are copies of
    one, which the viewer would show as one.
    """
    maps = [read_map(path) for run in runs if (path := run.file(map_file(entities.FURNITURE_FREE))) is not None]
    centre_m, extent_m = run_blueprint.view_of(*maps)
    layout = run_blueprint.build(
        centre_m=centre_m,
        extent_m=extent_m,
        evaluated=any(run.file(EVALUATION) is not None for run in runs),
        scans=any(run.has_scans for run in runs),
        several=True,
        registered=any(run.registered for run in runs),
        lines=any(run.has_lines for run in runs),
    )
    written: dict[str, Path] = {}
    for number, run in enumerate(runs):
        identity = str(run.record.get("recording_id"))
        if identity in written:
            raise InputError(f"{run.path}: is a copy of another of these runs, which the viewer cannot tell apart; leave it out")
        written[identity] = folder / f"{number}.rrd"
        with open_part(written[identity], identity) as stream:
            stream.send_blueprint(layout, make_active=True, make_default=True)
            stream.send_recording_name(run.name)
    return list(written.values())


def files_of(place: Path) -> list[Path]:
    """What the viewer opens: for a run its errors last, whose layout then holds; a sweep's drawing; a recording itself."""
    if place.is_file():
        if place.suffix not in (".rrd", ".rbl"):
            raise InputError(f"{place}: is no recording; give a run's folder, a sweep's, or a .rrd")
        return [place]
    if not place.exists():
        raise InputError(f"{place}: no such folder or file; give a run's folder, a sweep's, or a .rrd")
    if (place / sweep_files.RECORDING).exists():
        return [place / sweep_files.RECORDING]
    if not (place / RUN_JSON).exists():
        raise InputError(f"{place}: is no run and no sweep; 'ffmap runs DIR' lists those in a folder")
    files = [place / name for name in (RECORDING, EVALUATION) if (place / name).exists()]
    if place / RECORDING not in files:
        raise InputError(f"{place}: has no {RECORDING}; it was run without, make it again with 'ffmap run'")
    return files
