"""Write access to a recording: a stream, the current time, and the detail of a run."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.app.record.shapes import markdown
from ffmap.app.record.stream import open_part
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints.entities import LINE_TIMELINE, SCAN_TIMELINE, STAMP_TIMELINE, Color

Evidence = Mapping[str, npt.NDArray[Any]]
"""Arrays beside an archetype, by name."""

_CHUNK_BYTES = 1 << 20
"""Size of an entity's rows that are sent together: one by one, they cost twice as much."""
_RECORDED_AS: dict[str, np.dtype[Any]] = {
    "d": np.dtype(np.float32),
    "l": np.dtype(np.int32),
    "?": np.dtype(np.uint8),
}
"""Types of evidence in the recording, by numpy's character codes of 64-bit numbers and booleans."""


@dataclass(frozen=True)
class _Row:
    """components: arrays of numpy or Arrow, or lists, by name."""

    time: Mapping[str, int]
    components: Mapping[str, Any]
    evidence: Evidence

    @property
    def size(self) -> int:
        """Bytes of its arrays."""
        values = (*self.components.values(), *self.evidence.values())
        return sum(getattr(value, "nbytes", 0) for value in values)


class Log:
    """A stream to log into; the first argument of every function that logs."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        detail: Detail = Detail.LINES,
        scan_stamps_ns: IntArray | None = None,
    ) -> None:
        """Log into a stream.

        detail: how much of each scan is logged.
        scan_stamps_ns: (n,) of the vertical clouds in the bag; None without vertical clouds. With
            them, data of a horizontal scan also has an index on the timeline `scan`: the first
            vertical cloud that is not older, or the last one.
        """
        self.stream = stream
        self.detail = detail
        # The highest stamp up to each cloud, because a clock may step back.
        self._reached_ns = None if scan_stamps_ns is None else np.maximum.accumulate(scan_stamps_ns)
        self._time: dict[str, int] = {}
        self._rows: defaultdict[tuple[Any, ...], list[_Row]] = defaultdict(list)
        self._sizes: Counter[tuple[Any, ...]] = Counter()

    def at(self, stamp_ns: int, index: int | None = None) -> None:
        """Set the time and the scan of the next rows."""
        self._time = {STAMP_TIMELINE: stamp_ns}
        if index is not None:
            self._time[SCAN_TIMELINE] = index

    def at_sweep(self, stamp_ns: int) -> None:
        """Set the time of a horizontal scan for the next rows."""
        scan = None
        if self._reached_ns is not None and len(self._reached_ns):
            scan = min(int(np.searchsorted(self._reached_ns, stamp_ns)), len(self._reached_ns) - 1)
        self.at(stamp_ns, scan)

    def at_line(self, line: int) -> None:
        """Set the point line of the next rows, in a recording of one scan."""
        self._time = {LINE_TIMELINE: line}

    def row(
        self,
        path: str,
        archetype: Any = None,  # noqa: ANN401 - Rerun's archetypes have no common type
        evidence: Evidence | None = None,
        **components: Any,  # noqa: ANN401
    ) -> None:
        """Log components of an archetype and evidence at the time that is set; static without one.

        components: as the archetype's `columns` takes them; each is an array or a list.
        Components that are the same in all rows of an entity cost less as static data.
        """
        row = _Row(self._time, components, evidence or {})
        # Rows that are sent together have the same columns.
        key = path, archetype, *row.time, *components, *row.evidence
        self._rows[key].append(row)
        self._sizes[key] += row.size
        if self._sizes[key] > _CHUNK_BYTES:
            self._send(key)

    def pose(self, path: str, T_parent_child: FloatArray) -> None:
        """Log the transform (4, 4) of an entity at the time that is set."""
        quaternion = transforms.quaternion_xyzw(T_parent_child)
        translation = T_parent_child[:3, 3]
        self.row(path, rr.Transform3D, translation=translation[None], quaternion=quaternion[None])

    def send_rows(self) -> None:
        """Send all rows that were not sent yet."""
        for key in list(self._rows):
            self._send(key)

    def _send(self, key: tuple[Any, ...]) -> None:
        path, archetype, *_ = key
        rows = self._rows.pop(key)
        del self._sizes[key]
        columns: list[rr.ComponentColumn] = []
        for name in rows[0].components:
            values = [row.components[name] for row in rows]
            columns += _partitioned(archetype.from_fields(**{name: _joined(values)}), values)
        for name in rows[0].evidence:
            arrays = [row.evidence[name] for row in rows]
            beside = rr.AnyValues(**{name: _typed(_joined(arrays))})
            columns += _partitioned(beside, arrays)
        indexes = []
        for name in rows[0].time:
            at = [row.time[name] for row in rows]
            indexes += times(at) if name == STAMP_TIMELINE else [rr.TimeColumn(name, sequence=at)]
        self.stream.send_columns(path, indexes, columns)

    def static(self, path: str, *values: rr.AsComponents | Evidence) -> None:
        """Log archetypes and evidence that hold for the whole recording."""
        archetypes = [
            rr.AnyValues(**{name: _typed(array) for name, array in value.items()})
            if isinstance(value, Mapping)
            else value
            for value in values
        ]
        self.stream.log(path, *archetypes, static=True)

    def message(self, text: str) -> None:
        """Log a warning at the time that is set."""
        self.row("/messages", rr.TextLog, text=[text], level=[rr.TextLogLevel.WARN])

    def text(self, path: str, text: str) -> None:
        """Log Markdown that holds for the whole recording."""
        self.static(path, markdown(text))

    def curve_style(self, path: str, name: str, color: Color) -> None:
        """Set the colour and the name in the legend of a curve."""
        self.static(path, rr.SeriesLines(colors=color, names=name, widths=1.5))

    def curve(self, path: str, indexes: list[rr.TimeColumn], values: npt.ArrayLike) -> None:
        """Log the values of a curve, one for each time."""
        self.stream.send_columns(path, indexes, rr.Scalars.columns(scalars=values))


@contextmanager
def open_log(
    path: Path,
    recording_id: str,
    detail: Detail = Detail.LINES,
    layout: rrb.Blueprint | None = None,
) -> Iterator[Log]:
    """Open a log into a recording file, or a part of one, see `open_part`."""
    with open_part(path, recording_id, layout) as stream:
        log = Log(stream, detail)
        yield log
        log.send_rows()


def times(stamp_ns: npt.ArrayLike, index: Iterable[int] | None = None) -> list[rr.TimeColumn]:
    """Return the times of rows on `stamp`, and on `scan` if their scans are given."""
    stamps = np.asarray(stamp_ns).astype("datetime64[ns]")
    columns = [rr.TimeColumn(STAMP_TIMELINE, timestamp=stamps)]
    if index is not None:
        columns.append(rr.TimeColumn(SCAN_TIMELINE, sequence=index))
    return columns


def evidence(answer: object = None, *names: str, **columns: npt.NDArray[Any]) -> Evidence:
    """Return arrays to log beside an archetype.

    names: fields of answer, logged under their own names. columns: further arrays by name.
    """
    return {name: getattr(answer, name) for name in names} | columns


def _partitioned(joined: rr.AsComponents, values: Sequence[Any]) -> list[rr.ComponentColumn]:
    """Divide joined values into rows again."""
    lengths = [len(value) for value in values]
    return [batch.partition(lengths) for batch in joined.as_component_batches()]


def _joined(values: Sequence[Any]) -> Any:  # noqa: ANN401 - arrays or lists
    if len(values) == 1:
        return values[0]
    if isinstance(values[0], np.ndarray):
        return np.concatenate(values)
    if isinstance(values[0], pa.Array):
        return pa.concat_arrays(values)
    return list(chain.from_iterable(values))


def _typed(values: npt.NDArray[Any]) -> pa.Array:
    """Return an array with the same type in every process, even if it is empty."""
    recorded_as = _RECORDED_AS.get(values.dtype.char, values.dtype)
    flat = pa.array(values.astype(recorded_as, copy=False).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if values.ndim == 2 else flat
