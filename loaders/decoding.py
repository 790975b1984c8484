"""PointCloud2 messages to scans, with one decoding for all clouds of a topic.

The decoding is estimated once, from clouds spread over the bag: a single cloud may be too poor for
the unit of its times or the number of its rings.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base.own_body import OwnBody
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan, subset
from ffmap.loaders.bag import Message
from ffmap.loaders.errors import CloudError
from ffmap.loaders.firing_times import TimeField, azimuth_times, find_time_field
from ffmap.loaders.pointcloud2 import (
    INTENSITY_NAMES,
    CloudLayout,
    describe_layout,
    field_of,
    points_of,
    stamp_ns,
    valid_points,
)
from ffmap.loaders.rings import RingModel, RingSample, estimate_rings

TimeFrom = Literal["auto", "azimuth", "none"]

_SWEEPS_MAX = 2.0
"""Maximum span of a cloud's times, in sweeps: longer ones overlap the next clouds."""
_RING_NUMBER_MAX = 2.0**31
_PAIRS_MIN = 20
"""Minimum number of firings with two returns, over all sampled clouds; fewer are chance."""
_APART_M = 0.1
"""Minimum distance between two returns of a firing that show two surfaces."""
_SAME_AZIMUTH = 1.0 - 1e-6  # Cosine: 0.08°, less than the step from one firing to the next


@dataclass(frozen=True, eq=False)
class CloudDecoding:
    """How the clouds of a topic become scans.

    time: the field of times; None without one.
    time_from: "auto" (the field), "azimuth" (computed from the direction of each point), "none".
    period_ns: time of a revolution, from the time stamps; None for fewer than two clouds.
    clock_ns: added to the firing times, to correct the lidar's clock.
    intensity: the field of intensities; None without one that varies.
    dual: whether firings return twice; the nearer return is removed.
    own_body: the robot's own body, which is removed; None where none is known.
    """

    layout: CloudLayout
    rings: RingModel
    time: TimeField | None
    time_from: TimeFrom
    period_ns: int | None
    clock_ns: int = 0
    intensity: str | None = None
    dual: bool = False
    own_body: OwnBody | None = None

    @property
    def timed(self) -> bool:
        """Whether scans have firing times."""
        return self.time is not None if self.time_from == "auto" else self.time_from == "azimuth"


def settle_decoding(
    messages: Sequence[Message],
    topic: str,
    time_from: TimeFrom = "auto",
    period_ns: int | None = None,
) -> CloudDecoding:
    """Estimate the decoding of a topic from some of its clouds.

    Raises CloudError where none of them is sound.
    """
    layouts, ring_samples = [], []
    time_samples = defaultdict[str, list[tuple[npt.NDArray[Any], int]]](list)
    varying: set[str] = set()
    failure = CloudError(f"{topic}: no cloud to read; choose another topic")
    for message in messages:
        try:
            layout = describe_layout(message, topic)
        except CloudError as error:
            failure = error
            continue
        layouts.append(layout)
        points = points_of(message, layout)
        xyz, index = valid_points(points)
        if not len(xyz):
            continue
        field = _ring_numbers(points, layout, index) if layout.ring_field else None
        row, column = np.divmod(index, layout.width)
        ring_samples.append(RingSample(xyz, field, row, column, (layout.height, layout.width)))
        for name in layout.named(INTENSITY_NAMES):
            if _varies(field_of(points, name, index)):
                varying.add(name)
        for name in layout.time_fields:
            time_samples[name].append((field_of(points, name, index), stamp_ns(message)))
    if not layouts:
        raise failure
    usual = Counter(str(found.point.fields) for found in layouts)
    layout = max(
        layouts, key=lambda each: (usual[str(each.point.fields)], each.height * each.width)
    )
    times = []
    for name in layout.time_fields:
        kind = layout.point[name].kind
        alike = [sample for sample in time_samples[name] if sample[0].dtype.kind == kind]
        times.append(find_time_field(name, alike, period_ns))
    decoding = CloudDecoding(
        layout,
        estimate_rings(ring_samples),
        next(filter(None, times), None),  # A driver may leave one of several fields empty
        time_from,
        period_ns,
        intensity=next((name for name in layout.named(INTENSITY_NAMES) if name in varying), None),
    )
    return replace(decoding, dual=_returns_twice(messages, decoding))


def _varies(values: npt.NDArray[Any]) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known) and known.min() < known.max())


def _returns_twice(messages: Sequence[Message], decoding: CloudDecoding) -> bool:
    """Whether firings return twice; only measured times and rings show it."""
    measured = decoding.time_from == "auto" and decoding.time is not None
    if not measured or decoding.rings.source in ("bins", "elevation"):
        return False
    pairs = 0
    for message in messages:
        with suppress(CloudError):
            scan = decode(message, decoding)
            if scan.time_ns is not None:
                nearer = _nearer_returns(scan.points_sensor, scan.ring, scan.time_ns, _APART_M)
                pairs += int(np.count_nonzero(nearer))
    return pairs >= _PAIRS_MIN


def _nearer_returns(
    points_sensor: FloatArray, ring: IntArray, time_ns: IntArray, apart_m: float = 0.0
) -> BoolArray:
    """Find the nearer of two returns of a firing, (n,); of two equal ones the second.

    Two points of one ring, one time and one azimuth are returns of one firing. apart_m: minimum
    distance between them.
    """
    order = np.lexsort((time_ns, ring))
    first, second = order[:-1], order[1:]
    alike = (ring[first] == ring[second]) & (time_ns[first] == time_ns[second])
    first, second = first[alike], second[alike]
    a, b = points_sensor[first].astype(np.float64), points_sensor[second].astype(np.float64)
    range_a, range_b = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    # Where a beam leaves the sensor off its center, the elevation depends on the range.
    across = np.linalg.norm(a[:, :2], axis=1) * np.linalg.norm(b[:, :2], axis=1)
    pair = np.einsum("ij,ij->i", a[:, :2], b[:, :2]) >= _SAME_AZIMUTH * across
    pair &= np.abs(range_a - range_b) >= apart_m
    nearer = np.zeros(len(ring), bool)
    nearer[np.where(range_a < range_b, first, second)[pair]] = True
    return nearer


