"""The votes of points at once, as what rests on votes is tested with."""

from collections.abc import Sequence

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.votes import VoxelTable, VoxelVotes


def vote(points_map: FloatArray, label: UInt8Array, classes: int, voxel_m: float) -> VoxelVotes:
    """The votes of points (n, 3) in metres with labels (n,); labels from `classes` on have none."""
    table = VoxelTable(voxel_m, classes)
    table.add(points_map, label)
    return table.votes()


def merge(portions: Sequence[VoxelVotes]) -> VoxelVotes:
    """The sum of at least one portion."""
    table = VoxelTable(portions[0].voxel_m, portions[0].counts.shape[1])
    for portion in portions:
        table.absorb(portion)
    return table.votes()
