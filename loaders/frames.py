"""The bag's static transforms, as the tree that /tf_static (or what never changes on /tf) makes."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.loaders.bag import Bag, Message

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

_SAME = 1e-6
_SAME_PLACE = 1e-3  # Metres, or radians: what rounding in a robot's description changes, and no mount
_QUATERNION_MIN = 1e-6
"""The length below which a quaternion is no rotation."""
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
    """Frames by their parents. Of two transforms to one child the later holds; one that would close a loop is left out.

    warnings: what a user must know about the transforms.
    """

    def __init__(self, edges: Iterable[StaticTransform], warnings: Iterable[str] = ()) -> None:
        self.warnings = tuple(warnings)
        self._by_child: dict[str, StaticTransform] = {}
        for edge in edges:
            if edge.child not in self.above(edge.parent):
                self._by_child[edge.child] = edge

    @property
    def edges(self) -> tuple[StaticTransform, ...]:
        """All transforms."""
        return tuple(self._by_child.values())

    @property
    def frames(self) -> list[str]:
        """All frames by name."""
        return sorted(set(self._by_child) | {edge.parent for edge in self._by_child.values()})

    def root(self, frame: str) -> tuple[str, FloatArray]:
        """The topmost frame above `frame`, and T_root_frame."""
        above = self.above(frame)
        T_root_frame = np.eye(4)
        for child in above[:-1]:
            T_root_frame = self._by_child[child].T_parent_child @ T_root_frame
        return above[-1], T_root_frame

    def above(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the topmost."""
        above = [frame]
        while edge := self._by_child.get(above[-1]):
            above.append(edge.parent)
        return above

    def rooted_at(self, frame: str) -> tuple[StaticTransform, ...]:
        """All transforms, with those above a frame inverted, so that it is the topmost."""
        above = self.above(frame)
        inverted = [self._by_child[child] for child in above[:-1]]
        others = (edge for edge in self.edges if edge.child not in above)
        return (*(StaticTransform(e.child, e.parent, transforms.invert(e.T_parent_child)) for e in inverted), *others)

    def between(self, target: str, source: str) -> FloatArray | None:
        """T_target_source; None where no transforms join the two."""
        target_root, T_root_target = self.root(target)
        source_root, T_root_source = self.root(source)
        if target_root != source_root:
            return None
        return np.asarray(transforms.invert(T_root_target) @ T_root_source)


def read_frame_tree(bag: Bag, frames: Mapping[str, str]) -> FrameTree:
    """Read the transforms on /tf_static; where they do not join all frames, those of /tf that never change too.

    frames: the frame of each lidar's topic. Of several namespaces that have transforms, a lidar takes those of its own.
    """
    needed = set(frames.values())
    latched, moving = (_tf_topics(bag, name, frames) for name in ("tf_static", "tf"))
    told = [(name, edge) for name in latched for raw in bag.messages([name]) for edge in edges_of(bag.deserialize(raw))]
    edges = [edge for _, edge in told]
    tree = FrameTree(edges)
    if moving and not (len({tree.root(frame)[0] for frame in needed}) <= 1 and needed <= set(tree.frames)):
        tree = FrameTree([*_unchanging(bag, moving), *edges])
    used = {frame for start in needed for frame in tree.above(start)}
    nearest = max((_nearness(name, frames) for name in latched), default=0)
    own = [(name, edge) for name, edge in told if edge.child in used and _nearness(name, frames) >= min(nearest, 1)]
    return FrameTree(tree.edges, _contradictions(own))


def _contradictions(told: list[tuple[str, StaticTransform]]) -> Iterator[str]:
    """One line for each frame that two transforms, given with their topics, place differently."""
    for child, (used, kept) in {edge.child: (name, edge) for name, edge in told}.items():
        for name, edge in told:
            same = np.abs(edge.T_parent_child - kept.T_parent_child).max() < _SAME_PLACE
            if edge.child == child and not (same and edge.parent == kept.parent):
                yield (
                    f"two transforms place {child} differently, on {name} in {edge.parent} and on {used} in {kept.parent}; "
                    f"the last on {used} is used. Record one robot's transforms, or pass --rig FILE"
                )
                break


