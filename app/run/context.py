"""What every stage of a run has at hand, and what the run gathers for run.json."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from ffmap.app.folder.names import RunFolder
from ffmap.app.progress import Progress
from ffmap.app.record.log import Log
from ffmap.app.record.stream import Recording
from ffmap.app.setup.inputs import Inputs, check_failed, total_digest
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.scans import SkippedScan


@dataclass
class RunState:
    """What a run gathers for run.json.

    statistics: Table I of the paper. clouds: the digest of all clouds of each topic that was read to its end, by topic.
    tracebacks: of the exceptions that scans' data raised, one for each reason.
    labels_digest: see `LabelsWriter.digest`; empty where nothing was labelled. topology: rooms and passages.
    """

    started: float = field(default_factory=time.perf_counter)
    timings_s: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    counts: dict[str, Any] = field(default_factory=dict)
    statistics: dict[str, Any] = field(default_factory=dict)
    odometry_cached: bool = False
    clouds: dict[str, str] = field(default_factory=dict)
    tracebacks: dict[str, str] = field(default_factory=dict)
    labels_digest: str = ""
    topology: dict[str, Any] = field(default_factory=dict)

    def gathered(self, record: dict[str, Any]) -> dict[str, Any]:
        """As it stands in run.json; record: what that held at the start."""
        total_s = time.perf_counter() - self.started
        told = ("counts", "statistics", "warnings", "odometry_cached", "tracebacks", "labels_digest", "topology")
        return {
            "bag": self.bag_as_read(record),
            "timings_s": {name: round(s, 3) for name, s in (self.timings_s | {"total": total_s}).items()},
            **{name: getattr(self, name) for name in told},
        }

    def bag_as_read(self, record: dict[str, Any]) -> dict[str, Any]:
        """What run.json says of the bag: with the digest of what was read of it, once all of that is known."""
        bag: dict[str, Any] = {**record["bag"], "clouds": self.clouds}
        read_whole = bag["stamps"].keys() == self.clouds.keys()
        return {**bag, "digest": total_digest(self.clouds)} if read_whole else bag


@dataclass(frozen=True)
class Run:
    """A run under way.

    resumed: whether results of an earlier start may be in its folder.
    recording, log: None where none is wanted.
    """

    inputs: Inputs
    settings: Settings
    options: RunOptions
    folder: RunFolder
    progress: Progress
    record: dict[str, Any]
    recording: Recording | None
    log: Log | None
    state: RunState
    resumed: bool

    def warn(self, text: str) -> None:
        """Tell the user now, and again in run.json."""
        self.state.warnings.append(text)
        self.progress.warn(text)

    def keep_failed(self, failed: Sequence[SkippedScan], scans: int, what: str) -> None:
        """Keep the tracebacks of the scans that failed so far; raises InputError where they are too many."""
        for scan in failed:
            self.state.tracebacks.setdefault(scan.reason, scan.trace)
        check_failed(self.inputs.bag_path, failed, scans, what)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure how long a stage takes."""
        started = time.perf_counter()
        yield
        self.state.timings_s[name] = time.perf_counter() - started