def decode(message: Message, decoding: CloudDecoding) -> Scan:
    """Decode a cloud, without invalid points, the nearer of two returns and the robot's own body.

    Raises CloudError where the message is inconsistent, or differs from the topic's other clouds.
    """
    layout = describe_layout(message, decoding.layout.topic)
    points = points_of(message, layout)
    xyz, index = valid_points(points)
    ring = decoding.rings.rings(xyz, _numbers(points, layout, decoding.rings, index))
    time_ns, start_ns = _times(message, points, layout, decoding, xyz, ring, index)
    scan = Scan(
        points_sensor=xyz,
        ring=ring,
        ring_count=decoding.rings.count,
        time_ns=time_ns,
        start_ns=start_ns + decoding.clock_ns,
        stamp_ns=stamp_ns(message),
        cloud_index=index,
        cloud_size=layout.height * layout.width,
        intensity=_intensities(points, decoding.intensity, index),
    )
    if decoding.dual and time_ns is not None:
        scan = subset(scan, ~_nearer_returns(xyz, ring, time_ns))
    if decoding.own_body is not None:
        scan = subset(scan, ~decoding.own_body.holds(scan.points_sensor))
    return scan


def _intensities(
    points: npt.NDArray[np.void], name: str | None, index: IntArray
) -> FloatArray | None:
    """Return (n,) float32, NaN in a cloud without the field; None where the topic has none."""
    if name is None:
        return None
    if name not in (points.dtype.names or ()):
        return np.full(len(index), np.nan, np.float32)
    with np.errstate(over="ignore"):
        return field_of(points, name, index).astype(np.float32, copy=False)


def _ring_numbers(
    points: npt.NDArray[np.void], layout: CloudLayout, index: IntArray
) -> IntArray:
    assert layout.ring_field
    numbers = field_of(points, layout.ring_field, index)
    if np.issubdtype(numbers.dtype, np.floating):
        known = np.abs(numbers) < _RING_NUMBER_MAX
        numbers = np.where(known, numbers, 0 if 2 * np.count_nonzero(known) > len(known) else -1)
        return numbers.astype(np.int64)
    return numbers


def _numbers(
    points: npt.NDArray[np.void], layout: CloudLayout, rings: RingModel, index: IntArray
) -> IntArray | None:
    """Read the number (n,) that identifies each point's ring; None for rings by elevation.

    Raises CloudError where the cloud lacks it, or has other numbers than the topic's clouds.
    """
    match rings.source:
        case "field":
            if not layout.ring_field:
                raise CloudError(
                    f"{layout.topic}: no field with rings, which the topic's other clouds have"
                )
            number = _ring_numbers(points, layout, index)
            if 2 * np.count_nonzero((number < 0) | (number >= rings.count)) > len(number):
                raise CloudError(
                    f"{layout.topic}: field {layout.ring_field} has numbers from {number.min()} to "
                    f"{number.max()}, where the topic's other clouds have {rings.count} rings"
                )
            return number
        case "row" | "column":
            count = layout.height if rings.source == "row" else layout.width
            if len(index) and count != rings.count:
                raise CloudError(
                    f"{layout.topic}: {count} {rings.source}s, where the topic's other clouds have "
                    f"{rings.count}"
                )
            row, column = np.divmod(index, max(layout.width, 1))
            return row if rings.source == "row" else column
    return None


def _times(
    message: Message,
    points: npt.NDArray[np.void],
    layout: CloudLayout,
    decoding: CloudDecoding,
    xyz: FloatArray,
    ring: IntArray,
    index: IntArray,
) -> tuple[IntArray | None, int]:
    """Firing times (n,) from the first firing, and the time of that, in nanoseconds."""
    stamp, time, period_ns = stamp_ns(message), decoding.time, decoding.period_ns
    if decoding.time_from == "auto" and time and time.name in layout.time_fields:
        if layout.point[time.name].kind != decoding.layout.point[time.name].kind:
            raise CloudError(
                f"{layout.topic}: field {time.name} is of another type than in the topic's other "
                "clouds"
            )
        try:
            time_ns, start_ns = time.nanoseconds(field_of(points, time.name, index), stamp)
        except CloudError as error:
            raise CloudError(f"{layout.topic}: {error}{_INSTEAD}") from error
        usual_ns = max(time.span_ns, period_ns or 0)
        if period_ns and len(time_ns) and time_ns.max() > _SWEEPS_MAX * usual_ns:
            raise CloudError(
                f"{layout.topic}: the times in field {time.name} span {time_ns.max() / 1e9:.2f} s, "
                f"where a sweep takes {usual_ns / 1e9:.2f} s{_INSTEAD}"
            )
        return time_ns, start_ns
    if decoding.time_from == "azimuth" and period_ns:
        if decoding.rings.source == "row":
            columns = index.astype(np.int64) % layout.width
            return columns * period_ns // layout.width, stamp
        return azimuth_times(xyz, ring, period_ns), stamp
    return None, stamp


_INSTEAD = "; if it is so in many clouds, use --time-from azimuth"
