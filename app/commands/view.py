"""ffmap view: runs and single recordings in the Rerun viewer, laid out for what they are."""

import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from urllib.parse import quote

import psutil
import typer

from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.map_files import read_map
from ffmap.app.folder.names import EVALUATION, RECORDING, RUN_JSON, map_file
from ffmap.app.own_command import has_display, own_command
from ffmap.app.record.stream import free_port, open_part
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from ffmap.loaders.errors import InputError

LOOPBACK = "127.0.0.1"
_RERUN = (sys.executable, "-m", "rerun")


def view(places: Sequence[Path], web: bool = False) -> None:
    """Open them and wait until the viewer is closed; raises InputError where there is nothing to see, or no display.

    web: serve them to a browser instead, until the user ends it.
    """
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
        if web:
            _serve(files)
        else:
            _open(files, places)


def _open(files: Sequence[Path], places: Sequence[Path]) -> None:
    if not has_display():
        raise InputError(f"there is no display here; {_elsewhere(places)}")
    command = [*_RERUN, "--bind", LOOPBACK, "--port", str(free_port()), "--hide-welcome-screen"]
    try:
        done = subprocess.run([*command, *map(str, files)], stderr=subprocess.PIPE, check=False)
    except KeyboardInterrupt:
        return
    if done.returncode:
        reason = _reason(done.stderr, done.returncode)
        raise InputError(f"the Rerun viewer did not start ({reason}); {_elsewhere(places)}")


def _reason(stderr: bytes, code: int) -> str:
    """The last line of what a program said."""
    return (stderr.decode(errors="replace").strip().splitlines() or [f"exit code {code}"])[-1]


def _elsewhere(places: Sequence[Path]) -> str:
    """How the same is seen without a window here."""
    words = " ".join(shlex.quote(str(place)) for place in places)
    version = metadata.version("rerun-sdk")
    files = " ".join(shlex.quote(str(file.resolve())) for place in places for file in files_of(place))
    return (
        f"'{own_command()} view --web {words}' serves it to a browser, or open {files} on another machine with "
        f"rerun {version} (pip install rerun-sdk=={version})"
    )


def _serve(files: Sequence[Path]) -> None:
    """Rerun's web viewer and what it shows, for browsers on this machine, until the user ends it.

    Raises InputError where it does not start. Rerun's `serve_web_viewer` would listen on every address of the machine.
    """
    data_port, page_port = free_port(), free_port()
    # All that is sent waits in memory for a browser to come, and beyond the limit the oldest would be lost.
    megabytes = 1024 + 4 * sum(file.stat().st_size for file in files) // 1_000_000
    ports = ["--bind", LOOPBACK, "--port", str(data_port), "--web-viewer-port", str(page_port)]
    command = [*_RERUN, "--serve-web", *ports, "--server-memory-limit", f"{megabytes}MB", *map(str, files)]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with tempfile.TemporaryFile() as log, subprocess.Popen(command, stdout=log, stderr=log) as server:
        try:
            while not (_listens(data_port) and _listens(page_port)):
                if server.poll() is not None:
                    log.seek(0)
                    raise InputError(f"Rerun's web viewer did not start ({_reason(log.read(), server.returncode)})")
                time.sleep(0.05)
            source = quote(f"rerun+http://{LOOPBACK}:{data_port}/proxy", safe="")
            tunnel = " ".join(f"-L {port}:{LOOPBACK}:{port}" for port in (page_port, data_port))
            typer.echo(
                f"open in a browser on this machine:  http://{LOOPBACK}:{page_port}/?url={source}\n"
                f"on another, run this there before:  ssh -N {tunnel} {socket.gethostname()}\n"
                "Ctrl-C ends it"
            )
            server.wait()
        except KeyboardInterrupt:
            typer.echo("ended")
        finally:
            # What listens is a child of the Python that started it.
            with suppress(psutil.NoSuchProcess):
                started = psutil.Process(server.pid)
                for process in (*started.children(recursive=True), started):
                    process.terminate()


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((LOOPBACK, port)) == 0


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
            raise InputError(
                f"{run.path}: is a copy of another of these runs, which the viewer cannot tell apart; leave it out"
            )
        written[identity] = folder / f"{number}.rrd"
        with open_part(written[identity], identity, layout) as stream:
            stream.send_recording_name(run.name)
    return list(written.values())


def files_of(place: Path) -> list[Path]:
    """What the viewer opens: for a run its errors last, whose layout then holds; a recording itself."""
    if place.is_file():
        if place.suffix not in (".rrd", ".rbl"):
            raise InputError(f"{place}: is no recording; give a run's folder or a .rrd")
        return [place]
    if not place.exists():
        raise InputError(f"{place}: no such folder or file; give a run's folder or a .rrd")
    if not (place / RUN_JSON).exists():
        raise InputError(f"{place}: is no run; 'ffmap runs DIR' lists those in a folder")
    files = [place / name for name in (RECORDING, EVALUATION) if (place / name).exists()]
    if place / RECORDING not in files:
        raise InputError(f"{place}: has no {RECORDING}; it was run without, make it again with 'ffmap run'")
    return files
