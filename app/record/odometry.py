"""The way of the robot, and how well each horizontal scan was registered."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.record.log import Log, times
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities

_QUALITY = (
    *("threshold_m", "correction_m", "residual_m", "inlier_share", "refined_m", "refined_inlier_share"),
    *("weakest_share", "milliseconds"),
)
"""Figures of a registration that are drawn as curves."""


def log_trajectory(
    log: Log,
    stamp_ns: IntArray,
    T_map_base: FloatArray,
    index: IntArray | None,
    previous_T_map_base: FloatArray | None = None,
) -> None:
    """The way from each pose to the next; `previous_T_map_base` carries on an earlier call.

    stamp_ns: (n,); T_map_base: (n, 4, 4); index: (n,) of the vertical scans, None where the poses are of horizontal
    ones, which lie on `stamp` alone.
    """
    xyz = T_map_base[:, :3, 3]
    before = xyz[:1] if previous_T_map_base is None else previous_T_map_base[None, :3, 3]
    steps = np.stack([np.concatenate([before, xyz[:-1]]), xyz], axis=1).astype(np.float32)
    log.stream.send_columns(entities.TRAJECTORY, times(stamp_ns, index), rr.LineStrips3D.columns(strips=steps))


def log_odometry_frame(log: Log, stamp_ns: IntArray, T_map_odom: FloatArray) -> None:
    """Where the odometry's frame lies in the levelled map; it moves as the loops that were closed correct its drift.

    stamp_ns: (n,); T_map_odom: (n, 4, 4).
    """
    log.transforms(entities.ODOMETRY, stamp_ns, T_map_odom)


def log_pose_graph(log: Log, graph: PoseGraph, T_map_odom: FloatArray, stamp_ns: IntArray, moved_m: FloatArray) -> None:
    """The submaps, the loops between them, the way as the odometry had it, and how far each pose was moved.

    T_map_odom: (4, 4) before any loop. stamp_ns, moved_m: (n,) of all scans.
    """
    T_before = transforms.invert(graph.T_correction) @ graph.T_odom_sensor
    at, before = (transforms.apply(T_map_odom, T[:, :3, 3]).astype(np.float32) for T in (graph.T_odom_sensor, T_before))
    loops = np.flatnonzero(graph.is_loop & (graph.weight > 0))
    strips = np.stack([at[graph.first[loops]], at[graph.second[loops]]], axis=1)
    colors = [entities.LOOP_COLOR if graph.weight[e] >= 0.5 else entities.LOOP_DOUBTED_COLOR for e in loops]
    labels = [
        f"{graph.inlier_share[e]:.0%} fits, {graph.offset[e]:.1f} standard deviations off, weight {graph.weight[e]:.2f}"
        for e in loops
    ]
    log.static(entities.SUBMAPS, rr.Points3D(at))
    log.static(entities.LOOPS, rr.LineStrips3D(strips, colors=colors, labels=labels, show_labels=False))
    log.static(entities.WAY_OF_ODOMETRY, rr.LineStrips3D([before] if len(before) > 1 else []))
    log.columns(f"{entities.REGISTRATION}/loops_moved_m", stamp_ns, rr.Scalars.columns(scalars=moved_m))


def log_registrations(log: Log, registrations: Sequence[Registration], weak: Sequence[str | None]) -> None:
    """What was registered of horizontal scans, and how well it fits.

    Many at once: logged one by one they cost the run's own process more than all else that it logs.

    weak: for each in words why it is not to be relied on, or None.
    """
    if not registrations:
        return
    stamp_ns = np.array([r.stamp_ns for r in registrations])
    log.transforms(entities.ODOMETRY_SENSOR, stamp_ns, np.array([r.T_odom_sensor for r in registrations]))
    if log.detail is not Detail.MAP:
        log.clouds(entities.KEYPOINTS, stamp_ns, [r.keypoints_sensor for r in registrations])
        mapped = [r for r in registrations if len(r.local_map_odom)]
        log.clouds(entities.LOCAL_MAP, np.array([r.stamp_ns for r in mapped]), [r.local_map_odom for r in mapped])
    alarms = [(r, why) for r, why in zip(registrations, weak, strict=True) if why is not None]
    if alarms:
        alarm_ns = np.array([r.stamp_ns for r, _ in alarms])
        places = np.array([r.T_odom_sensor[:3, 3] for r, _ in alarms], np.float32)
        log.columns(entities.WEAK_REGISTRATION, alarm_ns, rr.Points3D.columns(positions=places))
        texts = [f"registration {r.index} is weak: {why}" for r, why in alarms]
        levels = [rr.TextLogLevel.WARN] * len(alarms)
        log.columns(entities.MESSAGES, alarm_ns, rr.TextLog.columns(text=texts, level=levels))
    quality = {name: [getattr(r, name) for r in registrations] for name in _QUALITY}
    quality["keypoint_count"] = [len(r.keypoints_sensor) for r in registrations]
    quality["weak"] = [why is not None for why in weak]
    for name, values in quality.items():
        scalars = np.array(values, np.float64)
        known = np.isfinite(scalars)
        log.columns(f"{entities.REGISTRATION}/{name}", stamp_ns[known], rr.Scalars.columns(scalars=scalars[known]))
