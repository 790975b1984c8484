"""The clouds of all vertical lidars as one sequence of scans, in the order of their stamps.

With one lidar, a scan has the number of its cloud. With several, scan 7 may be cloud 3 of the
second.
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
    """The cloud of each scan, (m,) each.

    lidar: place among the vertical lidars.
    cloud: number among that lidar's clouds.
    stamp_ns: header stamp, usable or not.
    """

    lidar: IntArray
    cloud: IntArray
    stamp_ns: IntArray

    @classmethod
    def of(cls, indices: Sequence[CloudIndex]) -> "ScanOrder":
        """Sort by stamp; each lidar's clouds keep their order, topics decide between equal ones."""
        names = sorted(index.topic for index in indices)
        lidar = np.concatenate([np.full(len(index), i) for i, index in enumerate(indices)])
        cloud = np.concatenate([np.arange(len(index)) for index in indices])
        stamp_ns = np.concatenate([index.stamp_ns for index in indices])
        reached_ns = np.concatenate([_reached_ns(index) for index in indices])
        by_topic = np.array([names.index(index.topic) for index in indices])
        order = np.lexsort((cloud, by_topic[lidar], reached_ns))
        return cls(lidar[order], cloud[order], stamp_ns[order])

    def __len__(self) -> int:
        return len(self.lidar)

    def read(
        self,
        first: int,
        count: int | None,
        read_lidar: Callable[[int, int, int], Iterator[tuple[int, T]]],
    ) -> Iterator[tuple[int, int, T]]:
        """Yield number, lidar and item of each of the scans [first, first + count).

        read_lidar: reads some of a lidar's clouds, given its place, the first cloud and their
            number; yields cloud numbers and items, some may be missing. Each lidar needs a bag of
            its own, as some containers keep one position.
        """
        scans = slice(first, len(self) if count is None else first + count)
        lidars, clouds = self.lidar[scans], self.cloud[scans]
        reading: dict[int, Iterator[tuple[int, T]]] = {}
        following: dict[int, tuple[int, T] | None] = {}
        for lidar in np.unique(lidars).tolist():
            own = clouds[lidars == lidar]
            reading[lidar] = read_lidar(lidar, int(own[0]), len(own))
            following[lidar] = next(reading[lidar], None)
        pairs = zip(lidars.tolist(), clouds.tolist(), strict=True)
        for scan, (lidar, cloud) in enumerate(pairs, start=first):
            read = following[lidar]
            if read is not None and read[0] == cloud:
                yield scan, lidar, read[1]
                following[lidar] = next(reading[lidar], None)


def _reached_ns(index: CloudIndex) -> IntArray:
    """The latest usable stamp (m,) up to each cloud: a wrong stamp moves no cloud."""
    usable = index.stamp_ns[index.usable]
    if not len(usable):
        return index.stamp_ns[:1].repeat(len(index))
    return np.asarray(usable[np.maximum(np.cumsum(index.usable) - 1, 0)])
