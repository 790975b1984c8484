"""What each sensor has to provide."""

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, TypeAlias

from ffmap.algorithms.base.scan import IntArray
from ffmap.loaders.bag import Bag, Message, RawMessage, Topic
from ffmap.loaders.pointcloud2 import merge_clouds

Decoder: TypeAlias = Callable[[Sequence[RawMessage], int], Message]
"""Makes one PointCloud2 of a revolution's messages and stamp; raises InputError where it cannot."""


class Sensor:
    """The messages of a kind of lidar.

    messages: what a user records, in words; empty for messages that are not read.
    msgtypes: types of these messages.
    definitions: text of the message types that rosbags lacks, by name.
    """

    messages: ClassVar[str] = ""
    msgtypes: ClassVar[tuple[str, ...]] = ()
    definitions: ClassVar[Mapping[str, str]] = {}

    def matches(self, topic: Topic) -> bool:
        """Whether a topic holds messages of this lidar."""
        return topic.msgtype in self.msgtypes

    def unread_reason(self, bag: Bag, topic: Topic) -> str | None:
        """Why the messages of a topic are not read, one line; None where they are."""
        return None

    def frame_of(self, bag: Bag, topic: str) -> str:
        """The frame of the points."""
        return str(bag.deserialize(next(bag.messages([topic]))).header.frame_id).removeprefix("/")

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
        """Make one message a PointCloud2. Raises InputError where it is damaged."""
        return bag.deserialize(raw)