def edges_of(message: Message) -> Iterator[StaticTransform]:
    """The transforms of one TFMessage; those without a rotation or with NaN are left out."""
    return filter(None, map(edge_of, message.transforms))


def edge_of(stamped: Message) -> StaticTransform | None:
    """One TransformStamped; None where it has no rotation, or NaN."""
    T = pose_matrix(stamped.transform.translation, stamped.transform.rotation)
    if T is None:
        return None
    return StaticTransform(stamped.header.frame_id.removeprefix("/"), stamped.child_frame_id.removeprefix("/"), T)


def pose_matrix(translation: Message, rotation: Message) -> FloatArray | None:
    """(4, 4) of a ROS translation and quaternion; None where they are no pose."""
    position = np.array([[translation.x, translation.y, translation.z]])
    T, _ = pose_matrices(position, np.array([[rotation.x, rotation.y, rotation.z, rotation.w]]))
    return T[0] if len(T) else None


def pose_matrices(translation: FloatArray, quaternion_xyzw: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(k, 4, 4) of the sound ones among ROS translations (n, 3) and quaternions (n, 4); and which (n,) are sound."""
    finite = np.isfinite(np.hstack([translation, quaternion_xyzw])).all(axis=1, keepdims=True)
    sound: BoolArray = np.linalg.norm(np.where(finite, quaternion_xyzw, 0.0), axis=1) >= _QUATERNION_MIN
    T = np.tile(np.eye(4), (int(np.count_nonzero(sound)), 1, 1))
    if len(T):
        T[:, :3, :3] = Rotation.from_quat(quaternion_xyzw[sound]).as_matrix()
        T[:, :3, 3] = translation[sound]
    return T, sound


def _tf_topics(bag: Bag, name: str, lidars: Iterable[str]) -> list[str]:
    """Topics of that name in whatever namespace, those that are nearest to the lidars' last."""
    own = [topic.name for topic in bag.topics.values() if topic.msgtype in TF_TYPES and topic.count]
    named = [topic for topic in own if topic.rsplit("/", 1)[-1] == name]
    return sorted(named, key=lambda topic: _nearness(topic, lidars))


def _nearness(topic: str, lidars: Iterable[str]) -> int:
    """How much of a topic's namespace is that of a lidar: 1 where it has none, 0 where it is another robot's."""
    *namespace, _ = topic.strip("/").split("/")
    paths = [zip(namespace, lidar.strip("/").split("/"), strict=False) for lidar in lidars]
    shared = [sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], path)) for path in paths]
    return 1 + max(shared, default=0) if not namespace or any(shared) else 0


def _unchanging(bag: Bag, topics: list[str]) -> list[StaticTransform]:
    """Transforms on /tf that are the same in windows all over the bag."""
    if bag.start_ns is None or bag.end_ns is None:
        return []
    starts = np.linspace(bag.start_ns, bag.end_ns, _WINDOWS + 1)[1:].astype(np.int64).tolist()
    windows = [(bag.start_ns, bag.start_ns + _FIRST_WINDOW_NS), *((s, s + _WINDOW_NS) for s in starts)]
    first: dict[tuple[str, str], StaticTransform] = {}
    changing = set()
    for start_ns, stop_ns in windows:
        for raw in bag.messages(topics, start_ns, stop_ns):
            for edge in edges_of(bag.deserialize(raw)):
                key = (edge.parent, edge.child)
                known = first.setdefault(key, edge)
                if np.abs(known.T_parent_child - edge.T_parent_child).max() > _SAME:
                    changing.add(key)
    return [edge for key, edge in first.items() if key not in changing]
