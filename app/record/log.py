"""Write access to a recording: a stream, the current time, and the detail of a run."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.scan import IntArray
from ffmap.app.record.shapes import markdown
from ffmap.app.record.stream import open_part
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints.entities import LINE_TIMELINE, SCAN_TIMELINE, STAMP_TIMELINE, Color

_RECORDED_AS: dict[str, np.dtype[Any]] = {
    "d": np.dtype(np.float32),
    "l": np.dtype(np.int32),
    "?": np.dtype(np.uint8),
}
"""Types of evidence in the recording, by numpy's character codes of 64-bit numbers and booleans."""


@dataclass(frozen=True)
class Log:
    """A stream to log into; the first argument of every function that logs.

    detail: how much of each scan is logged.
    timeless: data of a scan is static, as in a recording of one scan.
    scan_stamps_ns: (n,) of the vertical clouds in the bag; None without vertical clouds. With
        them, data of a horizontal scan also has an index on the timeline `scan`: the first
        vertical cloud that is not older, or the last one.
    """

    stream: rr.RecordingStream
    detail: Detail = Detail.LINES
    timeless: bool = False
    scan_stamps_ns: IntArray | None = None

    def at(self, stamp_ns: int, index: int | None = None) -> None:
        """Set the time and the scan of the next rows."""
        self.stream.reset_time()
        self.stream.set_time(STAMP_TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))
        if index is not None:
            self.stream.set_time(SCAN_TIMELINE, sequence=index)

    def at_line(self, line: int) -> None:
        """Set the point line of the next rows, in a recording of one scan."""
        self.stream.reset_time()
        self.stream.set_time(LINE_TIMELINE, sequence=line)

    def now(self, path: str, *values: rr.AsComponents) -> None:
        """Log at the time that is set."""
        self.stream.log(path, *values, static=self.timeless)

    def static(self, path: str, *values: rr.AsComponents) -> None:
        """Log data that holds for the whole recording."""
        self.stream.log(path, *values, static=True)

    def message(self, text: str, stamp_ns: int, index: int | None = None) -> None:
        """Log a warning at a scan or time."""
        self.at(stamp_ns, index)
        self.now("/messages", rr.TextLog(text, level=rr.TextLogLevel.WARN))

    def text(self, path: str, text: str) -> None:
        """Log Markdown that holds for the whole recording."""
        self.static(path, markdown(text))

    def curve_style(self, path: str, name: str, color: Color) -> None:
        """Set the colour and the name in the legend of a curve."""
        self.static(path, rr.SeriesLines(colors=color, names=name, widths=1.5))

    def curve(self, path: str, indexes: list[rr.TimeColumn], values: npt.ArrayLike) -> None:
        """Log the values of a curve, one for each time."""
        self.stream.send_columns(path, indexes, rr.Scalars.columns(scalars=values))

    def columns(self, path: str, stamp_ns: IntArray, columns: rr.ComponentColumnList) -> None:
        """Log one row for each horizontal scan."""
        if not len(stamp_ns):
            return
        scan = None
        if self.scan_stamps_ns is not None and len(self.scan_stamps_ns):
            # The highest stamp up to each cloud, because a clock may step back.
            reached_ns = np.maximum.accumulate(self.scan_stamps_ns)
            scan = np.searchsorted(reached_ns, stamp_ns).clip(max=len(reached_ns) - 1)
        self.stream.send_columns(path, times(stamp_ns, scan), columns)


@contextmanager
def open_log(
    path: Path,
    recording_id: str,
    detail: Detail = Detail.LINES,
    layout: rrb.Blueprint | None = None,
) -> Iterator[Log]:
    """Open a log into a recording file, or a part of one, see `open_part`."""
    with open_part(path, recording_id, layout) as stream:
        yield Log(stream, detail)


def times(stamp_ns: npt.ArrayLike, index: Iterable[int] | None = None) -> list[rr.TimeColumn]:
    """Return the times of rows on `stamp`, and on `scan` if their scans are given."""
    stamps = np.asarray(stamp_ns).astype("datetime64[ns]")
    columns = [rr.TimeColumn(STAMP_TIMELINE, timestamp=stamps)]
    if index is not None:
        columns.append(rr.TimeColumn(SCAN_TIMELINE, sequence=index))
    return columns


def evidence(answer: object = None, *names: str, **columns: npt.NDArray[Any]) -> rr.AnyValues:
    """Return arrays to log beside an archetype.

    names: fields of answer, logged under their own names. columns: further arrays by name.
    """
    arrays = {name: getattr(answer, name) for name in names} | columns
    return rr.AnyValues(**{name: _typed(values) for name, values in arrays.items()})


def _typed(values: npt.NDArray[Any]) -> pa.Array:
    """Return an array with the same type in every process, even if it is empty."""
    recorded_as = _RECORDED_AS.get(values.dtype.char, values.dtype)
    flat = pa.array(values.astype(recorded_as, copy=False).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if values.ndim == 2 else flat
