"""Votes of cubes: hand-counted sums, ties, order, growth, and the fused cloud."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.votes import VoxelTable, VoxelVotes, fuse, majority
from tests.voting import merge, vote

EDGE_M = 0.05


def same(a: VoxelVotes, b: VoxelVotes) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("keys", "counts", "position_sum", "point_count")
    )


def crowd(count: int = 20_000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    return generator.uniform(-3, 3, (count, 3)).astype(np.float32), generator.integers(0, 6, count).astype(np.uint8)


def test_counts_and_means_by_hand():
    points = np.array([[0.01, 0.01, 0.01], [0.03, 0.01, 0.01], [-0.01, 0.0, 0.06], [0.02, 0.04, 0.01]])
    votes = vote(points, np.array([3, 3, 1, 0], np.uint8), 6, EDGE_M)
    assert votes.cube_index.tolist() == [[-1, 0, 1], [0, 0, 0]]
    assert votes.counts.tolist() == [[0, 1, 0, 0, 0, 0], [1, 0, 0, 2, 0, 0]]
    assert votes.point_count.tolist() == [1, 3]
    np.testing.assert_allclose(votes.mean_position, [[-0.01, 0, 0.06], [0.02, 0.02, 0.01]], atol=2e-6)
    assert np.all(np.diff(votes.keys) > 0)


def test_of_equal_votes_the_lower_label_wins():
    points = np.full((4, 3), 0.01)
    assert majority(vote(points, np.array([4, 3, 4, 3], np.uint8), 6, EDGE_M).counts).tolist() == [3]
    assert majority(vote(points, np.array([4, 3, 4, 4], np.uint8), 6, EDGE_M).counts).tolist() == [4]


def test_against_a_plain_count():
    points, label = crowd()
    votes = vote(points, label, 6, EDGE_M)
    index = np.floor(points.astype(np.float64) * (1 / EDGE_M)).astype(int)
    cube, row = np.unique(index, axis=0, return_inverse=True)
    counts = np.zeros((len(cube), 6), int)
    np.add.at(counts, (row.ravel(), label), 1)
    np.testing.assert_array_equal(votes.cube_index, cube)
    np.testing.assert_array_equal(votes.counts, counts)


def test_neither_order_nor_portions_matter():
    points, label = crowd()
    whole = vote(points, label, 6, EDGE_M)
    shuffled = np.random.default_rng(1).permutation(len(points))
    assert same(whole, vote(points[shuffled], label[shuffled], 6, EDGE_M))
    parts = [vote(points[i::3], label[i::3], 6, EDGE_M) for i in range(3)]
    assert same(whole, merge(parts))
    assert same(whole, merge(parts[::-1]))


def test_the_table_grows_past_its_first_size():
    points, label = crowd(200_000)
    table = VoxelTable(EDGE_M, 6)
    for start in range(0, len(points), 7_000):
        table.add(points[start : start + 7_000], label[start : start + 7_000])
    assert len(table) > 1 << 16
    assert same(table.votes(), vote(points, label, 6, EDGE_M))


def test_several_codes_a_point_and_codes_without_a_vote():
    table = VoxelTable(EDGE_M, 4)
    table.add(np.zeros((2, 3)), np.array([0, 1], np.uint8), np.array([3, 255], np.uint8))
    assert table.votes().counts.tolist() == [[1, 1, 0, 1]]


def test_fused_cloud_leaves_out_what_lies_outside_and_what_has_no_label():
    points = np.array([[0.01, 0, 0], [0.02, 0, 0], [1.01, 0, 0], [2.01, 0, 0]])
    label = np.array([Label.WALL, Label.WALL, Label.OUTSIDE, 255], np.uint8)
    cloud = fuse(vote(points, label, 6, EDGE_M))
    np.testing.assert_allclose(cloud.points_map, [[0.015, 0, 0]], atol=2e-6)
    assert cloud.label.tolist() == [Label.WALL]
    assert (cloud.points_map.dtype, cloud.label.dtype) == (np.float32, np.uint8)


def test_nothing_gives_nothing():
    votes = vote(np.zeros((0, 3)), np.zeros(0, np.uint8), 6, EDGE_M)
    assert len(votes) == len(fuse(votes)) == len(majority(votes.counts)) == 0
    assert same(merge([votes, votes]), votes)


def test_votes_of_other_cubes_are_refused():
    with pytest.raises(ValueError, match="other cubes"):
        VoxelTable(EDGE_M, 6).absorb(vote(np.zeros((1, 3)), np.zeros(1, np.uint8), 6, 0.1))
