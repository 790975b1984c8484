"""When each point was fired: from the cloud's field of times, or from the azimuth.

Neither a field's name nor its type determines its unit: `time` is in seconds (Velodyne), or in
milli-, micro- or nanoseconds (`timestamp_unit` of FAST-LIO); `t` (Ouster) and `offset_time`
(Livox) are in nanoseconds. A sweep takes about 0.1 s, which only one unit fits.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.loaders.errors import CloudError

TIME_NAMES = (
    "time",  # Velodyne
    "t",  # Ouster
    "timestamp",  # Hesai, RoboSense
    "time_stamp",
    "offset_time",  # Livox
    "timeoffset",
    "time_offset",
    "relative_time",
)
_NANOSECOND_NAMES = ("t", "offset_time", "time_stamp")
"""Integers with these names are nanoseconds where the values do not show the unit."""
_SWEEP_MAX_NS = 2_000_000_000
_SWEEP_MIN_NS = 5_000_000
_PERIODS_MAX = 5  # Times that span more revolutions are in another unit, such as ticks of 100 ns
_PART_SHARE = 10
"""Maximum ratio between the span of times in a part of a revolution and the step to the next."""
_CLOCK_MAX_NS = 2.0**63
_UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}

TimeReference = Literal["stamp", "epoch", "own clock"]


@dataclass(frozen=True)
class TimeField:
    """A field of times.

    unit: "s", "ms", "us" or "ns".
    reference: "stamp" (relative to the header's time stamp), "epoch" (absolute, on the clock of
        the time stamps), "own clock" (absolute, on the sensor's clock: the time stamp is the time
        of the first firing).
    span_ns: from the first to the last firing of a cloud, the median.
    """

    name: str
    unit: str
    reference: TimeReference
    span_ns: int

    def nanoseconds(self, values: npt.NDArray[Any], stamp_ns: int) -> tuple[IntArray, int]:
        """Convert to nanoseconds (n,) int64 from the first firing, and the time of that.

        Raises CloudError where the times span more than a sweep, or are that far from the stamp.
        """
        if not len(values):
            return np.zeros(0, np.int64), stamp_ns
        what, unit_ns = f"the times in field {self.name}", _UNITS_NS[self.unit]
        first, span_s = values.min(), _span(values) * unit_ns / 1e9
        if not np.isfinite(span_s):
            raise CloudError(f"{what} are not all numbers")
        if span_s > _SWEEP_MAX_NS / 1e9:
            raise CloudError(f"{what} span {_seconds(span_s)}, longer than any sweep")
        if not abs(float(first)) * unit_ns < _CLOCK_MAX_NS:
            raise CloudError(f"{what} are as large as {float(first):.3g} {self.unit}: no clock's")
        if np.issubdtype(values.dtype, np.integer):
            first_ns = int(first) * unit_ns
            time_ns = (values.astype(np.int64) - int(first)) * unit_ns
        else:
            # Seconds since 1970 use all digits of a double: subtract before scaling.
            since = np.rint((values.astype(np.float64) - float(first)) * float(unit_ns))
            whole = int(np.floor(float(first)))
            time_ns = since.astype(np.int64)
            first_ns = whole * unit_ns + round((float(first) - whole) * unit_ns)
        zero_ns = {"stamp": stamp_ns, "epoch": 0, "own clock": stamp_ns - first_ns}[self.reference]
        off_ns = zero_ns + first_ns - stamp_ns
        if abs(off_ns) > _SWEEP_MAX_NS:
            side = "before" if off_ns < 0 else "after"
            raise CloudError(f"{what} begin {_seconds(abs(off_ns) / 1e9)} {side} the cloud's stamp")
        return time_ns, zero_ns + first_ns


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 1e6 else f"{seconds:.3g} s"


def _span(values: npt.NDArray[Any]) -> float:
    if np.issubdtype(values.dtype, np.integer):
        return float(int(values.max()) - int(values.min()))
    return float(values.max() - values.min())


def find_time_field(
    name: str, samples: Sequence[tuple[npt.NDArray[Any], int]], period_ns: int | None = None
) -> TimeField | None:
    """Estimate unit and reference of a field from clouds spread over the bag.

    Args:
        samples: values of the valid points, and time stamp in nanoseconds, of each cloud.
        period_ns: time of a revolution; None where unknown.

    Returns:
        The field; None where it is not filled or its unit cannot be determined.
    """
    samples = [sample for sample in samples if len(sample[0]) and 0 < _span(sample[0]) < np.inf]
    if not samples:
        return None
    spans = [_span(values) for values, _ in samples]
    # Clouds with few returns span little, and the times of one in many may be absurd.
    span = float(np.percentile(spans, 75, method="lower"))
    whole = np.issubdtype(samples[0][0].dtype, np.integer)  # Integers never count seconds
    units = [u for u in _UNITS_NS if _SWEEP_MIN_NS <= span * _UNITS_NS[u] <= _SWEEP_MAX_NS]
    unit = next((u for u in units if not (whole and u == "s")), None)
    if unit is not None and period_ns and span * _UNITS_NS[unit] > _PERIODS_MAX * period_ns:
        return None
    if unit is None and not whole:
        unit = _unit_by_size(samples)
    # Integers that are too long in every unit are refused cloud by cloud.
    if unit is None and (name.lower() in _NANOSECOND_NAMES or span > _SWEEP_MAX_NS):
        unit = "ns"
    if unit is None:
        return None
    unit_ns = _UNITS_NS[unit]
    firsts = [(float(values.min()) * unit_ns, stamp_ns) for values, stamp_ns in samples]
    distances = [(abs(first), abs(first - stamp)) for first, stamp in firsts]
    relative, epoch = np.median(distances, axis=0)
    reference: TimeReference = "own clock"
    if relative <= _SWEEP_MAX_NS:
        reference = "stamp"
    elif epoch <= _SWEEP_MAX_NS:
        reference = "epoch"
    return TimeField(name, unit, reference, round(float(np.median(spans)) * unit_ns))


def _unit_by_size(samples: Sequence[tuple[npt.NDArray[Any], int]]) -> str:
    """Determine the unit of floats: times since 1970 show it by their size, others are seconds."""
    largest = float(np.median([np.abs(values).max() for values, _ in samples]))
    least = {"ns": 1e17, "us": 1e14, "ms": 1e11}
    return next((unit for unit, size in least.items() if largest > size), "s")


def join_times(
    name: str, parts: Sequence[npt.NDArray[Any]], offset_ns: Sequence[int]
) -> list[npt.NDArray[Any]]:
    """Count the times in the parts of a revolution from one start, in the parts' own type.

    Times that increase from part to part are kept. Others count from each part's time stamp, and
    become seconds, or nanoseconds as integers; the step to the next part shows their unit. Where
    it does not, each part's time stamp is the time of its points.

    Args:
        parts: the values (n,) of each part.
        offset_ns: the time stamp of each part, from the first one's.

    Raises CloudError where integers are too short for nanoseconds.
    """
    finite = [(part[np.isfinite(part)], ns) for part, ns in zip(parts, offset_ns, strict=True)]
    filled = [(values, ns) for values, ns in finite if len(values)]
    if len(filled) < 2:
        return list(parts)
    span = float(np.median([_span(values) for values, _ in filled]))
    if np.median(np.diff([float(values.min()) for values, _ in filled])) > span / 2:
        return list(parts)
    step_ns = float(np.median(np.diff([ns for _, ns in filled])))
    units = _UNITS_NS.values()
    unit_ns = next(
        (u for u in units if step_ns / _PART_SHARE < span * u < step_ns * _PART_SHARE), 0
    )
    dtype = parts[0].dtype
    if not np.issubdtype(dtype, np.integer):
        return [
            (part * (unit_ns / 1e9) + ns * 1e-9).astype(dtype)
            for part, ns in zip(parts, offset_ns, strict=True)
        ]
    joined = [p.astype(np.int64) * unit_ns + ns for p, ns in zip(parts, offset_ns, strict=True)]
    if max(int(times.max()) for times in joined if len(times)) > np.iinfo(dtype).max:
        raise CloudError(
            f"field {name} is too short an integer for the times of a revolution in nanoseconds"
        )
    return [times.astype(dtype) for times in joined]


def azimuth_times(points_sensor: FloatArray, ring: IntArray, period_ns: int) -> IntArray:
    """Compute firing times from the azimuth about the spin axis.

    The azimuth along a ring shows the direction of spin; the sweep begins at the first point.
    Where the points are in no order, the sensor spins clockwise from behind.

    Args:
        points_sensor: (n, 3) in the cloud's order.
        ring: (n,).
        period_ns: time of a revolution.

    Returns:
        Nanoseconds (n,) int64 from the first firing.
    """
    if not len(points_sensor):
        return np.zeros(0, np.int64)
    turn = 2 * np.pi
    azimuth = np.arctan2(points_sensor[:, 1], points_sensor[:, 0]).astype(np.float64)
    order = np.argsort(ring, kind="stable")
    sorted_ring = ring[order]
    step = np.mod(np.diff(azimuth[order]) + np.pi, turn) - np.pi
    step = step[np.diff(sorted_ring) == 0]
    step = step[(step != 0) & (np.abs(step) < np.radians(20))]
    forward = float(np.mean(step > 0)) if len(step) else 0.5
    if abs(forward - 0.5) <= 0.2:
        phase = np.mod(-azimuth - np.pi, turn)
        return np.asarray(np.rint(phase / turn * period_ns).astype(np.int64))
    direction = 1.0 if forward > 0.5 else -1.0
    first = np.flatnonzero(np.append(True, np.diff(sorted_ring) != 0))
    lengths = np.diff(np.append(first, len(ring)))
    # A point's place along its ring selects its turn where rings begin before the first point.
    along = np.empty(len(ring))
    along[order] = (np.arange(len(ring)) - np.repeat(first, lengths)) / np.repeat(lengths, lengths)
    phase = direction * (azimuth - azimuth[0])
    phase += turn * np.round(along - phase / turn)
    phase -= phase.min()
    return np.asarray(np.rint(np.minimum(phase / turn, 1.0) * period_ns).astype(np.int64))
