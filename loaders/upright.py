"""The base frame made upright where the clouds contradict the transforms."""

from dataclasses import replace

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.poses.which_way_up import find_levels, upright_axis
from ffmap.loaders.extrinsics import Placement
from ffmap.loaders.frames import FrameTree, StaticTransform

_ALONG = 0.9  # Minimum cosine between a frame's axis and the upright axis
_LEVEL = 0.97  # The same for a map that its floor can level: it slopes by up to 15 degrees
_OVERTURNED = 1.5  # Minimum ratio of the distances to floor and ceiling of an overturned base
_DOUBTFUL = 4 / 3  # The same where a frame's z contradicts the base's, and for a warning
_BASE_MAX_M = 0.35  # Height of a base's origin: on the floor, or at the axles
_HALF_TURN = np.diag([1.0, -1.0, -1.0])


def make_upright(placement: Placement, warnings: list[str], may_change: bool) -> Placement:
    """Choose a base whose z points up; the same placement where the clouds show that it does.

    may_change: whether the base may be another frame; else there is only a warning.
    """
    base, lidars = placement.base, placement.candidates
    tree = FrameTree(placement.edges)
    above = {frame for lidar in lidars for frame in tree.above(lidar.frame_id)}
    frames = [base, *sorted(above - {base}, key=lambda frame: (len(tree.above(frame)), frame))]
    T_of = {frame: T for frame in frames if (T := tree.between(base, frame)) is not None}
    axes = [T[:3, 2] for T in T_of.values()]
    densest = []
    for axis in axes:
        levels = [
            find_levels([points @ c.T_base_sensor[:3, :3].T for points in c.clouds], axis)
            for c in lidars
        ]
        densest.append(max(zip(levels, lidars, strict=True), key=lambda found: found[0].share))
    place = upright_axis([levels for levels, _ in densest])
    if place is None:
        return placement
    (level, lidar), axis = densest[place], axes[place]
    ratio = level.below_m / level.above_m
    if abs(level.below_m - float(axis @ lidar.T_base_sensor[:3, 3])) < _BASE_MAX_M:
        ratio = 0.0  # The base is on the floor, and a mast carries the lidar
    contradicted = any(float(other @ axis) < -_ALONG for other in axes)
    overturned = ratio >= (_DOUBTFUL if contradicted else _OVERTURNED)
    up = -axis if overturned else axis
    leans = place > 0 and up[2] < _LEVEL
    points_up = up[2] > _ALONG and not leans
    if points_up and (ratio < _DOUBTFUL or overturned):
        return placement
    near_m, far_m = sorted((level.below_m, level.above_m))
    seen = (
        f"{lidar.topic} is {near_m:.1f} m from a level surface and {far_m:.1f} m from the "
        "opposite one"
    )
    if points_up or not may_change:
        warnings.append(
            f"z of {base} may not point up: {seen}; check the transforms, or pass --rig FILE"
        )
        return placement
    least = _LEVEL if leans else _ALONG
    own = {c.frame_id for c in lidars}
    upright = (frame for frame, T in T_of.items() if frame not in own and T[:3, 2] @ up > least)
    frame, edges = next(upright, None), placement.edges
    name = frame or f"{base or 'lidar'}_upright"
    if frame is not None:
        T_base_new = T_of[frame]
    else:
        T_base_new = np.eye(4)
        turn = _HALF_TURN if overturned else np.eye(3)
        T_base_new[:3, :3] = list(T_of.values())[place][:3, :3] @ turn
        edges = (*edges, StaticTransform(base, name, T_base_new))
    side = "down" if up[2] < -_ALONG else "aslant" if up[2] > _ALONG else "sideways"
    how = "" if frame else f", {base or 'the lidar'} turned about its origin"
    warnings.append(
        f"z of {base} points {side}: {seen}, and the nearer one is the floor. The base frame is "
        f"now {name}{how}; --rig FILE overrules that"
    )
    T_new_base: FloatArray = transforms.invert(T_base_new)
    placed = [replace(c, T_base_sensor=T_new_base @ c.T_base_sensor) for c in lidars]
    return Placement(placed, name, edges)
