"""A process of the real viewer without a display: it saves what a run sends."""

import os
import re
import signal
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import rerun as rr
from rerun.chunk import RrdReader

from ffmap.app.record.stream import check_viewer, free_port

WAITS_S = 60.0


@dataclass(frozen=True)
class Receiver:
    """path: what was received, a recording that grows."""

    url: str
    path: Path
    process: subprocess.Popen[bytes]

    def end(self) -> None:
        """Kill it and its children: `rerun` is a script that starts the viewer."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def holds(self, recording: Path) -> bool:
        """Wait until it received all of a recording; return whether it received no more."""
        sent, end = content(recording), time.monotonic() + WAITS_S
        while (received := content(self.path)) != sent and time.monotonic() < end:
            time.sleep(0.1)
        return received == sent


@contextmanager
def receiving(path: Path) -> Iterator[Receiver]:
    """Start a viewer that saves to a path."""
    port = free_port()
    command = [
        sys.executable,
        "-m",
        "rerun",
        "--save",
        str(path),
        "--bind",
        "127.0.0.1",
        "--port",
        str(port),
    ]
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    receiver = Receiver(f"rerun+http://127.0.0.1:{port}/proxy", path, process)
    try:
        end = time.monotonic() + WAITS_S
        while True:
            try:
                check_viewer(receiver.url)
                break
            except ConnectionError:
                assert process.poll() is None
                assert time.monotonic() < end
                time.sleep(0.05)
        yield receiver
    finally:
        receiver.end()


def content(path: Path) -> Counter[tuple[str, str]]:
    """Number of rows of each entity on each timeline."""
    rows: Counter[tuple[str, str]] = Counter()
    reader = _reader(path)
    for entry in reader.recordings() if reader else ():
        for chunk in reader.stream(store=entry):
            for timeline in chunk.timeline_names or ["static"]:
                rows[chunk.entity_path, timeline] += chunk.num_rows
    return rows


def layouts(path: Path) -> dict[str, list[str]]:
    """The names of each layout's views, by the layout's id."""
    found, reader = {}, _reader(path)
    for entry in reader.blueprints() if reader else ():
        columns = [chunk.to_record_batch().to_pydict() for chunk in reader.stream(store=entry)]
        names = [name for own in columns for (name,) in own.get("ViewBlueprint:display_name", [])]
        found[str(entry.recording_id)] = sorted(map(str, names))
    return found


def shown(path: Path) -> list[str]:
    """The names of the views of the layout that was activated last."""
    command = [sys.executable, "-m", "rerun", "rrd", "print", str(path)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    *_, last = re.findall(
        r'BlueprintActivationCommand\(StoreId\(\w+, "\w+", "(\w+)"\), make_active: true', printed
    )
    return layouts(path)[last]


def _reader(path: Path) -> RrdReader | None:
    with warnings.catch_warnings():
        # A recording that has not ended has no footer.
        warnings.simplefilter("ignore", rr.error_utils.RerunWarning)
        return RrdReader(path) if path.exists() and path.stat().st_size else None
