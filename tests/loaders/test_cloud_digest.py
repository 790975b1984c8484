"""Digests of clouds see every byte of every message that is used, however the clouds are read."""

import numpy as np
import pytest

from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_digest import DIGEST_BYTES, as_rows, joined
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.scans import read_digests, read_messages
from tests.loaders.bag_builder import START_NS, clouds, tf_message, write_bag

MOUNT = [("base", "a", (0, 0, 1), (0, 0, 0, 1))]


def digests_of(path, first=0, count=None):
    with open_bag(path) as bag:
        index = index_clouds(bag, "/a")
        found = list(read_digests(bag, index, first, count))
        while_read: list[bytes] = []
        for _ in read_messages(bag, index, first, count, while_read):
            pass
        assert while_read == found
        return found


@pytest.mark.parametrize("name", ["a.bag", "a_db3", "a_mcap"])
def test_any_partition_gives_the_same_digests(tmp_path, name):
    path = write_bag(tmp_path / name, clouds("/a", 9, ros_version=1 if name.endswith(".bag") else 2), 50_000)
    whole = digests_of(path)
    assert len(set(whole)) == 9
    assert [d for first in range(0, 9, 4) for d in digests_of(path, first, 4)] == whole
    assert as_rows(whole).shape == (9, DIGEST_BYTES)
    assert as_rows([]).shape == (0, DIGEST_BYTES)
    assert joined([as_rows(whole).tobytes()]) == joined(whole)


@pytest.mark.parametrize("seed", range(5))
def test_one_bit_of_one_cloud_changes_its_digest_alone(tmp_path, seed):
    entries = clouds("/a", 9)
    before = digests_of(write_bag(tmp_path / "a.bag", entries))
    random = np.random.default_rng(seed)
    changed = int(random.integers(9))
    data = entries[changed][2].data
    data = data.copy()
    data[random.integers(len(data))] ^= 1 << random.integers(8)
    message = type(entries[changed][2])(**{**entries[changed][2].__dict__, "data": data})
    entries[changed] = (entries[changed][0], entries[changed][1], message)
    after = digests_of(write_bag(tmp_path / "b.bag", entries))
    assert [one != other for one, other in zip(before, after, strict=True)] == [i == changed for i in range(9)]


def test_what_is_not_used_changes_nothing(tmp_path):
    entries = clouds("/a", 5)
    before = digests_of(write_bag(tmp_path / "a.bag", entries))
    entries += [("/tf_static", START_NS, tf_message(MOUNT)), *clouds("/b", 3)]
    assert digests_of(write_bag(tmp_path / "b.bag", sorted(entries, key=lambda e: e[1]))) == before
