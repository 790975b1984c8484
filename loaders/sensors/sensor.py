"""The interface of a sensor."""

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, TypeAlias

from ffmap.algorithms.base.scan import IntArray
from ffmap.loaders.bag import Bag, Message, RawMessage, Topic
from ffmap.loaders.pointcloud2 import merge_clouds

Decoder: TypeAlias = Callable[[Sequence[RawMessage], int], Message]
"""Makes a PointCloud2 of a revolution's messages and stamp; raises InputError for damaged ones."""


class Sensor:
    """The messages of a kind of lidar.

    messages: what a user records, for error messages; empty for messages that are not read.
    msgtypes: types of these messages.
    definitions: text of the message types that rosbags lacks, by name.
    """

    messages: ClassVar[str] = ""
    msgtypes: ClassVar[tuple[str, ...]] = ()
    definitions: ClassVar[Mapping[str, str]] = {}

    def matches(self, topic: Topic) -> bool:
        """Whether a topic contains messages of this lidar."""
        return topic.msgtype in self.msgtypes

    def unread_reason(self, bag: Bag, topic: Topic) -> str | None:
        """Explain why the messages of a topic are not read; None where they are."""
        return None

    def frame_of(self, bag: Bag, topic: str) -> str:
        """Return the frame of the points."""
        first = bag.deserialize(next(bag.messages([topic])))
        return str(first.header.frame_id).removeprefix("/")

    def index(self, bag: Bag, topic: str) -> tuple[IntArray, IntArray, IntArray] | None:
        """Find the revolutions of packets without headers; None where messages have headers.

        Returns:
            Log times (m,) of the messages; number of messages (r,) and stamp (r,) of each
            revolution; in nanoseconds.
        """
        return None

    def decoder(self, bag: Bag, topic: str) -> Decoder:
        """Make the decoder of a topic."""

        def join(raws: Sequence[RawMessage], stamp_ns: int) -> Message:
            clouds = [self.decode(bag, raw) for raw in raws]
            return clouds[0] if len(clouds) == 1 else merge_clouds(clouds)

        return join

    def decode(self, bag: Bag, raw: RawMessage) -> Message:
        """Make a PointCloud2 of a message. Raises InputError where it is damaged."""
        return bag.deserialize(raw)
