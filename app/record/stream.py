"""The recording of a run as a file that grows by parts, and as a stream to a viewer.

Workers and the run's own process write parts: small recordings of the same id. Their bytes are joined as they are, for
to send their content through another stream would decompress and compress all of it again.
"""

import io
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from ffmap.app.folder.atomic import written_whole
from ffmap.app.folder.figures import flatten
from ffmap.blueprints import entities
from ffmap.loaders.errors import InputError

_STREAM_HEADER = struct.Struct("<4s8x")
_MESSAGE_HEADER = struct.Struct("<QQ")
_MAGIC = b"RRF2"
_END = 0
_FOOTER_BYTES = 32
"""What follows the end message's own content: where that lies, and how the stream ends."""
_PIECE_BYTES = 1 << 18
_PARTS_AT_ONCE = 200
_OWN = "own"
_one_at_a_time = threading.RLock()
_STARTS_S, _OPENS_WINDOW_S = 20.0, 1.0
_RERUN = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
"""As the `rerun` command does; `python -m rerun_cli` always ends with 0."""


@contextmanager
def open_part(path: Path, recording_id: str, layout: rrb.Blueprint | None = None) -> Iterator[rr.RecordingStream]:
    """A stream into one part of the recording; the file appears when it is complete. One at a time in a process: others wait.

    layout: how it opens, for a recording of one part alone: files in which a layout and data lie together cannot be joined.
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


def write_layout(path: Path, recording_id: str, layout: rrb.Blueprint) -> None:
    """A part that holds a layout and nothing else."""
    with open_part(path, recording_id, layout):
        pass


@lru_cache(maxsize=1)
def _stream(recording_id: str) -> rr.RecordingStream:
    """One stream serves all parts of a process: Rerun keeps some megabytes of each that there ever was."""
    # A recording has its properties once, from the run's own process.
    return _new_stream(recording_id, send_properties=False)


def _new_stream(recording_id: str, send_properties: bool) -> rr.RecordingStream:
    stream = rr.RecordingStream(
        entities.APPLICATION_ID,
        recording_id=recording_id,
        send_properties=send_properties,
        # Large chunks: fewer of them, and a quarter less time than with the default, which serves a live viewer.
        batcher_config=rr.ChunkBatcherConfig(flush_tick=3600.0, flush_num_bytes=4 << 20, flush_num_rows=1 << 20),
    )
    stream.set_log_time_enabled(False)
    return stream


class Recording:
    """A run's recording: what its own process logs into `stream`, and the parts that workers wrote.

    While the run goes on the file is a stream without a footer, which the viewer opens at any time; `finish` gives it
    the footer that queries need.
    """

    def __init__(
        self,
        path: Path | None,
        spool: Path,
        recording_id: str,
        blueprint: rrb.Blueprint,
        connect_url: str | None = None,
        say: Callable[[str], None] = print,
    ) -> None:
        """path: None where only a viewer is to see it. spool: a folder for this process's own parts.

        connect_url: as `start_viewer` returns it. say: prints a line if the viewer ends before the run.
        Raises ConnectionError if nothing listens there.
        """
        self._viewer: rr.RecordingStream | None = None
        if connect_url is not None:
            check_viewer(connect_url)
            self._viewer = _new_stream(recording_id, send_properties=False)
            self._viewer.connect_grpc(connect_url)
        for stale in spool.glob(f"{_OWN}-*"):
            stale.unlink()
        self._path, self._spool, self._id, self._say = path, spool, recording_id, say
        self._layouts: list[Path] = []
        self._parts: list[Path] = []
        self._own_count = 0
        if path is not None:
            path.unlink(missing_ok=True)
        self.stream = _new_stream(recording_id, send_properties=True)
        self._add_layout(blueprint)
        self.stream.save(self._own)

    @property
    def _own(self) -> Path:
        return self._spool / f"{_OWN}-{self._own_count:05d}.rrd"

    def set_layout(self, blueprint: rrb.Blueprint) -> None:
        """Replace the layout that the recording opens with."""
        self._close_own()
        self._add_layout(blueprint)
        self.stream.save(self._own)

    def _add_layout(self, blueprint: rrb.Blueprint) -> None:
        if self._viewer is not None:
            # Active: a viewer keeps the layout that it has, of this run or of another, if it only gets a new default.
            self._viewer.send_blueprint(blueprint, make_active=True, make_default=True)
        # A part of its own: Rerun's tool refuses to join files in which a layout and data lie together.
        with open_part(self._own, self._id) as stream:
            stream.send_blueprint(blueprint, make_active=False, make_default=True)
        self._append(self._own, self._layouts)
        self._own_count += 1

    def add(self, part: Path) -> None:
        """Append a part that a worker wrote, after all that was logged until now."""
        self.cut()
        self._append(part, self._parts)

    def cut(self) -> None:
        """Append what was logged until now; a kill loses at most what comes later."""
        self._close_own()
        self.stream.save(self._own)

    def finish(self, parts_stay: bool = False) -> None:
        """Complete the file; nothing can be logged any more. parts_stay: for a run that is to be resumed."""
        self._close_own()
        if self._viewer is not None:
            self._viewer.disconnect()
        if self._path is not None and self._parts:
            join(self._layouts, self._parts, self._path, parts_stay)

    def _close_own(self) -> None:
        self.stream.disconnect()
        if self._own.exists() and _content_end(self._own) is not None:
            self._append(self._own, self._parts)
            self._own_count += 1

    def _append(self, part: Path, kind: list[Path]) -> None:
        kind.append(part)
        if self._path is not None:
            with self._path.open("ab") as recording:
                _splice(part, recording)
        if self._viewer is not None:
            reader = RrdReader(part)
            # A part without chunks, and one with a layout alone, has no recording.
            for entry in reader.recordings():
                self._viewer.send_chunks(reader.stream(store=entry))
            try:
                # Without it, what was forwarded piles up in memory.
                self._viewer.flush()
            except RuntimeError:
                # A user who closes the viewer does not mean to end the run.
                self._say("The viewer has ended. The run continues without it.")
                self._viewer = None


def _splice(part: Path, recording: io.BufferedWriter) -> None:
    """Append a part's messages without its end and footer, so that the whole reads as one unfinished stream."""
    end = _content_end(part)
    if end is None:
        return
    with part.open("rb") as source:
        source.seek(0 if recording.tell() == 0 else _STREAM_HEADER.size)
        # In pieces that stay in the processor's cache: a part as a whole takes fresh memory, which costs as much again.
        while (left := end - source.tell()) > 0:
            recording.write(source.read(min(left, _PIECE_BYTES)))


