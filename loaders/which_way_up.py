"""The base's frame made upright where the clouds contradict the transforms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.poses.which_way_up import find_levels, upright_axis
from ffmap.loaders.frames import FrameTree, StaticTransform

_ALONG = 0.9  # Minimum cosine between a frame's axis and the upright one
_LEVEL = 0.97  # The same for a map that its floor can level: it slopes by up to 15 degrees
_OVERTURNED = 1.5  # Times nearer than the ceiling the floor must be: a lidar above 60 % of a room's height is rare
_DOUBTFUL = 4 / 3  # The same where a frame's z contradicts the base's, and for a warning
_BASE_MAX_M = 0.35  # Height of a base's origin: on the floor, or at the axles
_HALF_TURN = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class LidarView:
    """What a lidar saw during a drive. clouds: points (n, 3) in its own frame. T_base_sensor: (4, 4)."""

    topic: str
    frame_id: str
    clouds: Sequence[FloatArray]
    T_base_sensor: FloatArray


@dataclass(frozen=True, eq=False)
class UprightBase:
    """A frame to be the base. T_base_frame: (4, 4), from the old base. edge: what makes it, where it is a new frame.

    warning: what was found; `frame` is the old base where it could not be changed.
    """

    frame: str
    T_base_frame: FloatArray
    edge: StaticTransform | None
    warning: str


def find_upright_base(
    base: str, tree: FrameTree, lidars: Sequence[LidarView], may_change: bool
) -> UprightBase | None:
    """The frame to be the base in place of `base`; None where the clouds do not contradict that its z points up.

    may_change: whether the frame may be another one.
    """
    above = {frame for lidar in lidars for frame in tree.above(lidar.frame_id)}
    frames = [base, *sorted(above - {base}, key=lambda frame: (len(tree.above(frame)), frame))]
    T_of = {frame: T for frame in frames if (T := tree.between(base, frame)) is not None}
    axes = np.array([T[:3, 2] for T in T_of.values()])
    densest = [
        max(
            ((find_levels([p @ each.T_base_sensor[:3, :3].T for p in each.clouds], axis), each) for each in lidars),
            key=lambda found: found[0].share,
        )
        for axis in axes
    ]
    place = upright_axis([levels for levels, _ in densest])
    if place is None:
        return None
    (levels, lidar), axis = densest[place], axes[place]
    ratio = levels.below_m / levels.above_m
    if abs(levels.below_m - float(axis @ lidar.T_base_sensor[:3, 3])) < _BASE_MAX_M:
        # The base is on the floor, and a mast carries the lidar.
        ratio = 0.0
    overturned = ratio >= (_DOUBTFUL if np.any(axes @ axis < -_ALONG) else _OVERTURNED)
    up = -axis if overturned else axis
    leans = place > 0 and up[2] < _LEVEL
    if up[2] > _ALONG and not leans and (ratio < _DOUBTFUL or overturned):
        return None
    near_m, far_m = sorted((levels.below_m, levels.above_m))
    seen = f"{lidar.topic} is {near_m:.1f} m from a level surface and {far_m:.1f} m from the opposite one"
    if (up[2] > _ALONG and not leans) or not may_change:
        warning = f"z of {base} may not point up: {seen}; check the transforms, or pass --rig FILE"
        return UprightBase(base, np.eye(4), None, warning)
    side = "down" if up[2] < -_ALONG else "aslant" if up[2] > _ALONG else "sideways"
    said = f"z of {base} points {side}: {seen}, and the nearer one is the floor. The base frame is now"
    own = {each.frame_id for each in lidars}
    for frame, T in T_of.items():
        if frame not in own and T[:3, 2] @ up > (_LEVEL if leans else _ALONG):
            return UprightBase(frame, T, None, f"{said} {frame}; --rig FILE overrules that")
    T_base_new = np.eye(4)
    T_base_new[:3, :3] = list(T_of.values())[place][:3, :3] @ (_HALF_TURN if overturned else np.eye(3))
    new = f"{base or 'lidar'}_upright"
    warning = f"{said} {new}, {base or 'the lidar'} turned about its origin; --rig FILE overrules that"
    return UprightBase(new, T_base_new, StaticTransform(base, new, T_base_new), warning)
