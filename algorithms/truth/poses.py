"""A trajectory against another: absolute and relative errors (paper, IV.B)."""

from dataclasses import dataclass
from warnings import catch_warnings

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.trajectory import Trajectory

RELATIVE_M = 1.0
"""Length (m) of true path over which relative errors are measured."""


@dataclass(frozen=True)
class TrajectoryErrors:
    """Errors of n poses.

    error_m: (n,) distance of each position after the best rigid alignment.
    error_unaligned_m: (n,) distance of each position in the map's frame.
    rotation_error_deg: (n,) angle of each orientation after the best rotation.
    relative_translation_m, relative_rotation_deg: (k,) of each motion over `RELATIVE_M`.
    """

    error_m: FloatArray
    error_unaligned_m: FloatArray
    rotation_error_deg: FloatArray
    relative_translation_m: FloatArray
    relative_rotation_deg: FloatArray


def compare_trajectories(found: Trajectory, true: Trajectory) -> TrajectoryErrors:
    """Compare at the time stamps of `found` that `true` covers; empty arrays if there are none."""
    stamp_ns = found.stamp_ns[true.covers(found.stamp_ns)]
    if not len(stamp_ns):
        return TrajectoryErrors(*(np.zeros(0) for _ in range(5)))
    T_map_found, T_map_true = found.at(stamp_ns), true.at(stamp_ns)
    position, position_true = T_map_found[:, :3, 3], T_map_true[:, :3, 3]
    moved = transforms.apply(align(position, position_true), position)
    difference = Rotation.from_matrix(
        T_map_true[:, :3, :3] @ np.swapaxes(T_map_found[:, :3, :3], 1, 2)
    )
    start, end = _motions(position_true)
    motion_found = transforms.invert(T_map_found[start]) @ T_map_found[end]
    motion_true = transforms.invert(T_map_true[start]) @ T_map_true[end]
    error = transforms.invert(motion_true) @ motion_found
    turn = Rotation.from_matrix(error[:, :3, :3]).magnitude() if len(error) else np.zeros(0)
    return TrajectoryErrors(
        error_m=np.linalg.norm(moved - position_true, axis=1),
        error_unaligned_m=np.linalg.norm(position - position_true, axis=1),
        rotation_error_deg=np.degrees((difference * difference.mean().inv()).magnitude()),
        relative_translation_m=np.linalg.norm(error[:, :3, 3], axis=1),
        relative_rotation_deg=np.degrees(turn),
    )


def align(positions_source: FloatArray, positions_target: FloatArray) -> FloatArray:
    """Compute T_target_source (4, 4) that brings positions (n, 3) nearest to their partners.

    Umeyama (1991), without scale.
    """
    centre_source, centre_target = positions_source.mean(axis=0), positions_target.mean(axis=0)
    # About a straight path the rotation is free.
    with catch_warnings(action="ignore", category=UserWarning):
        turn, _ = Rotation.align_vectors(
            positions_target - centre_target, positions_source - centre_source
        )
    return transforms.make_transform(turn, centre_target - turn.apply(centre_source))


def _motions(positions: FloatArray) -> tuple[IntArray, IntArray]:
    """Each pose, and the first later one at least `RELATIVE_M` of path further."""
    steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps_m)])
    end = np.searchsorted(path, path + RELATIVE_M - 1e-9)
    start = np.flatnonzero(end < len(path))
    return start, end[start]
