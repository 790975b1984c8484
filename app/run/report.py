"""What a run shows while it works: progress, warnings, the time of each stage, the recording."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ffmap.algorithms.base.scan import FloatArray
from ffmap.app.folder.names import RECORDING
from ffmap.app.progress import Progress
from ffmap.app.record.log import Log
from ffmap.app.record.stream import Recording, send_properties
from ffmap.app.record.whole_run import (
    explain,
    layout,
    log_own_body,
    log_static,
    log_warnings,
)
from ffmap.app.run.start import Run
from ffmap.app.setup.inputs import check_failed
from ffmap.app.setup.outputs import Output
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import SkippedScan

_PROPERTIES = ("settings_hash", "bag", "versions", "started")
"""Keys of run.json that are properties of the recording from its start."""
_RESULT = (
    "timings_s",
    "counts",
    "odometry_cached",
    "labels_digest",
    "topology",
    "outcome",
)
"""Keys of run.json that become properties at the end."""


class Report:
    """The observer of a run; stages receive it, and results do not depend on it.

    log: None where nothing is recorded. tracebacks: of scans that failed, one for each reason.
    """

    def __init__(self, run: Run, progress: Progress) -> None:
        """Raises InputError where the viewer has ended."""
        self.progress = progress
        self.warnings = list(run.inputs.warnings)
        self.tracebacks: dict[str, str] = {}
        self.seconds: dict[str, float] = {}
        self._run = run
        self._recording = _open_recording(run, progress)
        self.log: Log | None = None
        if self._recording is not None:
            stamps_ns = run.inputs.scans.stamp_ns if run.inputs.verticals else None
            stream, detail = self._recording.stream, run.options.detail
            self.log = Log(stream, detail, scan_stamps_ns=stamps_ns)

    def warn(self, text: str, show: bool = True) -> None:
        """Keep a warning for run.json, and show it."""
        self.warnings.append(text)
        if show:
            self.progress.warn(text)

    def check_failed(self, failed: Sequence[SkippedScan], scans: int, what: str) -> None:
        """Keep the tracebacks of failed scans. Raises InputError where too many failed."""
        for scan in failed:
            self.tracebacks.setdefault(scan.reason, scan.trace)
        check_failed(self._run.inputs.bag_path, failed, scans, what)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of a stage."""
        started = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - started

    def log_start(self, run: Run) -> None:
        """Record the lidars and the settings; a viewer shows the views from then on."""
        if self.log is None:
            return
        by_role = run.inputs.by_role
        extrinsics: dict[str, FloatArray] = {
            role: sensor.lidar.T_base_sensor for role, sensor in by_role.items()
        }
        labelled = bool(run.inputs.verticals)
        slope_max = run.settings.vertical_structures.slope_max if labelled else None
        log_static(self.log, extrinsics, explain(run.record), slope_max)
        for role, sensor in by_role.items():
            if (body := sensor.lidar.decoding.own_body) is not None:
                log_own_body(self.log, role, body)
        properties = {name: run.record[name] for name in _PROPERTIES if name in run.record}
        send_properties(self.log.stream, "settings", run.settings.model_dump(mode="json"))
        send_properties(self.log.stream, "run", properties)
        self.flush()

    def add_part(self, part: Path) -> None:
        """Add a worker's part to the recording."""
        if self._recording is not None and part.exists():
            self._recording.add(part)

    def flush(self) -> None:
        """Append to the recording's file; a kill loses only later data."""
        if self._recording is not None:
            self._recording.cut()

    def set_layout(self, grid: Any) -> None:  # noqa: ANN401 - GridMap
        """Show the whole map when the recording is opened."""
        if self._recording is not None:
            self._recording.set_layout(_layout(self._run, grid))

    def finish(self, record: Mapping[str, Any]) -> None:
        """Record the result, and complete the recording.

        record: content of run.json.
        """
        if self.log is None or self._recording is None:
            return
        properties = {name: record[name] for name in _RESULT if name in record}
        properties["bag_digest"] = record["bag"].get("digest")
        send_properties(self.log.stream, "result", properties)
        log_warnings(self.log, self.warnings)
        self._recording.finish()


def _open_recording(run: Run, progress: Progress) -> Recording | None:
    save = Output.RECORDING in run.options.outputs
    if not save and run.options.connect is None:
        return None
    try:
        return Recording(
            run.folder.path / RECORDING if save else None,
            run.record["recording_id"],
            _layout(run),
            run.options.connect,
            progress.say,
        )
    except ConnectionError as error:
        raise InputError(
            f"{error}: the viewer has ended; is there a display? Omit --spawn or --connect: the "
            "recording can be opened later"
        ) from error


def _layout(run: Run, grid: Any = None) -> Any:  # noqa: ANN401 - Rerun's blueprint
    several = len(run.inputs.verticals) > 1
    labelled, detail = bool(run.inputs.verticals), run.options.detail
    return layout(labelled, detail, run.record, grid, several_lidars=several)
