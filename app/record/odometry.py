"""The trajectory of the robot, and the registration of each horizontal scan."""

import numpy as np
import rerun as rr

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.record.log import Log, times
from ffmap.app.record.shapes import rounded, strips, ui_radius
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints.entities import KEYPOINT_COLOR, LOOP_COLOR, WEAK_COLOR, Color

_ROOT = "/metrics/registration"
_QUALITY = (
    *("threshold_m", "correction_m", "residual_m", "inlier_share", "refined_m"),
    *("refined_inlier_share", "weakest_share", "milliseconds"),
)
"""Fields of a registration that are logged as curves."""
_TRAJECTORY_COLOR: Color = (0, 214, 255)
_LOCAL_MAP_COLOR: Color = (96, 110, 130)
_LOOP_DOUBTED_COLOR: Color = (255, 110, 60)
_ODOMETRY_COLOR: Color = (200, 90, 90)


def log_odometry_styles(log: Log) -> None:
    """Log colours and radii."""
    for path, color, radius_ui in (
        ("/world/odometry/sensor/keypoints", KEYPOINT_COLOR, 2.0),
        ("/world/odometry/local_map", _LOCAL_MAP_COLOR, 1.0),
        ("/world/odometry/weak", WEAK_COLOR, 6.0),
    ):
        log.static(path, rr.Points3D.from_fields(colors=color, radii=ui_radius(radius_ui)))
    line = rr.LineStrips3D.from_fields(colors=_TRAJECTORY_COLOR, radii=ui_radius(2.0))
    log.static("/world/trajectory", line)


def log_trajectory(
    log: Log,
    stamp_ns: IntArray,
    T_map_base: FloatArray,
    index: IntArray | None,
) -> None:
    """Log the way from each pose (n, 4, 4) to the next.

    index: (n,) of the vertical scans; None if the poses are of horizontal ones.
    """
    xyz = T_map_base[:, :3, 3]
    steps = np.stack([np.concatenate([xyz[:1], xyz[:-1]]), xyz], axis=1).astype(np.float32)
    columns = rr.LineStrips3D.columns(strips=steps)
    log.stream.send_columns("/world/trajectory", times(stamp_ns, index), columns)


def log_odometry_frame(log: Log, stamp_ns: IntArray, T_map_odom: FloatArray) -> None:
    """Log the odometry frame (n, 4, 4) in the map; closed loops move it."""
    for at_ns, T in zip(stamp_ns.tolist(), T_map_odom, strict=True):
        log.at_sweep(at_ns)
        log.pose("/world/odometry", T)


def log_pose_graph(
    log: Log, graph: PoseGraph, T_map_odom: FloatArray, stamp_ns: IntArray, moved_m: FloatArray
) -> None:
    """Log submaps, loops, the odometry's trajectory, and the correction of each pose.

    T_map_odom: level of the odometry's map. stamp_ns, moved_m: (n,) of all horizontal scans.
    """
    at = transforms.apply(T_map_odom, graph.T_odom_sensor[:, :3, 3]).astype(np.float32)
    uncorrected = transforms.invert(graph.T_correction) @ graph.T_odom_sensor
    before = transforms.apply(T_map_odom, uncorrected[:, :3, 3]).astype(np.float32)
    loops = np.flatnonzero(graph.is_loop & (graph.weight > 0))
    ends = np.stack([at[graph.first[loops]], at[graph.second[loops]]], axis=1)
    colors = [LOOP_COLOR if graph.weight[e] >= 0.5 else _LOOP_DOUBTED_COLOR for e in loops]
    labels = [
        f"{graph.inlier_share[e]:.0%} fits, {graph.offset[e]:.1f} standard deviations off, "
        f"weight {graph.weight[e]:.2f}"
        for e in loops
    ]
    submaps = rr.Points3D(at, colors=LOOP_COLOR, radii=ui_radius(4.0))
    log.static("/world/pose_graph/submaps", submaps)
    log.static("/world/pose_graph/loops", strips(ends, colors, 0.75, labels, show_labels=False))
    way = [before] if len(before) > 1 else []
    log.static("/world/pose_graph/way_of_odometry", strips(way, _ODOMETRY_COLOR, 1.5))
    for at_ns, moved in zip(stamp_ns.tolist(), moved_m.tolist(), strict=True):
        log.at_sweep(at_ns)
        log.row(f"{_ROOT}/loops_moved_m", rr.Scalars, scalars=[moved])


def log_registration(log: Log, registration: Registration, weak: str | None) -> None:
    """Log the registration of a horizontal scan. weak: why it is unreliable, or None."""
    log.at_sweep(registration.stamp_ns)
    log.pose("/world/odometry/sensor", registration.T_odom_sensor)
    if log.detail is not Detail.MAP:
        keypoints = rounded(registration.keypoints_sensor)
        log.row("/world/odometry/sensor/keypoints", rr.Points3D, positions=keypoints)
        if len(registration.local_map_odom):
            local_map = rounded(registration.local_map_odom)
            log.row("/world/odometry/local_map", rr.Points3D, positions=local_map)
    if weak is not None:
        place = registration.T_odom_sensor[None, :3, 3]
        log.row("/world/odometry/weak", rr.Points3D, positions=place)
        log.message(f"registration {registration.index} is weak: {weak}")
    values = {name: float(getattr(registration, name)) for name in _QUALITY}
    values["keypoint_count"] = len(registration.keypoints_sensor)
    values["weak"] = weak is not None
    for name, value in values.items():
        if np.isfinite(value):
            log.row(f"{_ROOT}/{name}", rr.Scalars, scalars=[float(value)])
