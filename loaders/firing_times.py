"""When each point was fired: from the cloud's time field whatever its unit and reference, or from the azimuth.

Neither the field's name nor its type tells its unit: `time` is in seconds (Velodyne), or in milliseconds, microseconds or
nanoseconds as FAST-LIO's `timestamp_unit` lists them; `t` (Ouster) and `offset_time` (Livox) are nanoseconds. A sweep takes
about 0.1 s, which leaves one unit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numba
import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.loaders.errors import CloudError

TIME_NAMES = ("time", "t", "timestamp", "time_stamp", "offset_time", "timeoffset", "time_offset", "relative_time")
"""Names that drivers give to times: Velodyne `time`, Ouster `t`, Hesai and RoboSense `timestamp`, Livox `offset_time`."""

_NANOSECOND_NAMES = ("t", "offset_time", "time_stamp")
"""Integers under these names (Ouster, Livox, Nebula) are nanoseconds where the values do not tell."""
_LONGEST_SWEEP_NS = 2_000_000_000
_SHORTEST_SWEEP_NS = 5_000_000
_PERIODS_MAX = 5  # Times that span more revolutions are in another unit, such as ticks of 100 ns
_PART_SHARE = 10
"""By how much the times in one message of a revolution may span more or less than the time to the next message."""
_CLOCK_MAX_NS = 2.0**63
_UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}

TimeReference = Literal["stamp", "epoch", "own clock"]


@dataclass(frozen=True)
class TimeField:
    """A field of times.

    unit: "s", "ms", "us" or "ns".
    reference: "stamp" (relative to the header's stamp, before or after it), "epoch" (absolute, on the stamps' clock),
        "own clock" (absolute on the sensor's clock: the header's stamp is taken for the sweep's first firing).
    span_ns: from the first to the last firing in the clouds that were looked at, the median.
    """

    name: str
    unit: str
    reference: TimeReference
    span_ns: int

    @property
    def unit_ns(self) -> int:
        """Nanoseconds of one unit."""
        return _UNITS_NS[self.unit]

    def nanoseconds(self, values: npt.NDArray[Any], stamp_ns: int) -> tuple[IntArray, int]:
        """Nanoseconds (n,) int64 from the first of these firings, and that firing's absolute time.

        Raises CloudError where the times span longer than a sweep can take, or lie farther than that from the stamp.
        """
        if not len(values):
            return np.zeros(0, np.int64), stamp_ns
        first = values.min()
        span_s = _span(values) * self.unit_ns / 1e9
        if not np.isfinite(span_s):
            raise CloudError(f"the times in field {self.name} are not all numbers")
        if span_s > _LONGEST_SWEEP_NS / 1e9:
            raise CloudError(f"the times in field {self.name} span {_told(span_s)} s, longer than any sweep")
        if not abs(float(first)) * self.unit_ns < _CLOCK_MAX_NS:
            raise CloudError(
                f"the times in field {self.name} are as large as {float(first):.3g} {self.unit}: no clock's"
            )
        time_ns = _scaled(values, first, self.unit_ns)
        start_ns = stamp_ns
        if self.reference != "own clock":
            start_ns = _exact_ns(first, self.unit_ns) + (stamp_ns if self.reference == "stamp" else 0)
        if abs(start_ns - stamp_ns) > _LONGEST_SWEEP_NS:
            raise CloudError(
                f"the times in field {self.name} begin {_told(abs(start_ns - stamp_ns) / 1e9)} s "
                f"{'before' if start_ns < stamp_ns else 'after'} the cloud's stamp"
            )
        return time_ns, start_ns


def _told(seconds: float) -> str:
    return f"{seconds:.1f}" if seconds < 1e6 else f"{seconds:.3g}"


def _scaled(values: npt.NDArray[Any], first: Any, unit_ns: int) -> IntArray:  # noqa: ANN401 - a NumPy scalar
    """Nanoseconds since `first`; subtracted in the values' own type, for seconds since 1970 take all of a double."""
    if np.issubdtype(values.dtype, np.integer):
        return (values.astype(np.int64) - int(first)) * unit_ns
    return _since(np.ascontiguousarray(values), float(first), float(unit_ns))


@numba.njit(cache=True, nogil=True)
def _since(values: FloatArray, first: float, unit_ns: float) -> IntArray:  # pragma: no cover
    nanoseconds = np.empty(len(values), np.int64)
    for i in range(len(values)):
        nanoseconds[i] = np.int64(np.rint((np.float64(values[i]) - first) * unit_ns))
    return nanoseconds


def _exact_ns(value: Any, unit_ns: int) -> int:  # noqa: ANN401 - a NumPy scalar
    """Nanoseconds of one value, its whole part multiplied as an integer."""
    if np.issubdtype(type(value), np.integer):
        return int(value) * unit_ns
    whole = int(np.floor(float(value)))
    return whole * unit_ns + round((float(value) - whole) * unit_ns)


def find_time_field(
    name: str, samples: Sequence[tuple[npt.NDArray[Any], int]], period_ns: int | None = None
) -> TimeField | None:
    """Unit and reference of the field's values, from clouds all over the bag: (values of valid points, stamp in ns).

    period_ns: how long a revolution takes; None where that is not known.
    A sweep takes between 5 ms and 2 s, which leaves one unit; where all are too short to tell, the usual one of floats (by
    their size) and of some names. None where the field is not filled or its unit cannot be told.
    """
    samples = [(values, stamp_ns) for values, stamp_ns in samples if len(values) and 0 < _span(values) < np.inf]
    if not samples:
        return None
    spans = [_span(values) for values, _ in samples]
    # Clouds with few returns span little, and the times of one in many may be absurd.
    span = float(np.percentile(spans, 75, method="lower"))
    whole = np.issubdtype(samples[0][0].dtype, np.integer)
    units = [unit for unit, ns in _UNITS_NS.items() if _SHORTEST_SWEEP_NS <= span * ns <= _LONGEST_SWEEP_NS]
    # Integers never count seconds.
    unit = next((u for u in units if not (whole and u == "s")), None)
    if unit is None:
        # Integers too long in every unit are refused cloud by cloud.
        nanoseconds = "ns" if name.lower() in _NANOSECOND_NAMES or span > _LONGEST_SWEEP_NS else None
        unit = nanoseconds if whole else _unit_by_size(samples)
    elif period_ns and span * _UNITS_NS[unit] > _PERIODS_MAX * period_ns:
        unit = None
    if unit is None:
        return None
    unit_ns = _UNITS_NS[unit]
    # To the microsecond, as floats: what an absurd time is as an integer is none.
    firsts = [(float(values.min()) * unit_ns, stamp_ns) for values, stamp_ns in samples]
    relative, epoch = np.median([(abs(first), abs(first - stamp_ns)) for first, stamp_ns in firsts], axis=0)
    reference: TimeReference = "own clock"
    if relative <= _LONGEST_SWEEP_NS:
        reference = "stamp"
    elif epoch <= _LONGEST_SWEEP_NS:
        reference = "epoch"
    return TimeField(name, unit, reference, round(float(np.median(spans)) * unit_ns))


def _span(values: npt.NDArray[Any]) -> float:
    if np.issubdtype(values.dtype, np.integer):
        return float(int(values.max()) - int(values.min()))
    return float(values.max() - values.min())


def _unit_by_size(samples: Sequence[tuple[npt.NDArray[Any], int]]) -> str:
    """Of floats: one that counts from 1970 shows its unit by its size, others are seconds."""
    largest = float(np.median([np.abs(values).max() for values, _ in samples]))
    return next((unit for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)) if largest > least), "s")


