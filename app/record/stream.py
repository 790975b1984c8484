"""The recording of a run as a Rerun stream into a file, to a viewer, or both."""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from ffmap.app.folder.atomic import written_whole
from ffmap.blueprints.entities import APPLICATION_ID
from ffmap.loaders.text_files import dotted_keys

rr.set_strict_mode(True)

_one_at_a_time = threading.RLock()
_RERUN = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
"""`python -m rerun` takes half a second for its imports, `python -m rerun_cli` always returns 0."""
_STARTS_S, _OPENS_WINDOW_S = 20.0, 1.0


class Recording:
    """A run's recording: what its own process logs into `stream`, and the parts from workers.

    A viewer receives everything at once. `finish` writes the file; until then, the spool contains
    its parts, which a viewer can open together.
    """

    def __init__(
        self,
        path: Path | None,
        spool: Path,
        recording_id: str,
        layout: rrb.Blueprint,
        connect_url: str | None = None,
        say: Callable[[str], None] = print,
    ) -> None:
        """Open the recording.

        path: file to write; None for a viewer alone. spool: folder of parts.
        connect_url: of a viewer, see `start_viewer`. say: prints a line if the viewer ends before
        the run.
        Raises ConnectionError if no viewer listens at connect_url.
        """
        self._path, self._id, self._say = path, recording_id, say
        self._viewer: rr.RecordingStream | None = None
        self._parts: list[Path] = []
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if connect_url is not None:
            check_viewer(connect_url)
            sinks.append(rr.GrpcSink(connect_url))
            # The layout and the parts are not written to the own part.
            self._viewer = _new_stream(recording_id, send_properties=False)
            self._viewer.connect_grpc(connect_url)
        if path is not None:
            path.unlink(missing_ok=True)
            self._parts = [spool / "layout.rrd", spool / "own.rrd"]
            sinks.append(rr.FileSink(spool / "own.rrd"))
        self.stream = _new_stream(recording_id, send_properties=True)
        self.stream.set_sinks(*sinks)
        self.set_layout(layout)

    def set_layout(self, layout: rrb.Blueprint) -> None:
        """Replace the layout of the recording."""
        if self._parts:
            write_layout(self._parts[0], self._id, layout)
        if self._viewer is not None:
            # A viewer keeps the layout that it shows if only the default changes.
            self._viewer.send_blueprint(layout, make_active=True, make_default=True)

    def add(self, part: Path) -> None:
        """Add a part from a worker."""
        if self._path is not None:
            self._parts.append(part)
        if self._viewer is not None:
            reader = RrdReader(part)
            # A file without chunks holds no recording.
            for entry in reader.recordings():
                self._viewer.send_chunks(reader.stream(store=entry))

    def flush(self) -> None:
        """Write all logged data."""
        try:
            self.stream.flush()
            if self._viewer is not None:
                self._viewer.flush()
        except RuntimeError:
            # The file is still written: closing the viewer must not end the run.
            if self._viewer is not None:
                self._say("The viewer has ended. The run continues without it.")
            self._viewer = None

    def finish(self) -> None:
        """Complete the recording; nothing can be logged any more."""
        self.flush()
        self.stream.disconnect()
        if self._viewer is not None:
            self._viewer.disconnect()
        if self._path is not None:
            join(self._path, self._parts)


def write_layout(path: Path, recording_id: str, layout: rrb.Blueprint) -> None:
    """Write a part with the layout alone: Rerun cannot join files with both a layout and data."""
    with open_part(path, recording_id, layout):
        pass


def join(out: Path, parts: Sequence[Path]) -> None:
    """Join parts of a recording to one file, by Rerun's tool: nothing is decoded."""
    with written_whole(out) as joined:
        files = [str(path.resolve()) for path in (joined, *parts)]
        command = [sys.executable, "-c", _RERUN, "rrd", "route", "-o", *files]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise OSError(f"{out}: the parts of the recording cannot be joined: {done.stderr}")