def _content_end(part: Path) -> int | None:
    """Where the messages of a part end; None where it has none. Raises RuntimeError where it is not framed as in Rerun 0.41."""
    if not part.stat().st_size:
        return None
    found = _read_framing(part)
    if found is None:
        raise RuntimeError(f"{part}: is not framed as recordings of Rerun 0.41 are")
    if not found.has_footer:
        raise RuntimeError(f"{part}: ends in the middle of a message")
    return found.position if found.position > _STREAM_HEADER.size else None


@dataclass(frozen=True)
class WholeMessages:
    """How far a recording can be read.

    position: where its last whole message ends. complete: whether nothing follows but a whole footer, if there is one.
    """

    position: int
    complete: bool
    has_footer: bool


def whole_messages(path: Path) -> WholeMessages:
    """How far a recording can be read whose writer may have been killed, or which was cut later.

    Raises InputError where it is no recording, or has no whole message.
    """
    found = _read_framing(path)
    if found is None:
        raise InputError(f"{path}: is no recording of Rerun's; run ffmap again")
    if found.position == _STREAM_HEADER.size:
        raise InputError(f"{path}: was cut before its first message; run ffmap again")
    return found


def _read_framing(path: Path) -> WholeMessages | None:
    """A stream header of 12 bytes, then messages, each after its kind and its length; the kind 0 ends the stream.

    None where there is no such header.
    """
    size = path.stat().st_size
    with path.open("rb") as source:
        header = source.read(_STREAM_HEADER.size)
        if len(header) < _STREAM_HEADER.size or _STREAM_HEADER.unpack(header)[0] != _MAGIC:
            return None
        at = source.tell()
        while True:
            message = source.read(_MESSAGE_HEADER.size)
            kind, length = _MESSAGE_HEADER.unpack(message) if len(message) == _MESSAGE_HEADER.size else (_END, None)
            has_footer = kind == _END and length is not None and source.tell() + length + _FOOTER_BYTES == size
            if kind == _END or source.tell() + length > size:
                return WholeMessages(at, has_footer or at == size, has_footer)
            at = source.seek(length, io.SEEK_CUR)