def join_times(name: str, parts: Sequence[npt.NDArray[Any]], offset_ns: Sequence[int]) -> list[npt.NDArray[Any]]:
    """Times of the messages that make up one revolution, counted from one start, in the parts' own type.

    parts: the values (n,) of each message. offset_ns: each message's stamp, from the first one's.
    Values that go on from message to message stay. Those that begin anew in each are counted from the first stamp, in
    seconds, or as integers in nanoseconds: a message lasts until the next, which tells their unit. Where it does not, or the
    field is not filled, each message's stamp is the time of its points.
    Raises CloudError where the integers are too short for a revolution's nanoseconds.
    """
    filled = [(_finite(part), offset) for part, offset in zip(parts, offset_ns, strict=True) if len(_finite(part))]
    if len(filled) < 2:
        return list(parts)
    first = np.array([float(values.min()) for values, _ in filled])
    span = float(np.median([_span(values) for values, _ in filled]))
    if np.median(np.diff(first)) > span / 2:
        return list(parts)
    step_ns = float(np.median(np.diff([offset for _, offset in filled])))
    unit_ns = next((ns for ns in _UNITS_NS.values() if step_ns / _PART_SHARE < span * ns < step_ns * _PART_SHARE), 0)
    dtype = parts[0].dtype
    if not np.issubdtype(dtype, np.integer):
        return [
            (part * (unit_ns / 1e9) + offset * 1e-9).astype(dtype)
            for part, offset in zip(parts, offset_ns, strict=True)
        ]
    joined = [part.astype(np.int64) * unit_ns + offset for part, offset in zip(parts, offset_ns, strict=True)]
    if max(int(times.max()) for times in joined if len(times)) > np.iinfo(dtype).max:
        raise CloudError(f"field {name} is too short an integer for the times of a revolution in nanoseconds")
    return [times.astype(dtype) for times in joined]


