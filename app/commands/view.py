"""ffmap view: runs and single recordings in the Rerun viewer."""

import os
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

import typer

from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.map_files import read_map
from ffmap.app.folder.names import EVALUATION, RECORDING, RUN_JSON, SPOOL, map_file
from ffmap.app.own_command import has_display, own_command
from ffmap.app.record.stream import free_port, listens, open_part
from ffmap.blueprints import run as run_blueprint
from ffmap.blueprints.entities import FURNITURE_FREE
from ffmap.loaders.errors import InputError

LOOPBACK = "127.0.0.1"
_RERUN = (sys.executable, "-m", "rerun")


def view(places: Sequence[Path], web: bool = False) -> None:
    """Open runs and recordings, and wait until the viewer is closed.

    web: serve them to a browser instead, until the user stops it.
    Raises InputError if there is nothing to open, or no display.
    """
    files = [file for place in places for file in files_of(place)]
    runs = [open_run(place) for place in places if (place / RUN_JSON).exists()]
    with tempfile.TemporaryDirectory(prefix="ffmap-view-") as folder:
        if len(runs) > 1:
            # The viewer uses the layout of the last file.
            files += write_common_layout(runs, Path(folder))
            typer.echo("The list on the left has these runs:")
            for run in runs:
                typer.echo(f"  {run.record.recording_id}  {run.path}")
            typer.echo("'ffmap compare' shows runs side by side, and their differences.")
        if web:
            _serve(files)
        else:
            _open(files, places)


def _open(files: Sequence[Path], places: Sequence[Path]) -> None:
    if not has_display():
        raise InputError(f"no display found; {_elsewhere(places)}")
    options = ["--bind", LOOPBACK, "--port", str(free_port()), "--hide-welcome-screen"]
    command = [*_RERUN, *options, *map(str, files)]
    try:
        done = subprocess.run(command, stderr=subprocess.PIPE, check=False)
    except KeyboardInterrupt:
        return
    if done.returncode:
        reason = _reason(done.stderr, done.returncode)
        raise InputError(f"the Rerun viewer did not start ({reason}); {_elsewhere(places)}")


def _reason(stderr: bytes, code: int) -> str:
    """Return the last line that a program printed."""
    return (stderr.decode(errors="replace").strip().splitlines() or [f"exit code {code}"])[-1]


def _elsewhere(places: Sequence[Path]) -> str:
    """Return how to open the same without a window here."""
    command = f"{own_command()} view --web {shlex.join(map(str, places))}"
    version = metadata.version("rerun-sdk")
    files = shlex.join(str(file.resolve()) for place in places for file in files_of(place))
    return (
        f"'{command}' serves it to a browser, or open {files} on another machine with "
        f"rerun {version} (pip install rerun-sdk=={version})"
    )


def _serve(files: Sequence[Path]) -> None:
    """Serve Rerun's web viewer and the files to browsers on this machine, until Ctrl-C.

    Raises InputError if it does not start.
    """
    data_port, page_port = free_port(), free_port()
    # All data waits in memory for a browser; beyond the limit, the oldest would be dropped.
    megabytes = 1024 + 4 * sum(file.stat().st_size for file in files) // 1_000_000
    # The loopback address only: Rerun's `serve_web_viewer` listens on every address.
    ports = ["--bind", LOOPBACK, "--port", str(data_port), "--web-viewer-port", str(page_port)]
    limit = ["--server-memory-limit", f"{megabytes}MB"]
    command = [*_RERUN, "--serve-web", *ports, *limit, *map(str, files)]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with (
        tempfile.TemporaryFile() as log,
        subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True) as server,
    ):
        try:
            while not (listens(data_port) and listens(page_port)):
                if server.poll() is not None:
                    log.seek(0)
                    reason = _reason(log.read(), server.returncode)
                    raise InputError(f"Rerun's web viewer did not start ({reason})")
                time.sleep(0.05)
            source = quote(f"rerun+http://{LOOPBACK}:{data_port}/proxy", safe="")
            tunnel = " ".join(f"-L {port}:{LOOPBACK}:{port}" for port in (page_port, data_port))
            typer.echo(
                f"open in a browser on this machine:  http://{LOOPBACK}:{page_port}/?url={source}\n"
                f"on another, first run there:        ssh -N {tunnel} {socket.gethostname()}\n"
                "Ctrl-C stops it"
            )
            server.wait()
        except KeyboardInterrupt:
            typer.echo("stopped")
        finally:
            # The server is a child of the Python that started it, in the same session.
            with suppress(ProcessLookupError):
                os.killpg(server.pid, signal.SIGTERM)


def write_common_layout(runs: Sequence[FinishedRun], folder: Path) -> list[Path]:
    """Write a recording for each run, with its name and one layout for all runs.

    Raises InputError if two runs are copies of one, which the viewer cannot separate.
    """
    paths = [run.file(map_file(FURNITURE_FREE)) for run in runs]
    layout = run_blueprint.build(
        True,
        *run_blueprint.view_of(*(read_map(path) for path in paths if path is not None)),
        evaluated=any(run.file(EVALUATION) is not None for run in runs),
        scans=any(run.has_scans for run in runs),
        several=True,
        registered=any(run.registered for run in runs),
        lines=any(run.has_lines for run in runs),
    )
    written: dict[str, Path] = {}
    for number, run in enumerate(runs):
        identity = run.record.recording_id
        if identity in written:
            raise InputError(f"{run.path}: is a copy of another of these runs; omit it")
        written[identity] = folder / f"{number}.rrd"
        with open_part(written[identity], identity, layout) as stream:
            stream.send_recording_name(run.name)
    return list(written.values())


def files_of(place: Path) -> list[Path]:
    """Return the files to open; of a run its errors last, for their layout."""
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
        # A run that is under way, or was killed, has the parts of its recording.
        files = sorted((place / SPOOL).glob("*.rrd"))
    if not files:
        raise InputError(f"{place}: has no {RECORDING}; make one with 'ffmap run'")
    return files
