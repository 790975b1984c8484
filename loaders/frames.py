"""The bag's static transforms as a tree: from /tf_static, or what never changes on /tf."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.loaders.bag import Bag, Message

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

_SAME = 1e-6
_SAME_PLACE = 1e-3  # Metres, or radians; rounding in a robot's description changes less
_QUATERNION_MIN = 1e-6
"""Minimum length of a quaternion."""
_WINDOWS = 20
_WINDOW_NS = 300_000_000
_FIRST_WINDOW_NS = 2_000_000_000


@dataclass(frozen=True, eq=False)
class StaticTransform:
    """T_parent_child (4, 4) that never changes; frames without leading slash."""

    parent: str
    child: str
    T_parent_child: FloatArray


class FrameTree:
    """Frames by their parents.

    Of two transforms to one child the later is used; one that would close a loop is ignored.
    """

    def __init__(self, edges: Iterable[StaticTransform], warnings: Iterable[str] = ()) -> None:
        self.warnings = tuple(warnings)
        self._by_child: dict[str, StaticTransform] = {}
        for edge in edges:
            if edge.child not in self.above(edge.parent):
                self._by_child[edge.child] = edge

    @property
    def edges(self) -> tuple[StaticTransform, ...]:
        return tuple(self._by_child.values())

    @property
    def frames(self) -> list[str]:
        return sorted(set(self._by_child) | {edge.parent for edge in self._by_child.values()})

    def root(self, frame: str) -> tuple[str, FloatArray]:
        """Find the topmost frame above a frame, and T_root_frame."""
        above = self.above(frame)
        T_root_frame = np.eye(4)
        for child in above[:-1]:
            T_root_frame = self._by_child[child].T_parent_child @ T_root_frame
        return above[-1], T_root_frame

    def above(self, frame: str) -> list[str]:
        """List the frame, its parent, and so on to the topmost."""
        above = [frame]
        while edge := self._by_child.get(above[-1]):
            above.append(edge.parent)
        return above

    def rooted_at(self, frame: str) -> tuple[StaticTransform, ...]:
        """Invert the transforms above a frame, so that it is the topmost."""
        above = self.above(frame)
        inverted = (
            StaticTransform(edge.child, edge.parent, transforms.invert(edge.T_parent_child))
            for edge in (self._by_child[child] for child in above[:-1])
        )
        return (*inverted, *(edge for edge in self.edges if edge.child not in above))

    def joins(self, frames: Collection[str]) -> bool:
        """Whether transforms join all these frames."""
        roots = {self.root(frame)[0] for frame in frames}
        return len(roots) <= 1 and set(frames) <= set(self.frames)

    def between(self, target: str, source: str) -> FloatArray | None:
        """Compute T_target_source; None where no transforms join the two."""
        target_root, T_root_target = self.root(target)
        source_root, T_root_source = self.root(source)
        if target_root != source_root:
            return None
        return np.asarray(transforms.invert(T_root_target) @ T_root_source)


def read_frame_tree(bag: Bag, frames: Mapping[str, str]) -> FrameTree:
    """Read /tf_static, and where it does not join all frames, what never changes on /tf.

    frames: the frame of each lidar's topic. Topics in the lidar's own namespace take precedence.
    """
    needed = set(frames.values())
    latched, moving = (_tf_topics(bag, name, frames) for name in ("tf_static", "tf"))
    found = [
        (name, edge)
        for name in latched
        for raw in bag.messages([name])
        for edge in edges_of(bag.deserialize(raw))
    ]
    edges = [edge for _, edge in found]
    tree = FrameTree(edges)
    if moving and not tree.joins(needed):
        tree = FrameTree([*_unchanging(bag, moving), *edges])
    used = {frame for start in needed for frame in tree.above(start)}
    least = min(max((_nearness(name, frames) for name in latched), default=0), 1)
    own = [
        (name, edge)
        for name, edge in found
        if edge.child in used and _nearness(name, frames) >= least
    ]
    return FrameTree(tree.edges, _contradictions(own))


def _contradictions(found: list[tuple[str, StaticTransform]]) -> Iterator[str]:
    """Warn of each frame that two transforms, given with their topics, place differently."""
    for child, (used, kept) in {edge.child: (name, edge) for name, edge in found}.items():
        for name, edge in found:
            off = float(np.abs(edge.T_parent_child - kept.T_parent_child).max())
            if edge.child == child and (off >= _SAME_PLACE or edge.parent != kept.parent):
                yield (
                    f"two transforms place {child} differently, on {name} in {edge.parent} and on "
                    f"{used} in {kept.parent}; the last on {used} is used. Record one robot's "
                    "transforms, or pass --rig FILE"
                )
                break


def edges_of(message: Message) -> Iterator[StaticTransform]:
    """Yield the transforms of a TFMessage, without invalid ones."""
    return filter(None, map(edge_of, message.transforms))


def edge_of(stamped: Message) -> StaticTransform | None:
    """Convert a TransformStamped; None where it contains no rotation, or NaN."""
    shift, turn = stamped.transform.translation, stamped.transform.rotation
    T, _ = pose_matrices(
        np.array([[shift.x, shift.y, shift.z]]), np.array([[turn.x, turn.y, turn.z, turn.w]])
    )
    if not len(T):
        return None
    parent, child = stamped.header.frame_id, stamped.child_frame_id
    return StaticTransform(parent.removeprefix("/"), child.removeprefix("/"), T[0])


def pose_matrices(
    translation: FloatArray, quaternion_xyzw: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Convert the valid ones of translations (n, 3) and quaternions (n, 4).

    Returns:
        Matrices (k, 4, 4), and which (n,) are valid.
    """
    finite = np.isfinite(np.hstack([translation, quaternion_xyzw])).all(axis=1, keepdims=True)
    lengths = np.linalg.norm(np.where(finite, quaternion_xyzw, 0.0), axis=1)
    valid: BoolArray = lengths >= _QUATERNION_MIN
    T = np.tile(np.eye(4), (int(np.count_nonzero(valid)), 1, 1))
    if len(T):
        T[:, :3, :3] = Rotation.from_quat(quaternion_xyzw[valid]).as_matrix()
        T[:, :3, 3] = translation[valid]
    return T, valid


