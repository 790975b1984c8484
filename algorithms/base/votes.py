"""Votes of labelled points by voxel: how often each voxel got each label (paper, Fig. 8).

The sum does not depend on the order and the portions of the scans. It grows with the building, not
with time.
"""

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array

AXIS_BITS = 21
"""Bits of a key for each axis: 5 cm cubes reach 52 km to either side."""
AXIS_OFFSET = 1 << (AXIS_BITS - 1)
SUBDIVISIONS = 1 << 16
"""A place within a cube is counted in whole parts of its edge: sums do not depend on order."""
_EMPTY = np.int32(-1)


@dataclass(frozen=True)
class VoxelVotes:
    """The cubes that were seen and their votes; equal scenes give equal arrays.

    keys: (m,) int64, the packed index of each cube, increasing; see `cube_index`.
    counts: (m, C) uint32, how many votes each cube has for each code.
    position_sum: (m, 3) int64, where in the cube its points lie, in 1/65536 of the edge, summed.
    point_count: (m,) int64.
    voxel_m: the cubes' edge.
    """

    keys: IntArray
    counts: IntArray
    position_sum: IntArray
    point_count: IntArray
    voxel_m: float

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def cube_index(self) -> IntArray:
        """(m, 3) int64: cube i spans i·voxel_m to (i + 1)·voxel_m on each axis."""
        return unpack_cubes(self.keys)

    @cached_property
    def label(self) -> UInt8Array:
        """(m,) the code with most votes in each cube, see `majority`."""
        return majority(self.counts)

    @cached_property
    def mean_position(self) -> FloatArray:
        """(m, 3) float64 in metres: the mean of each cube's points."""
        within = self.position_sum / (SUBDIVISIONS * self.point_count[:, None])
        mean: FloatArray = (self.cube_index + within) * self.voxel_m
        mean.flags.writeable = False  # many share it
        return mean

    def seen(self, votes_min: int = 1) -> BoolArray:
        """(m,) whether some code has at least `votes_min` votes."""
        return np.asarray(self.counts.max(axis=1, initial=0) >= votes_min)


@dataclass(frozen=True)
class FusedCloud:
    """One point a cube: points_map (m, 3) float32 in metres, label (m,) uint8."""

    points_map: FloatArray
    label: UInt8Array

    def __len__(self) -> int:
        return len(self.label)


class VoxelTable:
    """Takes votes scan by scan, or whole `VoxelVotes` of other processes; `votes()` gives the sum.

    voxel_m: the cubes' edge. codes: number of codes to vote for; votes for higher ones are ignored.
    """

    def __init__(self, voxel_m: float, codes: int) -> None:
        self.voxel_m = voxel_m
        self._size = 0
        self._row_of_slot = np.full(1 << 15, _EMPTY)
        self._keys: IntArray = np.zeros(1 << 14, np.int64)
        self._counts: IntArray = np.zeros((1 << 14, codes), np.uint32)
        self._position_sum: IntArray = np.zeros((1 << 14, 3), np.int64)
        self._point_count: IntArray = np.zeros(1 << 14, np.int64)

    def __len__(self) -> int:
        return self._size

    def add(self, points_map: FloatArray, *codes: UInt8Array) -> None:
        """Points (n, 3) in metres, each with one vote for each of its codes (n,)."""
        key, within = cubes_of(np.ascontiguousarray(points_map), 1.0 / self.voxel_m)
        row = self._rows(key)
        _count(row, within, self._position_sum, self._point_count)
        for code in codes:
            _vote(row, np.ascontiguousarray(code), self._counts)

    def absorb(self, votes: VoxelVotes) -> BoolArray:
        """Add the votes of another table with the same cubes and codes.

        Returns which of its cubes (m,) are new here. Raises ValueError for other cubes or codes.
        """
        if votes.voxel_m != self.voxel_m or votes.counts.shape[1] != self._counts.shape[1]:
            raise ValueError("votes of other cubes or other codes cannot be added")
        size = self._size
        row = self._rows(votes.keys)
        self._counts[row] += votes.counts
        self._position_sum[row] += votes.position_sum
        self._point_count[row] += votes.point_count
        return np.asarray(row >= size)

    def votes(self) -> VoxelVotes:
        """What was counted so far."""
        order = np.argsort(self._keys[: self._size])
        return VoxelVotes(
            keys=self._keys[order],
            counts=self._counts[order],
            position_sum=self._position_sum[order],
            point_count=self._point_count[order],
            voxel_m=self.voxel_m,
        )

    def _rows(self, key: IntArray) -> IntArray:
        """The row of each key; those not met before get new ones."""
        row = np.empty(len(key), np.int32)
        done = 0
        while True:
            done, self._size = _find_rows(key, row, done, self._row_of_slot, self._keys, self._size)
            if done == len(key):
                return row
            self._grow()

    def _grow(self) -> None:
        """Double the table."""
        self._keys, self._counts, self._position_sum, self._point_count = (
            np.concatenate([rows, np.zeros_like(rows)])
            for rows in (self._keys, self._counts, self._position_sum, self._point_count)
        )
        self._row_of_slot = np.full(2 * len(self._keys), _EMPTY)
        _rehash(self._keys, self._size, self._row_of_slot)