@contextmanager
def open_part(
    path: Path, recording_id: str, layout: rrb.Blueprint | None = None
) -> Iterator[rr.RecordingStream]:
    """Open a recording file, or a part of one; the file appears when it is complete.

    A process writes one at a time, other threads wait. layout: how the viewer shows the file.
    """
    with _one_at_a_time, written_whole(path) as part:
        stream = _stream(recording_id)
        stream.save(part)
        try:
            if layout is not None:
                stream.send_blueprint(layout, make_active=True, make_default=True)
            yield stream
        finally:
            stream.disconnect()


@contextmanager
def open_stdout(
    application_id: str, recording_id: str | None, layout: rrb.Blueprint
) -> Iterator[rr.RecordingStream]:
    """Open a recording that is written to standard output, for the viewer that reads it."""
    stream = _new_stream(recording_id, send_properties=True, application_id=application_id)
    stream.stdout()
    stream.send_blueprint(layout, make_active=True, make_default=True)
    try:
        yield stream
    finally:
        stream.disconnect()


@lru_cache(maxsize=1)
def _stream(recording_id: str) -> rr.RecordingStream:
    """Return the stream of all parts of this process: each stream leaves megabytes in Rerun."""
    return _new_stream(recording_id, send_properties=False)


def _new_stream(
    recording_id: str | None, send_properties: bool, application_id: str = APPLICATION_ID
) -> rr.RecordingStream:
    stream = rr.RecordingStream(
        application_id,
        recording_id=recording_id,
        send_properties=send_properties,
        # Large chunks: the defaults serve a live viewer, and cost a quarter more time.
        batcher_config=rr.ChunkBatcherConfig(
            flush_tick=3600.0, flush_num_bytes=4 << 20, flush_num_rows=1 << 20
        ),
    )
    stream.set_log_time_enabled(False)
    return stream


def send_properties(stream: rr.RecordingStream, name: str, values: Mapping[str, Any]) -> None:
    """Send settings, versions or figures as properties of the recording.

    Nested mappings become columns such as `wall_planes_similarity_m`.
    """
    columns: dict[str, Any] = {
        key.replace(".", "_"): value if isinstance(value, str | bool | int | float) else str(value)
        for key, value in dotted_keys(values).items()
        if value is not None
    }
    if columns:
        stream.send_property(name, rr.AnyValues(**columns))


def start_viewer(files: Sequence[Path] = ()) -> str:
    """Start a viewer with these recordings, and return the URL to connect to.

    Raises RuntimeError if the viewer does not start.
    """
    port = free_port()
    # The loopback address only: `rr.spawn` listens on every interface.
    options = ["--bind", "127.0.0.1", "--port", str(port), "--hide-welcome-screen"]
    viewer = subprocess.Popen(
        [sys.executable, "-m", "rerun", *options, *(str(file.resolve()) for file in files)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    end = time.monotonic() + _STARTS_S
    listens_since: float | None = None
    while time.monotonic() < end and viewer.poll() is None:
        if listens_since is None and listens(port):
            listens_since = time.monotonic()
        # The viewer listens before it opens its window, and exits if it cannot.
        if listens_since is not None and time.monotonic() - listens_since > _OPENS_WINDOW_S:
            return f"rerun+http://127.0.0.1:{port}/proxy"
        time.sleep(0.05)
    viewer.terminate()
    raise RuntimeError("the Rerun viewer did not start; is there a display?")


def free_port() -> int:
    """Return a free port of the loopback address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def listens(port: int) -> bool:
    """Return whether a program listens on this port of the loopback address."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def check_viewer(url: str, timeout_s: float = 5.0) -> None:
    """Raise ConnectionError if no viewer listens; Rerun itself would wait without end."""
    address = urlsplit(url)
    try:
        place = address.hostname or "127.0.0.1", address.port or 9876
        socket.create_connection(place, timeout_s).close()
    except (OSError, ValueError) as error:
        raise ConnectionError(f"no Rerun viewer at {url}: {error}") from error