def _finite(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.asarray(values[np.isfinite(values)])


def azimuth_times(points_sensor: FloatArray, ring: IntArray, period_ns: int) -> IntArray:
    """Nanoseconds (n,) int64 from the sweep's first firing, from the azimuth about the spin axis.

    points_sensor: (n, 3) in the cloud's order; ring: (n,).
    period_ns: how long a revolution takes.
    The spin's direction is that in which the azimuth grows from point to point of a ring; the sweep begins at the
    cloud's first point. Where the order tells no direction, the sensor is taken to spin clockwise from behind.
    """
    if not len(points_sensor):
        return np.zeros(0, np.int64)
    azimuth = np.arctan2(points_sensor[:, 1], points_sensor[:, 0]).astype(np.float64)
    order = np.argsort(ring, kind="stable")
    sorted_ring = ring[order]
    step = _wrapped(np.diff(azimuth[order]))[np.diff(sorted_ring) == 0]
    step = step[(step != 0) & (np.abs(step) < np.radians(20))]
    forward = float(np.mean(step > 0)) if len(step) else 0.5
    ordered = abs(forward - 0.5) > 0.2
    direction = 1.0 if ordered and forward > 0.5 else -1.0
    turn = 2 * np.pi
    if not ordered:
        return np.asarray(np.rint(np.mod(direction * azimuth - np.pi, turn) / turn * period_ns).astype(np.int64))
    first = np.flatnonzero(np.append(True, np.diff(sorted_ring) != 0))
    lengths = np.diff(np.append(first, len(ring)))
    # How far along its ring a point lies says which turn it belongs to where rings begin before the first point.
    along = np.empty(len(ring))
    along[order] = (np.arange(len(ring)) - np.repeat(first, lengths)) / np.repeat(lengths, lengths)
    phase = direction * (azimuth - azimuth[0])
    phase += turn * np.round(along - phase / turn)
    phase -= phase.min()
    return np.asarray(np.rint(np.minimum(phase / turn, 1.0) * period_ns).astype(np.int64))


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray(np.mod(angle + np.pi, 2 * np.pi) - np.pi)
