"""Where recorders write to, and the timelines on which it lies."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.app.record.shapes import markdown, rounded
from ffmap.app.record.stream import open_part
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities

rr.set_strict_mode(True)


class Log:
    """A stream, and when what is logged into it holds. Every recorder's functions take one first."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        detail: Detail = Detail.LINES,
        timeless: bool = False,
        scan_stamps_ns: IntArray | None = None,
    ) -> None:
        """timeless: what is logged of a scan holds throughout, as in a recording of one scan alone.

        scan_stamps_ns: (n,) of the vertical clouds in the bag. With them, what concerns a horizontal scan also lies on the
        timeline `scan`, at the first vertical cloud that is not older, or at the last one: there the viewer shows the same
        as at that cloud's stamp. None where there are no vertical clouds: it lies on `stamp` alone.
        """
        self.stream = stream
        self.detail = detail
        self.timeless = timeless
        self._gathered: list[tuple[int, int, Mapping[str, float]]] = []
        # The highest stamp up to each cloud, for a clock may step back.
        self._scan_reached_ns: IntArray | None = None
        if scan_stamps_ns is not None and len(scan_stamps_ns):
            self._scan_reached_ns = np.maximum.accumulate(scan_stamps_ns)

    def at(self, stamp_ns: int, index: int | None = None) -> None:
        """What is logged next is of this time, and of this scan."""
        self.stream.reset_time()
        self.stream.set_time(entities.STAMP_TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))
        if index is not None:
            self.stream.set_time(entities.SCAN_TIMELINE, sequence=index)

    def now(self, path: str, *values: rr.AsComponents) -> None:
        """Log at the time that is set."""
        self.stream.log(path, *values, static=self.timeless)

    def message(self, text: str, stamp_ns: int, index: int | None = None) -> None:
        """Log a warning at the scan or time that it is about."""
        self.at(stamp_ns, index)
        self.now(entities.MESSAGES, rr.TextLog(text, level=rr.TextLogLevel.WARN))

    def static(self, path: str, *values: rr.AsComponents) -> None:
        """Log what holds throughout."""
        self.stream.log(path, *values, static=True)

    def text(self, path: str, text: str) -> None:
        """Log Markdown that holds throughout."""
        self.static(path, markdown(text))

    def curve_style(self, path: str, name: str, color: entities.Color) -> None:
        """How a curve is drawn, and what its legend says."""
        self.static(path, rr.SeriesLines(colors=color, names=name, widths=1.5))

    def curve(self, path: str, indexes: Sequence[rr.TimeColumn], values: npt.ArrayLike) -> None:
        """Values of a curve, one for each place on the timelines."""
        self.stream.send_columns(path, indexes, rr.Scalars.columns(scalars=values))

    def gather(self, index: int, stamp_ns: int, values: Mapping[str, float]) -> None:
        """Keep the values of curves at one scan, by path, for `write_gathered`: one by one they cost as much as the cloud."""
        self._gathered.append((index, stamp_ns, values))

    def write_gathered(self) -> None:
        """Log all values that were gathered."""
        if self._gathered:
            index, stamp_ns, values = zip(*self._gathered, strict=True)
            for path in values[0]:
                self.curve(path, times(stamp_ns, index), [of_scan[path] for of_scan in values])
            self._gathered = []

    def columns(self, path: str, stamp_ns: IntArray, columns: rr.ComponentColumnList) -> None:
        """One row for each horizontal scan, by its stamp."""
        if not len(stamp_ns):
            return
        scan = None
        if self._scan_reached_ns is not None:
            scan = np.searchsorted(self._scan_reached_ns, stamp_ns).clip(max=len(self._scan_reached_ns) - 1)
        self.stream.send_columns(path, times(stamp_ns, scan), columns)

    def transforms(self, path: str, stamp_ns: IntArray, T: FloatArray) -> None:
        """Log frames T (n, 4, 4) at the stamps of horizontal scans."""
        columns = rr.Transform3D.columns(translation=T[:, :3, 3], quaternion=transforms.quaternion_xyzw(T))
        self.columns(path, stamp_ns, columns)

    def clouds(self, path: str, stamp_ns: IntArray, clouds: Sequence[FloatArray]) -> None:
        """Log clouds (k, 3) at the stamps of horizontal scans."""
        if clouds:
            positions = rounded(np.concatenate(clouds))
            sizes = [len(cloud) for cloud in clouds]
            self.columns(path, stamp_ns, rr.Points3D.columns(positions=positions).partition(sizes))


@contextmanager
def open_log(
    path: Path, recording_id: str, detail: Detail = Detail.LINES, layout: rrb.Blueprint | None = None
) -> Iterator[Log]:
    """A log into one part of a recording, see `open_part`; what it gathered is written at its end."""
    with open_part(path, recording_id, layout) as stream:
        log = Log(stream, detail)
        yield log
        log.write_gathered()


def times(stamp_ns: npt.ArrayLike, index: Iterable[int] | None = None) -> list[rr.TimeColumn]:
    """The places of rows on `stamp`; with the scans that they are of, on `scan` too."""
    columns = [rr.TimeColumn(entities.STAMP_TIMELINE, timestamp=np.asarray(stamp_ns).astype("datetime64[ns]"))]
    if index is not None:
        columns.append(rr.TimeColumn(entities.SCAN_TIMELINE, sequence=index))
    return columns


def evidence(answer: object = None, *names: str, **columns: npt.NDArray[Any]) -> rr.AnyValues:
    """Arrays beside an archetype, with the same types in every process even where they are empty.

    answer, names: a step's answer, and those of its fields that are taken under their own names.
    """
    typed: dict[str, Any] = {}
    for name, values in ({name: getattr(answer, name) for name in names} | columns).items():
        kind = _KINDS.get(values.dtype.char, values.dtype)
        flat = pa.array(values.astype(kind, copy=False).ravel())
        typed[name] = pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if values.ndim == 2 else flat
    return rr.AnyValues(**typed)


_KINDS = {"d": np.dtype(np.float32), "l": np.dtype(np.int32), "?": np.dtype(np.uint8)}
"""As what arrays of 64-bit numbers and of truth values are recorded, by the characters that numpy has for these."""
