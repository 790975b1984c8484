"""The trajectory of the robot, and the registration of each horizontal scan."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.record.log import Log, times
from ffmap.app.record.shapes import rounded, strips, transform_columns, ui_radius
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
    previous_T_map_base: FloatArray | None = None,
) -> None:
    """Log the way from each pose (n, 4, 4) to the next.

    index: (n,) of the vertical scans; None if the poses are of horizontal ones.
    previous_T_map_base: last pose of an earlier call.
    """
    xyz = T_map_base[:, :3, 3]
    before = xyz[:1] if previous_T_map_base is None else previous_T_map_base[None, :3, 3]
    steps = np.stack([np.concatenate([before, xyz[:-1]]), xyz], axis=1).astype(np.float32)
    columns = rr.LineStrips3D.columns(strips=steps)
    log.stream.send_columns("/world/trajectory", times(stamp_ns, index), columns)


def log_odometry_frame(log: Log, stamp_ns: IntArray, T_map_odom: FloatArray) -> None:
    """Log the odometry frame (n, 4, 4) in the map; closed loops move it."""
    log.columns("/world/odometry", stamp_ns, transform_columns(T_map_odom))


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
    log.columns(f"{_ROOT}/loops_moved_m", stamp_ns, rr.Scalars.columns(scalars=moved_m))


def log_registrations(
    log: Log, registrations: Sequence[Registration], weak: Sequence[str | None]
) -> None:
    """Log registrations of horizontal scans. weak: why each is unreliable, or None.

    Many in one call: one by one they would cost the main process more than all else.
    """
    if not registrations:
        return
    stamp_ns = np.array([r.stamp_ns for r in registrations])
    T_odom_sensor = np.array([r.T_odom_sensor for r in registrations])
    log.columns("/world/odometry/sensor", stamp_ns, transform_columns(T_odom_sensor))
    if log.detail is not Detail.MAP:
        keypoints = [r.keypoints_sensor for r in registrations]
        _log_clouds(log, "/world/odometry/sensor/keypoints", stamp_ns, keypoints)
        mapped = [r for r in registrations if len(r.local_map_odom)]
        mapped_ns = np.array([r.stamp_ns for r in mapped])
        local_maps = [r.local_map_odom for r in mapped]
        _log_clouds(log, "/world/odometry/local_map", mapped_ns, local_maps)
    alarms = [(r, why) for r, why in zip(registrations, weak, strict=True) if why is not None]
    if alarms:
        alarm_ns = np.array([r.stamp_ns for r, _ in alarms])
        places = np.array([r.T_odom_sensor[:3, 3] for r, _ in alarms], np.float32)
        log.columns("/world/odometry/weak", alarm_ns, rr.Points3D.columns(positions=places))
        texts = [f"registration {r.index} is weak: {why}" for r, why in alarms]
        levels = [rr.TextLogLevel.WARN] * len(alarms)
        log.columns("/messages", alarm_ns, rr.TextLog.columns(text=texts, level=levels))
    curves = {name: [getattr(r, name) for r in registrations] for name in _QUALITY}
    curves["keypoint_count"] = [len(r.keypoints_sensor) for r in registrations]
    curves["weak"] = [why is not None for why in weak]
    for name, values in curves.items():
        scalars = np.array(values, np.float64)
        known = np.isfinite(scalars)
        columns = rr.Scalars.columns(scalars=scalars[known])
        log.columns(f"{_ROOT}/{name}", stamp_ns[known], columns)


def _log_clouds(log: Log, path: str, stamp_ns: IntArray, clouds: Sequence[FloatArray]) -> None:
    """Log clouds (k, 3) at the stamps of horizontal scans."""
    if clouds:
        columns = rr.Points3D.columns(positions=rounded(np.concatenate(clouds)))
        log.columns(path, stamp_ns, columns.partition([len(cloud) for cloud in clouds]))