def _tf_topics(bag: Bag, name: str, lidars: Iterable[str]) -> list[str]:
    """List the topics of that name in any namespace, the nearest to the lidars last."""
    own = [topic.name for topic in bag.topics.values() if topic.msgtype in TF_TYPES and topic.count]
    named = [topic for topic in own if topic.rsplit("/", 1)[-1] == name]
    return sorted(named, key=lambda topic: _nearness(topic, lidars))


def _nearness(topic: str, lidars: Iterable[str]) -> int:
    """Count the levels of namespace shared with a lidar; 1 without, 0 for another robot's."""
    *namespace, _ = topic.strip("/").split("/")
    paths = [zip(namespace, lidar.strip("/").split("/"), strict=False) for lidar in lidars]
    shared = [sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], path)) for path in paths]
    return 1 + max(shared, default=0) if not namespace or any(shared) else 0


def _unchanging(bag: Bag, topics: list[str]) -> list[StaticTransform]:
    """Select transforms that are the same in windows spread over the bag."""
    if bag.start_ns is None or bag.end_ns is None:
        return []
    starts = np.linspace(bag.start_ns, bag.end_ns, _WINDOWS + 1)[1:].astype(np.int64).tolist()
    windows = [(bag.start_ns, _FIRST_WINDOW_NS), *((start_ns, _WINDOW_NS) for start_ns in starts)]
    first: dict[tuple[str, str], StaticTransform] = {}
    changing = set()
    for start_ns, long_ns in windows:
        for raw in bag.messages(topics, start_ns, start_ns + long_ns):
            for edge in edges_of(bag.deserialize(raw)):
                key = (edge.parent, edge.child)
                known = first.setdefault(key, edge)
                if np.abs(known.T_parent_child - edge.T_parent_child).max() > _SAME:
                    changing.add(key)
    return [edge for key, edge in first.items() if key not in changing]
