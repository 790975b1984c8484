"""A trajectory against the true one (paper, IV.B): absolute and relative errors."""

from dataclasses import dataclass
from warnings import catch_warnings

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.trajectory import Trajectory

RELATIVE_M = 1.0  # length of true path over which the relative error of a trajectory is taken


@dataclass(frozen=True)
class TrajectoryFigures:
    """A trajectory against the truth.

    error_m: (n,) distance of each position after the rotation and shift that fit best (Umeyama, without scale).
    error_unaligned_m: (n,) distance of each position as it stands in the map's frame.
    rotation_error_deg: (n,) angle of each orientation after the turn that fits the orientations best.
    relative_translation_m, relative_rotation_deg: (k,) error of each motion over `RELATIVE_M` of true path.
    """

    error_m: FloatArray
    error_unaligned_m: FloatArray
    rotation_error_deg: FloatArray
    relative_translation_m: FloatArray
    relative_rotation_deg: FloatArray

    @property
    def poses(self) -> int:
        return len(self.error_m)

    @property
    def ate_rmse_m(self) -> float:
        return rms(self.error_m)


def compare_trajectories(found: Trajectory, true: Trajectory) -> TrajectoryFigures:
    """Errors at the stamps of `found` that `true` covers; empty arrays where there are none."""
    stamp_ns = found.stamp_ns[true.covers(found.stamp_ns)]
    if not len(stamp_ns):
        none = np.zeros(0)
        return TrajectoryFigures(none, none, none, none, none)
    T_map_found, T_map_true = found.at(stamp_ns), true.at(stamp_ns)
    moved = transforms.apply(align(T_map_found[:, :3, 3], T_map_true[:, :3, 3]), T_map_found[:, :3, 3])
    difference = Rotation.from_matrix(T_map_true[:, :3, :3] @ np.swapaxes(T_map_found[:, :3, :3], 1, 2))
    start, end = _motions(T_map_true[:, :3, 3])
    motion_found = transforms.invert(T_map_found[start]) @ T_map_found[end]
    motion_true = transforms.invert(T_map_true[start]) @ T_map_true[end]
    error = transforms.invert(motion_true) @ motion_found
    return TrajectoryFigures(
        error_m=np.linalg.norm(moved - T_map_true[:, :3, 3], axis=1),
        error_unaligned_m=np.linalg.norm(T_map_found[:, :3, 3] - T_map_true[:, :3, 3], axis=1),
        rotation_error_deg=np.degrees((difference * difference.mean().inv()).magnitude()),
        relative_translation_m=np.linalg.norm(error[:, :3, 3], axis=1),
        relative_rotation_deg=(
            np.degrees(Rotation.from_matrix(error[:, :3, :3]).magnitude()) if len(error) else np.zeros(0)
        ),
    )


def align(positions_source: FloatArray, positions_target: FloatArray) -> FloatArray:
    """T_target_source (4, 4) that brings positions (n, 3) nearest to their partners (Umeyama 1991, without scale)."""
    centre_source, centre_target = positions_source.mean(axis=0), positions_target.mean(axis=0)
    with catch_warnings(action="ignore", category=UserWarning):  # the turn about a straight path is free
        turn, _ = Rotation.align_vectors(positions_target - centre_target, positions_source - centre_source)
    return transforms.make_transform(turn, centre_target - turn.apply(centre_source))


def rms(values: FloatArray) -> float:
    """Root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def _motions(positions: FloatArray) -> tuple[IntArray, IntArray]:
    """Each pose, and the first later one at least `RELATIVE_M` of path further."""
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    end = np.searchsorted(path, path + RELATIVE_M - 1e-9)
    start = np.flatnonzero(end < len(path))
    return start, end[start]
