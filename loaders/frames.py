"""The bag's static transforms, as the tree that /tf_static (or what never changes on /tf) makes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.loaders.bag import Bag, Message

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

_SAME = 1e-6
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
    """Frames by their parents. Of two transforms to one child the later holds; one that would close a loop is left out."""

    def __init__(self, edges: Iterable[StaticTransform]) -> None:
        self._by_child: dict[str, StaticTransform] = {}
        for edge in edges:
            if edge.child not in self._above(edge.parent):
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
        above = self._above(frame)
        T_root_frame = np.eye(4)
        for child in above[:-1]:
            T_root_frame = self._by_child[child].T_parent_child @ T_root_frame
        return above[-1], T_root_frame

    def _above(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the topmost."""
        above = [frame]
        while edge := self._by_child.get(above[-1]):
            above.append(edge.parent)
        return above

    def between(self, target: str, source: str) -> FloatArray | None:
        """T_target_source; None where no transforms join the two."""
        target_root, T_root_target = self.root(target)
        source_root, T_root_source = self.root(source)
        if target_root != source_root:
            return None
        return np.asarray(transforms.invert(T_root_target) @ T_root_source)


def read_frame_tree(bag: Bag, needed: Iterable[str]) -> FrameTree:
    """The transforms on /tf_static; where they do not join all `needed` frames, those of /tf that never change too."""
    needed = list(needed)
    latched, moving = _tf_topics(bag, "tf_static"), _tf_topics(bag, "tf")
    fixed = [edge for raw in bag.messages(latched) for edge in edges_of(bag.deserialize(raw))] if latched else []
    tree = FrameTree(fixed)
    joined = len({tree.root(frame)[0] for frame in needed}) <= 1 and set(needed) <= set(tree.frames)
    if joined or not moving:
        return tree
    return FrameTree([*_unchanging(bag, moving), *fixed])


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


def _tf_topics(bag: Bag, name: str) -> list[str]:
    """Topics of that name, in whatever namespace."""
    own = [topic for topic in bag.topics.values() if topic.msgtype in TF_TYPES and topic.count]
    return [topic.name for topic in own if topic.name.rsplit("/", 1)[-1] == name]


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
