"""Checks of a topic's clouds: time stamps, clocks, gaps, and two lidars on one topic."""

import numpy as np

from ffmap.loaders.cloud_index import CloudIndex
from ffmap.loaders.decoding import CloudDecoding
from ffmap.loaders.errors import CloudError

_SWEEPS_OVERLAP = 1.5  # Sweeps of one lidar follow each other (1), those of two overlap (2)
_APART_NS = 1_000_000_000  # Maximum delay between a cloud's stamp and its log time
_EARLY_NS = 1_000_000_000  # Minimum time before the end of the drive at which a lidar ends early
_GAPS_NAMED = 3


def check_one_lidar(index: CloudIndex, decoding: CloudDecoding) -> None:
    """Raise CloudError where frames or times show two lidars on one topic."""
    what = f"{index.topic}: two lidars on one topic,"
    fix = "record each lidar on a topic of its own (Livox: multi_topic 1), or split the topic"
    if len(index.frames) > 1:
        raise CloudError(f"{what} with frames {' and '.join(index.frames)}; {fix} by frame")
    stamps = index.stamp_ns[index.usable]
    if decoding.time is None or len(stamps) < 3:
        return
    # Of two lidars every other step is short.
    step_ns = float(np.median(stamps[2:] - stamps[:-2])) / 2
    span_ns = decoding.time.span_ns
    if span_ns > _SWEEPS_OVERLAP * step_ns:
        raise CloudError(
            f"{what} its sweeps take {span_ns / 1e6:.0f} ms and begin every {step_ns / 1e6:.0f} "
            f"ms; {fix}"
        )


def stamp_problem(index: CloudIndex) -> str | None:
    """Explain why a topic's clouds cannot be put in order of time; None where they can."""
    if len(index) < 2 or np.count_nonzero(index.usable) > 1:
        return None
    what = "have stamps that do not increase"
    if not np.any(np.diff(index.stamp_ns)):
        what = f"have the same stamp, {index.stamp_ns[0] / 1e9:.3f} s"
    return (
        f"{index.topic}: all {len(index)} clouds {what}; record them with a driver that stamps them"
    )


def clock_problem(index: CloudIndex, other: CloudIndex) -> str | None:
    """Explain why two lidars do not have one clock; None where they may have."""
    if min(len(index), len(other)) < 2 or stamp_problem(index) or stamp_problem(other):
        return None
    first, second = index.topic, other.topic
    lead_ns, other_lead_ns = (
        float(np.median((each.stamp_ns - each.log_time_ns)[each.usable])) for each in (index, other)
    )
    ahead_ns = other_lead_ns - lead_ns
    if abs(ahead_ns) > _APART_NS:
        side = "ahead" if ahead_ns > 0 else "behind"
        return (
            f"the clocks of {first} and {second} are apart: the stamps of {second} are "
            f"{abs(ahead_ns) / 1e9:.1f} s {side}, by their log times; set the lidars to one clock "
            "(PTP), or shift that topic's stamps"
        )
    stamps, others = index.stamp_ns[index.usable] / 1e9, other.stamp_ns[other.usable] / 1e9
    if others[0] > stamps[-1] or others[-1] < stamps[0]:
        return (
            f"{first} and {second} share no time: their stamps run from {stamps[0]:.1f} to "
            f"{stamps[-1]:.1f} s and from {others[0]:.1f} to {others[-1]:.1f} s; set the lidars "
            "to one clock (PTP), or shift one topic's stamps"
        )
    return None


def gap_problem(index: CloudIndex, ends_ns: int) -> str | None:
    """Name the longest gaps between clouds, and one before the end of the drive; None without."""
    stamps_ns = index.stamp_ns[index.usable]
    last_ns = int(stamps_ns[-1])
    early = [(last_ns, ends_ns - last_ns)] if ends_ns - last_ns > _EARLY_NS else []
    found = sorted([*index.gaps, *early], key=lambda gap: -gap[1])
    if not found:
        return None
    first_ns = stamps_ns[0]
    named = ", ".join(
        f"{long_ns / 1e9:.1f} s after {(at_ns - first_ns) / 1e9:.1f} s"
        for at_ns, long_ns in found[:_GAPS_NAMED]
    )
    rest = len(found) - _GAPS_NAMED
    more = f" and in {rest} shorter gaps" if rest > 0 else ""
    return f"{index.topic} has no clouds for {named}{more}: the driver or the recorder lost them"
