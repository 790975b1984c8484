"""What a run shows while it works: progress, warnings, run.json, the recording."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ffmap.algorithms.maps.grid import GridMap
from ffmap.app.folder.names import RECORDING
from ffmap.app.folder.record import write_record
from ffmap.app.folder.run_folder import written_files
from ffmap.app.progress import Progress
from ffmap.app.record.log import Log
from ffmap.app.record.stream import Recording, send_properties
from ffmap.app.record.whole_run import explain, layout, log_own_body, log_static, log_warnings
from ffmap.app.run.start import Run
from ffmap.app.setup.inputs import Inputs, commonest
from ffmap.app.setup.outputs import Output
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import SkippedScan

_FAILED_SHARE_MAX = 0.2
"""Maximum share of scans that may fail; with more, the bag or the options are wrong."""
_PROPERTIES = ("settings_hash", "bag", "versions", "started")
"""Values of run.json that are properties of the recording from its start."""
_RESULT = ("timings_s", "counts", "odometry_cached", "labels_digest", "topology", "outcome")
"""Values of run.json that become properties at the end."""


class Report:
    """The observer of a run; stages receive it, and results do not depend on it.

    record: content of run.json so far. log: None where nothing is recorded.
    tracebacks: of scans that failed, one for each reason.
    """

    def __init__(self, run: Run, progress: Progress) -> None:
        self.progress = progress
        self.record = run.record
        self.log: Log | None = None
        self._run = run
        self._recording: Recording | None = None
        self._warnings = list(run.inputs.warnings)
        self._tracebacks: dict[str, str] = {}
        self._seconds: dict[str, float] = {}
        self._started, self._cpu = time.perf_counter(), time.process_time()

    def add(self, **values: Any) -> None:  # noqa: ANN401 - values of a RunRecord
        """Add values to run.json, which is written by `write` and `finish`."""
        self.record = self.record.model_copy(update=values)

    def write(self) -> None:
        """Write run.json."""
        write_record(self._run.folder, self.record)

    def count(self, **counts: Any) -> None:  # noqa: ANN401 - numbers, or numbers by name
        """Add to the counts in run.json."""
        self.add(counts=self.record.counts | counts)

    def warn(self, text: str) -> None:
        """Keep a warning for run.json, and show it."""
        self._warnings.append(text)
        self.progress.warn(text)

    def check_failed(self, failed: Sequence[SkippedScan], scans: int, what: str) -> None:
        """Keep the tracebacks of failed scans. Raises InputError where too many failed."""
        for scan in failed:
            self._tracebacks.setdefault(scan.reason, scan.trace)
        if len(failed) > _FAILED_SHARE_MAX * scans:
            bag_path, reasons = self._run.inputs.bag_path, Counter(scan.reason for scan in failed)
            why = commonest([scan.reason for scan in failed])
            raise InputError(
                f"{bag_path}: {what} failed for {len(failed)} of {scans} scans so far, "
                f"{reasons[why]} times with {why}; check lidars, transforms and poses ('ffmap info "
                f"{bag_path.words}'); run.json contains the traceback"
            )

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of a stage."""
        started = time.perf_counter()
        yield
        self._seconds[name] = time.perf_counter() - started

    def open_recording(self) -> None:
        """Open the recording, if one is wanted. Raises InputError where the viewer has ended."""
        run, options = self._run, self._run.options
        save = Output.RECORDING in options.outputs
        if not save and options.connect is None:
            return
        try:
            self._recording = Recording(
                run.folder / RECORDING if save else None,
                run.spool,
                self.record.recording_id,
                self._layout(),
                options.connect,
                self.progress.say,
            )
        except ConnectionError as error:
            raise InputError(
                f"{error}: the viewer has ended; is there a display? Omit --spawn or --connect: "
                "the recording can be opened later"
            ) from error
        stamps_ns = run.inputs.scans.stamp_ns if run.inputs.verticals else None
        self.log = Log(self._recording.stream, options.detail, scan_stamps_ns=stamps_ns)

    def log_start(self, inputs: Inputs) -> None:
        """Record the lidars and the settings; a viewer shows the views from then on."""
        if self.log is None:
            return
        extrinsics = {role: s.lidar.T_base_sensor for role, s in inputs.by_role.items()}
        settings = self._run.settings
        slope_max = settings.vertical_structures.slope_max if inputs.verticals else None
        log_static(self.log, extrinsics, explain(self.record.as_json()), slope_max)
        for role, sensor in inputs.by_role.items():
            if (body := sensor.lidar.decoding.own_body) is not None:
                log_own_body(self.log, role, body)
        send_properties(self.log.stream, "settings", settings.model_dump(mode="json"))
        send_properties(self.log.stream, "run", self.record.as_json(*_PROPERTIES))
        self.flush()

    def add_part(self, part: Path) -> None:
        """Add a worker's part to the recording."""
        if self._recording is not None and part.exists():
            self._recording.add(part)
            self.flush()

    def flush(self) -> None:
        """Send what was logged to a viewer, and write it to a file."""
        if self.log is not None and self._recording is not None:
            self.log.send_rows()
            self._recording.flush()

    def show_map(self, grid: GridMap) -> None:
        """Show the whole map when the recording is opened."""
        if self._recording is not None:
            self._recording.set_layout(self._layout(grid))

    def finish(self, outcome: str) -> None:
        """Complete the recording, and write run.json."""
        seconds = self._seconds | {"total": time.perf_counter() - self._started}
        options = self._run.options
        if options.workers == 1 and options.scheduler is None:
            # All of it was the work of this process, whatever else the machine did.
            seconds["cpu"] = time.process_time() - self._cpu
        self.add(
            outcome=outcome,
            timings_s=self.record.timings_s | {n: round(s, 3) for n, s in seconds.items()},
            warnings=tuple(self._warnings),
            tracebacks=self._tracebacks,
        )
        try:
            if self.log is not None and self._recording is not None:
                result = self.record.as_json(*_RESULT) | {"bag_digest": self.record.bag.digest}
                send_properties(self.log.stream, "result", result)
                log_warnings(self.log, self._warnings)
                self.flush()
                self._recording.finish()
        finally:
            self.add(files=written_files(self._run.folder))
            self.write()

    def _layout(self, grid: GridMap | None = None) -> Any:  # noqa: ANN401 - Rerun's blueprint
        verticals, detail = self._run.inputs.verticals, self._run.options.detail
        several = len(verticals) > 1
        record = self.record.as_json()
        return layout(bool(verticals), detail, record, grid, several_lidars=several)
