"""Bags are complete or absent."""

from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from ffmap.loaders.bag import Container
from ffmap.loaders.bag_writer import BagWriter


@pytest.mark.parametrize(
    ("name", "container"), [("a.bag", "ros1"), ("a", "mcap"), ("b", "sqlite3")]
)
def test_bags_are_complete_or_absent(tmp_path: Path, name: str, container: Container) -> None:
    with pytest.raises(KeyError), BagWriter(tmp_path / name, container) as writer:
        writer.write("/words", writer.new("std_msgs/msg/Nothing", "one"), 1)
    assert not list(tmp_path.iterdir())
    with BagWriter(tmp_path / name, container) as writer:
        writer.add_topic("/words", "std_msgs/msg/String", latched=True)
    with AnyReader([tmp_path / name]) as reader:
        assert [connection.topic for connection in reader.connections] == ["/words"]
        assert reader.message_count == 0
    assert [path.name for path in tmp_path.iterdir()] == [name]
