"""Where recorders write to, and the timelines on which it lies."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.app.record.rows import Rows, Time, Values, typed
from ffmap.app.record.shapes import markdown, rounded, transform_columns
from ffmap.app.record.stream import open_part
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities

rr.set_strict_mode(True)

_TIMES_TOGETHER = 20
"""Number of scans whose rows are sent together, some megabytes."""


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
        self._rows, self._time, self._times = Rows(), Time(), 0
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
        self._go_to(_time(stamp_ns, index))

    def at_line(self, line: int) -> None:
        """What is logged next is of this line of the one scan that there is."""
        self.stream.reset_time()
        self.stream.set_time(entities.LINE_TIMELINE, sequence=line)
        self._go_to(((entities.LINE_TIMELINE, line),))

    def _go_to(self, time: Time) -> None:
        self._time = time
        self._times += 1
        if self._times > _TIMES_TOGETHER:
            self.write_rows()

    def row(
        self,
        path: str,
        archetype: Any = None,  # noqa: ANN401 - Rerun's archetypes have no common type
        evidence: Mapping[str, npt.NDArray[Any]] = MappingProxyType({}),
        **components: Values,
    ) -> None:
        """Keep what is of the time that is set, for `write_rows`: one by one, most of a row's cost is that of asking.

        Each row of an entity has the same components. archetype: what they are of; evidence: arrays beside them.
        """
        self._rows.add(path, () if self.timeless else self._time, archetype, components, evidence)

    def forget(self, stamp_ns: int, index: int) -> None:
        """Drop the rows that were kept of a scan."""
        self._rows.drop(_time(stamp_ns, index))

    def write_rows(self) -> None:
        """Log all rows that were kept."""
        self._rows.send(self.stream)
        self._times = 0

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
        self.columns(path, stamp_ns, rr.Transform3D.columns(**transform_columns(T)))

    def clouds(self, path: str, stamp_ns: IntArray, clouds: Sequence[FloatArray]) -> None:
        """Log clouds (k, 3) at the stamps of horizontal scans."""
        if clouds:
            positions = rounded(np.concatenate(clouds))
            sizes = [len(cloud) for cloud in clouds]
            self.columns(path, stamp_ns, rr.Points3D.columns(positions=positions).partition(sizes))


def _time(stamp_ns: int, index: int | None) -> Time:
    of_scan = () if index is None else ((entities.SCAN_TIMELINE, index),)
    return ((entities.STAMP_TIMELINE, stamp_ns), *of_scan)


@contextmanager
def open_log(
    path: Path, recording_id: str, detail: Detail = Detail.LINES, layout: rrb.Blueprint | None = None
) -> Iterator[Log]:
    """A log into one part of a recording, see `open_part`; rows that it keeps are written at its end."""
    with open_part(path, recording_id, layout) as stream:
        log = Log(stream, detail)
        yield log
        log.write_rows()


def times(stamp_ns: npt.ArrayLike, index: Iterable[int] | None = None) -> list[rr.TimeColumn]:
    """The places of rows on `stamp`; with the scans that they are of, on `scan` too."""
    columns = [rr.TimeColumn(entities.STAMP_TIMELINE, timestamp=np.asarray(stamp_ns).astype("datetime64[ns]"))]
    if index is not None:
        columns.append(rr.TimeColumn(entities.SCAN_TIMELINE, sequence=index))
    return columns


def evidence(answer: object = None, *names: str, **columns: npt.NDArray[Any]) -> rr.AnyValues:
    """Arrays beside an archetype, see `arrays`."""
    return rr.AnyValues(**{name: typed(values) for name, values in arrays(answer, *names, **columns).items()})


def arrays(answer: object = None, *names: str, **columns: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    """Arrays by their names.

    answer, names: a step's answer, and those of its fields that are taken under their own names.
    """
    return {name: getattr(answer, name) for name in names} | columns