def majority(counts: IntArray) -> UInt8Array:
    """The code (m,) with most votes in each row of counts (m, C); of equals the lower."""
    return np.argmax(counts, axis=1).astype(np.uint8) if len(counts) else np.zeros(0, np.uint8)


def fuse(votes: VoxelVotes) -> FusedCloud:
    """One point a cube: the mean of its points and their most frequent label, without outside."""
    label = votes.label
    kept = votes.seen() & (label != Label.OUTSIDE)
    return FusedCloud(votes.mean_position[kept].astype(np.float32), label[kept])


def columns_of(keys: IntArray) -> IntArray:
    """The keys (m,) of the upright columns of cubes; they increase with the cubes' keys."""
    return keys >> AXIS_BITS


def pack_column(cells: IntArray) -> IntArray:
    """The keys (k,) of columns with indexes (k, 2)."""
    packed: IntArray = ((cells[:, 0] + AXIS_OFFSET) << AXIS_BITS) | (cells[:, 1] + AXIS_OFFSET)
    return packed


def unpack_cubes(keys: IntArray) -> IntArray:
    """The indexes (m, 3) of cubes with keys (m,)."""
    mask = (1 << AXIS_BITS) - 1
    axes = [keys >> 2 * AXIS_BITS, (keys >> AXIS_BITS) & mask, keys & mask]
    return np.asarray(np.stack(axes, axis=1) - AXIS_OFFSET)


@numba.njit(cache=True, nogil=True)
def cubes_of(points: FloatArray, per_metre: float) -> tuple[IntArray, IntArray]:  # pragma: no cover
    """The key of each point's cube, and its place within, in whole parts of the edge."""
    key: IntArray = np.empty(len(points), np.int64)
    within: IntArray = np.empty((len(points), 3), np.uint16)
    for i in range(len(points)):
        packed = np.int64(0)
        for axis in range(3):
            scaled = np.float64(points[i, axis]) * per_metre
            index = np.floor(scaled)
            within[i, axis] = np.uint16(min(int((scaled - index) * SUBDIVISIONS), SUBDIVISIONS - 1))
            own = (np.int64(index) + AXIS_OFFSET) & ((1 << AXIS_BITS) - 1)
            packed = (packed << AXIS_BITS) | own
        key[i] = packed
    return key, within


@numba.njit(cache=True, nogil=True)
def _slot_of(key: int, row_of_slot: IntArray, keys: IntArray) -> int:  # pragma: no cover
    """The slot of a key, or the free one where it belongs (open addressing, Fibonacci hashing)."""
    mask = len(row_of_slot) - 1
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    slot = int((mixed >> np.uint64(32)) ^ (mixed >> np.uint64(47))) & mask
    while row_of_slot[slot] != -1 and keys[row_of_slot[slot]] != key:
        slot = (slot + 1) & mask
    return slot


@numba.njit(cache=True, nogil=True)
def _find_rows(
    key: IntArray, row: IntArray, start: int, row_of_slot: IntArray, keys: IntArray, size: int
) -> tuple[int, int]:  # pragma: no cover
    """Fill `row` from `start` on until the table is full.

    Returns how far it came, and the table's size.
    """
    for i in range(start, len(key)):
        if i > start and key[i] == key[i - 1]:
            row[i] = row[i - 1]
            continue
        slot = _slot_of(key[i], row_of_slot, keys)
        if row_of_slot[slot] == -1:
            if size == len(keys):
                return i, size
            row_of_slot[slot] = size
            keys[size] = key[i]
            size += 1
        row[i] = row_of_slot[slot]
    return len(key), size


@numba.njit(cache=True, nogil=True)
def _rehash(keys: IntArray, size: int, row_of_slot: IntArray) -> None:  # pragma: no cover
    for row in range(size):
        row_of_slot[_slot_of(keys[row], row_of_slot, keys)] = row


@numba.njit(cache=True, nogil=True)
def _count(
    row: IntArray, within: IntArray, position_sum: IntArray, point_count: IntArray
) -> None:  # pragma: no cover
    for i in range(len(row)):
        point_count[row[i]] += 1
        for axis in range(3):
            position_sum[row[i], axis] += np.int64(within[i, axis])


@numba.njit(cache=True, nogil=True)
def _vote(row: IntArray, code: UInt8Array, counts: IntArray) -> None:  # pragma: no cover
    for i in range(len(row)):
        if code[i] < counts.shape[1]:
            counts[row[i], code[i]] += np.uint32(1)
