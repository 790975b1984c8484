"""Scans of a topic, numbered over the whole bag, read in any slice."""

import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from ffmap.algorithms.base.scan import Scan, in_canonical_order
from ffmap.loaders.bag import Bag, Message
from ffmap.loaders.cloud_index import CloudIndex
from ffmap.loaders.decoding import CloudDecoding, decode
from ffmap.loaders.errors import CloudError, InputError, shortened
from ffmap.loaders.sensors import sensor_of


@dataclass(frozen=True)
class SkippedScan:
    """A cloud that gives no scan.

    stamp_ns: its stamp, or where that is wrong, the usable one next to it.
    trace: of the exception that its data raised; empty without one.
    """

    index: int
    stamp_ns: int
    reason: str
    trace: str = ""

    @classmethod
    def failed(cls, index: int, stamp_ns: int, error: Exception) -> "SkippedScan":
        """Skip a cloud whose data raised an exception; memory, disk and input errors pass on."""
        if isinstance(error, MemoryError | OSError | InputError):
            raise error
        reason = f"{type(error).__name__}: {shortened(error)}"
        return cls(index, stamp_ns, reason, "".join(traceback.format_exception(error)))


def read_messages(
    bag: Bag, index: CloudIndex, first: int = 0, count: int | None = None
) -> Iterator[tuple[int, Message]]:
    """Read clouds [first, first + count) as PointCloud2 messages, parts joined to revolutions.

    Yields a CloudError in place of a message that cannot be decoded.
    """
    sensor = sensor_of(bag.topics[index.topic])
    assert sensor is not None
    to_cloud = sensor.decoder(bag, index.topic)
    stop = len(index) if count is None else min(first + count, len(index))
    if first >= stop:
        return
    raws = bag.messages([index.topic], start_ns=int(index.log_time_ns[first]))
    raws = islice(raws, int(index.earlier[first]), None)
    for i in range(first, stop):
        group = list(islice(raws, int(index.message_count[i])))
        if not group:
            return
        # Parts may have been recorded twice.
        kept = [raw for k, raw in enumerate(group) if not k or raw.data != group[k - 1].data]
        try:
            yield i, to_cloud(kept, int(index.stamp_ns[i]))
        except InputError as error:
            yield i, error if isinstance(error, CloudError) else CloudError(str(error))


def read_scans(
    bag: Bag,
    index: CloudIndex,
    first: int,
    count: int | None,
    decoding: CloudDecoding,
) -> Iterator[tuple[int, Scan | SkippedScan]]:
    """Read clouds [first, first + count) as scans with their number in the bag.

    A damaged or inconsistent cloud, one without returns, and one with an unusable stamp are
    SkippedScans.
    """
    for i, message in read_messages(bag, index, first, count):
        stamp = int(index.stamp_ns[i])
        if isinstance(message, CloudError):
            yield i, SkippedScan(i, stamp, str(message))
        elif not index.usable[i]:
            yield i, _wrongly_stamped(index, i)
        else:
            yield i, _decoded(message, i, stamp, decoding)


def _decoded(message: Message, i: int, stamp: int, decoding: CloudDecoding) -> Scan | SkippedScan:
    try:
        scan = in_canonical_order(decode(message, decoding))
    except CloudError as error:
        return SkippedScan(i, stamp, str(error))
    except Exception as error:
        return SkippedScan.failed(i, stamp, error)
    if not scan.cloud_size:
        return SkippedScan(i, stamp, "no points")
    if not len(scan):
        return SkippedScan(i, stamp, "no valid point: all are NaN, infinite or zero")
    return scan


def _wrongly_stamped(index: CloudIndex, i: int) -> SkippedScan:
    """Compare with the last usable cloud before, or the first one after; there always is one."""
    usable = np.flatnonzero(index.usable)
    beside_ns = int(index.stamp_ns[usable[max(int(np.searchsorted(usable, i)) - 1, 0)]])
    step_ns = int(index.stamp_ns[i]) - beside_ns
    reason = f"stamp jumps {'back' if step_ns < 0 else 'ahead'} by {abs(step_ns) / 1e9:.3f} s"
    if step_ns == 0:
        reason = "stamp repeats that of the cloud before"
    return SkippedScan(i, beside_ns, reason)


def sample_messages(bag: Bag, index: CloudIndex, count: int) -> list[Message]:
    """Read clouds spread over the bag, without damaged ones. Raises CloudError where all are."""
    places = {round(place) for place in np.linspace(0, len(index) - 1, count)}
    indices = sorted(places) if len(index) else []
    found = [message for i in indices for _, message in read_messages(bag, index, i, 1)]
    sound = [message for message in found if not isinstance(message, CloudError)]
    if found and not sound:
        raise found[0]
    return sound