def join(layouts: Sequence[Path], parts: Sequence[Path], out: Path, parts_stay: bool = True) -> None:
    """One recording with one footer from all parts, none of them decompressed.

    layouts: parts with a layout alone, which Rerun's tool joins with nothing that was joined before. All lie in one folder.
    parts_stay: False lets go of many parts as they are joined, for the disk need not hold them once more.
    """
    (folder,) = {part.parent for part in (*layouts, *parts)}  # relative names keep the command short
    with ExitStack() as joined:
        level = 0
        # With each part the tool copies the index of all before it.
        while len(parts) > _PARTS_AT_ONCE:
            groups = []
            for first in range(0, len(parts), _PARTS_AT_ONCE):
                members, group = parts[first : first + _PARTS_AT_ONCE], folder / f"joined-{level}-{first:06d}.rrd"
                joined.callback(group.unlink, missing_ok=True)
                _route(folder, members, group)
                groups.append(group)
                for member in members if level or not parts_stay else ():
                    member.unlink()
            parts, level = groups, level + 1
        _route(folder, [*layouts, *parts], out)


def _route(folder: Path, parts: Sequence[Path], out: Path) -> None:
    with written_whole(out) as joined:
        command = [sys.executable, "-c", _RERUN, "rrd", "route", "-o", str(joined.resolve())]
        command += [part.name for part in parts]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise OSError(f"{out}: the recording's parts could not be joined: {done.stderr.strip()}")


def start_viewer(files: Sequence[Path] = ()) -> str:
    """Start a viewer that listens on the loopback address only, and return the URL to connect to.

    files: recordings that it opens.

    `rr.spawn` listens on every interface and has no option for it. Raises RuntimeError if the viewer does not start.
    """
    port = free_port()
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", "--port", str(port), "--hide-welcome-screen"]
    command += [str(file.resolve()) for file in files]
    viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    end = time.monotonic() + _STARTS_S
    listens_since: float | None = None
    while time.monotonic() < end and viewer.poll() is None:
        with socket.socket() as probe:
            if listens_since is None and probe.connect_ex(("127.0.0.1", port)) == 0:
                listens_since = time.monotonic()
        # It listens before it opens its window, and ends where it cannot.
        if listens_since is not None and time.monotonic() - listens_since > _OPENS_WINDOW_S:
            return f"rerun+http://127.0.0.1:{port}/proxy"
        time.sleep(0.05)
    viewer.terminate()
    raise RuntimeError("the Rerun viewer did not start; is there a display?")


def free_port() -> int:
    """A port of the loopback address that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def check_viewer(url: str, timeout_s: float = 5.0) -> None:
    """Raise ConnectionError where no viewer listens; Rerun itself would wait for it for ever."""
    address = urlsplit(url)
    try:
        socket.create_connection((address.hostname or "127.0.0.1", address.port or 9876), timeout_s).close()
    except (OSError, ValueError) as error:
        raise ConnectionError(f"no Rerun viewer at {url}: {error}") from error


def send_properties(stream: rr.RecordingStream, name: str, values: Mapping[str, Any]) -> None:
    """Settings, digests, versions, metrics: nested mappings become columns like `wall_planes_similarity_m`."""
    if flat := flatten(values):
        stream.send_property(name, rr.AnyValues(**flat))
