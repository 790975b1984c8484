"""Registrations and loops lie at their stamps, and at the scan that is shown then."""

from pathlib import Path

import numpy as np
from rerun.chunk import RrdReader

from ffmap.algorithms.base import transforms
from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_odometry_frame, log_pose_graph, log_registrations
from ffmap.blueprints import entities
from tests import synthetic
from tests.app.record.recordings import rows, start, static, vectors


def registrations() -> list[Registration]:
    return [
        Registration(
            index=number,
            stamp_ns=synthetic.stamp_ns(number),
            T_odom_sensor=transforms.make_transform(translation=[number, 0.0, 0.0]),
            keypoints_sensor=np.full((5, 3), float(number)),
            local_map_odom=np.zeros((0, 3)),
            threshold_m=0.4,
            correction_m=0.01,
            residual_m=0.02 if number else float("nan"),
            refined_m=0.02,
            refined_inlier_share=0.9,
            weakest_share=0.1,
            refused=False,
            agreement=float("nan"),
            rival=float("nan"),
            inlier_share=0.9,
            milliseconds=12.0,
        )
        for number in range(3)
    ]


def timelines_of(path: Path) -> set[str]:
    """Of what is logged of horizontal scans."""
    return {
        name
        for chunk in RrdReader(path).stream()
        if chunk.entity_path.startswith(("/world/odometry", "/metrics/registration")) and not chunk.is_static
        for name in chunk.timeline_names
    }


def test_registrations_lie_on_stamp_alone_where_there_are_no_vertical_scans(tmp_path):
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-3")
    log = Log(recording.stream)
    log_registrations(log, registrations(), [None, "nothing holds it", None])
    recording.finish()
    assert timelines_of(path) == {entities.STAMP_TIMELINE}
    poses = [vectors(row["translation"])[0][0] for row in rows(path, "/world/odometry/sensor", entities.STAMP_TIMELINE)]
    assert poses == [0.0, 1.0, 2.0]
    alarms = [row["scalars"][0] for row in rows(path, "/metrics/registration/weak", entities.STAMP_TIMELINE)]
    assert alarms == [0.0, 1.0, 0.0]
    (weak,) = rows(path, "/world/odometry/weak", entities.STAMP_TIMELINE)
    assert vectors(weak["positions"])[0][0] == 1.0
    (message,) = rows(path, entities.MESSAGES, entities.STAMP_TIMELINE)
    assert "registration 1 is weak: nothing holds it" in str(message)
    residuals = list(rows(path, "/metrics/registration/residual_m", entities.STAMP_TIMELINE))
    assert len(residuals) == 2  # what was not measured is not drawn


def test_registrations_have_the_scan_of_the_first_vertical_cloud_that_is_not_older(tmp_path):
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-3")
    # Two clouds after the first sweep and before the second; a clock that steps back; none after the last sweep.
    first, second, third = (synthetic.stamp_ns(number) for number in range(3))
    scan_stamps_ns = np.array([first, first + 1, first + 2, second, first + 3, third - 1])
    log = Log(recording.stream, scan_stamps_ns=scan_stamps_ns)
    log_registrations(log, registrations(), [None, "nothing holds it", None])
    log_odometry_frame(log, np.array([second]), np.eye(4)[None])
    recording.finish()
    assert timelines_of(path) == {entities.STAMP_TIMELINE, entities.SCAN_TIMELINE}
    alarms = [(row["scan"], row["scalars"][0]) for row in rows(path, "/metrics/registration/weak")]
    assert alarms == [(0, 0.0), (3, 1.0), (5, 0.0)]
    assert [row["scan"] for row in rows(path, "/world/odometry/sensor/keypoints")] == [0, 3, 5]
    assert [row["scan"] for row in rows(path, "/world/odometry")] == [3]
    assert [row["scan"] for row in rows(path, entities.MESSAGES)] == [3]


def test_loops_are_drawn_where_the_solved_poses_are(tmp_path):
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-4")
    T = np.array([transforms.make_transform(translation=[float(i), 0.0, 1.0]) for i in range(4)])
    shift = np.array([transforms.make_transform(translation=[0.0, 0.1 * i, 0.0]) for i in range(4)])
    graph = PoseGraph(
        T_odom_first=T[0],
        scan=np.arange(4) * 10,
        T_odom_sensor=shift @ T,
        T_correction=shift,
        first=np.array([0, 0, 0]),
        second=np.array([1, 3, 3]),
        offset=np.array([0.5, 1.0, 8.0]),
        inlier_share=np.array([0.9, 0.8, 0.7]),
        weight=np.array([1.0, 0.9, 0.12]),
    )
    stamps = np.array([synthetic.stamp_ns(number) for number in range(4)])
    T_map_odom = transforms.make_transform(translation=[0.0, 0.0, 2.0])
    log = Log(recording.stream)
    log_odometry_frame(log, stamps, T_map_odom @ shift)
    log_pose_graph(log, graph, T_map_odom, stamps, 0.1 * np.arange(4))
    recording.finish()
    frames = [vectors(r["translation"])[0] for r in rows(path, "/world/odometry", entities.STAMP_TIMELINE)]
    np.testing.assert_allclose(frames, [[0.0, 0.1 * i, 2.0] for i in range(4)], atol=1e-6)
    moved = [r["scalars"][0] for r in rows(path, "/metrics/registration/loops_moved_m", entities.STAMP_TIMELINE)]
    np.testing.assert_allclose(moved, 0.1 * np.arange(4))
    found = static(path)
    loops = found["/world/pose_graph/loops"]
    np.testing.assert_allclose(loops["strips"][0], [[[0, 0, 3], [3, 0.3, 3]]] * 2, atol=1e-6)
    believed, doubted = loops["colors"][0]
    assert believed != doubted  # one of them contradicts the others
    assert loops["labels"][0][1] == "70% fits, 8.0 standard deviations off, weight 0.12"
    before = found["/world/pose_graph/way_of_odometry"]["strips"][0]
    np.testing.assert_allclose(before, [[[i, 0, 3] for i in range(4)]], atol=1e-6)
