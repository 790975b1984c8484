"""Rigid transforms as (4, 4) float64 matrices, named T_target_source.

p_target = T_target_source @ p_source.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.scan import FloatArray


def rotation_of(T: FloatArray) -> Rotation:
    """The rotations of rigid transforms (..., 4, 4); unchecked, which is ten times as fast."""
    return Rotation.from_matrix(T[..., :3, :3], assume_valid=True)


def make_transform(
    rotation: Rotation | None = None, translation: FloatArray | list[float] | None = None
) -> FloatArray:
    """T_target_source (4, 4) from a rotation and a translation in metres; default: identity."""
    T = np.eye(4)
    if rotation is not None:
        T[:3, :3] = rotation.as_matrix()
    if translation is not None:
        T[:3, 3] = translation
    return T


def from_quaternion(
    translation: FloatArray | list[float], quaternion_xyzw: FloatArray | list[float]
) -> FloatArray:
    """T_target_source (4, 4) from ROS's x y z in metres and quaternion x y z w."""
    return make_transform(Rotation.from_quat(quaternion_xyzw), translation)


def invert(T_target_source: FloatArray) -> FloatArray:
    """T_source_target (..., 4, 4)."""
    R = np.swapaxes(T_target_source[..., :3, :3], -1, -2)
    T = np.zeros_like(T_target_source)
    T[..., :3, :3] = R
    T[..., :3, 3] = -(R @ T_target_source[..., :3, 3:4])[..., 0]
    T[..., 3, 3] = 1.0
    return T


def apply(T_target_source: FloatArray, points_source: FloatArray) -> FloatArray:
    """Points (n, 3) in the target's frame."""
    return np.asarray(points_source @ T_target_source[:3, :3].T + T_target_source[:3, 3])


def quaternion_xyzw(T_target_source: FloatArray) -> FloatArray:
    """Quaternions (..., 4) in ROS's order x y z w, w ≥ 0."""
    flat = T_target_source[..., :3, :3].reshape(-1, 3, 3)
    quaternions = rotation_of(flat).as_quat(canonical=True)
    return np.asarray(quaternions.reshape(*T_target_source.shape[:-2], 4))


def yaw_of(T_target_source: FloatArray) -> float:
    """Heading in radians of the source's x axis in the target's xy plane."""
    return float(np.arctan2(T_target_source[1, 0], T_target_source[0, 0]))


def from_yaw(yaw_rad: float, translation: FloatArray | list[float]) -> FloatArray:
    """T_target_source (4, 4) with a rotation about z only."""
    return make_transform(Rotation.from_euler("z", yaw_rad), translation)


def interpolated(T_before: FloatArray, T_after: FloatArray, fraction: FloatArray) -> FloatArray:
    """Poses (n, 4, 4) at a fraction (n,) between two: positions linearly, rotations by slerp."""
    turn = rotation_of(np.swapaxes(T_before[:, :3, :3], 1, 2) @ T_after[:, :3, :3]).as_rotvec()
    turned = Rotation.from_rotvec(fraction[:, None] * turn).as_matrix()
    T = T_before.copy()
    T[:, :3, :3] = T_before[:, :3, :3] @ turned
    T[:, :3, 3] += fraction[:, None] * (T_after[:, :3, 3] - T_before[:, :3, 3])
    return T


def orthonormal(T: FloatArray) -> FloatArray:
    """T (4, 4) with the nearest rotation to its linear part."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    nearest = T.copy()
    nearest[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return nearest


def to_twist(T: FloatArray) -> FloatArray:
    """(6,): rotation vector and translation."""
    return np.concatenate([rotation_of(T).as_rotvec(), T[:3, 3]])


def from_twist(twist: FloatArray) -> FloatArray:
    """T (4, 4) of a rotation vector and a translation (6,)."""
    return make_transform(Rotation.from_rotvec(twist[:3]), twist[3:])
