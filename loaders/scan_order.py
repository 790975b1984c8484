"""The clouds of all lidars that are labelled, as one sequence of scans in the order of their stamps.

With one lidar a scan's number is that of its cloud. With several, scan 7 may be cloud 3 of the second: what comes after reading
takes scan for scan, and asks each which lidar it is from.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ffmap.algorithms.base.scan import IntArray
from ffmap.loaders.cloud_index import CloudIndex

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class ScanOrder:
    """Which cloud each scan is, (m,) each.

    lidar: the place of its lidar among those that are labelled. cloud: its number among that lidar's.
    stamp_ns: as in its header, be it usable or not.
    """

    lidar: IntArray
    cloud: IntArray
    stamp_ns: IntArray

    @classmethod
    def of(cls, indices: Sequence[CloudIndex]) -> "ScanOrder":
        """Each lidar's clouds stay in their order; of equal stamps, as of lidars that fire together, the topics' names decide."""
        by_topic = np.argsort(np.argsort([index.topic for index in indices], kind="stable"), kind="stable")
        lidar = np.concatenate([np.full(len(index), i) for i, index in enumerate(indices)])
        cloud = np.concatenate([np.arange(len(index)) for index in indices])
        stamp_ns = np.concatenate([index.stamp_ns for index in indices])
        reached_ns = np.concatenate([_reached_ns(index) for index in indices])
        order = np.lexsort((cloud, by_topic[lidar], reached_ns))
        return cls(lidar[order], cloud[order], stamp_ns[order])

    def __len__(self) -> int:
        return len(self.lidar)

    def read(
        self, first: int, count: int | None, read_lidar: Callable[[int, int, int], Iterator[tuple[int, T]]]
    ) -> Iterator[tuple[int, int, T]]:
        """Number, lidar and what was read of each of the scans [first, first + count), None for all that follow.

        read_lidar: given a lidar's place, a first cloud and how many, what is read of these by their numbers; some may be
        missing. Several lidars' are read in turns: each needs a bag of its own, for some containers are read from where the
        last reader stopped.
        """
        scans = slice(first, len(self) if count is None else first + count)
        lidars, clouds = self.lidar[scans], self.cloud[scans]
        reading: dict[int, Iterator[tuple[int, T]]] = {}
        following: dict[int, tuple[int, T] | None] = {}
        for lidar in np.unique(lidars).tolist():
            own = clouds[lidars == lidar]
            reading[lidar] = read_lidar(lidar, int(own[0]), len(own))
            following[lidar] = next(reading[lidar], None)
        for scan, lidar, cloud in zip(range(first, first + len(lidars)), lidars.tolist(), clouds.tolist(), strict=True):
            read = following[lidar]
            if read is not None and read[0] == cloud:
                yield scan, lidar, read[1]
                following[lidar] = next(reading[lidar], None)


def _reached_ns(index: CloudIndex) -> IntArray:
    """(m,) the latest right stamp up to each cloud; before there is any, the first: a stamp that is wrong moves no cloud."""
    right = index.stamp_ns[index.usable]
    if not len(right):
        return index.stamp_ns[:1].repeat(len(index))
    return np.asarray(right[np.maximum(np.cumsum(index.usable) - 1, 0)])
