"""The base's frame made upright where the clouds contradict the transforms."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.poses.which_way_up import LidarView, find_levels
from ffmap.loaders.frames import FrameTree, StaticTransform

_ALONG = 0.9  # Minimum cosine between a frame's axis and the upright one
_OVERTURNED = 1.5  # Times the floor must be nearer than the ceiling: a lidar above 60 % of the room's height is rare
_DOUBTFUL = 4 / 3


@dataclass(frozen=True, eq=False)
class UprightBase:
    """A frame to be the base. T_base_new: (4, 4). edge: the static transform that makes it, where no frame is upright.

    warning: what was found; `frame` is the old base where it could not be changed.
    """

    frame: str
    T_base_new: FloatArray
    edge: StaticTransform | None
    warning: str


def find_upright_base(
    base: str, tree: FrameTree, lidars: Mapping[str, tuple[str, LidarView]], may_change: bool
) -> UprightBase | None:
    """The frame to be the base in place of `base`; None where the clouds do not contradict that its z points up.

    lidars: frame and view of each topic. may_change: whether the frame may be another one.
    """
    topics = list(lidars)
    T_of = {base: np.eye(4)}
    chains = [tree.above(frame)[::-1] for frame, _ in lidars.values()]
    for frame in sorted({frame for chain in chains for frame in chain}, key=lambda f: len(tree.above(f))):
        T_base_frame = tree.between(base, frame)
        if T_base_frame is not None:
            T_of.setdefault(frame, T_base_frame)
    axes = np.array([T[:3, 2] for T in T_of.values()])
    found = find_levels([view for _, view in lidars.values()], axes)
    if found is None:
        return None
    place, levels = found
    doubted = bool(np.any(axes @ axes[place] < -_ALONG))
    overturned = levels.overturned >= (_DOUBTFUL if doubted else _OVERTURNED)
    up = -axes[place] if overturned else axes[place]
    if up[2] > _ALONG and (overturned or levels.overturned < _DOUBTFUL):
        return None
    near_m, far_m = sorted((levels.below_m, levels.above_m))
    where = f"{topics[levels.lidar]} is {near_m:.1f} m from a level surface and {far_m:.1f} m from the opposite one"
    if up[2] > _ALONG or not may_change:
        way = "upside down" if abs(up[2]) > _ALONG else "on its side"
        return UprightBase(
            base, np.eye(4), None, f"{base} may be {way}: {where}; check its transforms, or pass --rig FILE"
        )
    side = "down" if up[2] < -_ALONG else "sideways"
    said = f"z of {base} points {side}: {where}, the nearer one is the floor;"
    for frame, T in T_of.items():
        if T[:3, 2] @ up > _ALONG:
            return UprightBase(frame, T, None, f"{said} {frame} is the base instead; --rig FILE overrules that")
    T_base_new = np.eye(4)
    T_base_new[:3, :3] = _turned(up)
    frame = f"{base or 'lidar'}_upright"
    words = f"{said} the base is {frame}, {base or 'the lidar'} turned upright; --rig FILE overrules that"
    return UprightBase(frame, T_base_new, StaticTransform(base, frame, T_base_new), words)


def _turned(up: FloatArray) -> FloatArray:
    """The rotation (3, 3) whose z is `up`, by the shortest way; half a turn is one about x."""
    if up[2] < -_ALONG:
        half = np.diag([1.0, -1.0, -1.0])
        return np.asarray(half @ _turned(half @ up))
    axis = np.cross([0.0, 0.0, 1.0], up)
    length = float(np.linalg.norm(axis))
    return np.asarray(Rotation.from_rotvec(axis / max(length, 1e-12) * np.arctan2(length, up[2])).as_matrix())
