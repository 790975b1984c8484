"""Registrations and loops are at their stamps, and at the scan that is shown then."""

import numpy as np
import pytest
from rerun.chunk import RrdReader

from ffmap.algorithms.base import transforms
from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_odometry_frame, log_pose_graph, log_registration
from ffmap.blueprints.entities import SCAN_TIMELINE, STAMP_TIMELINE
from tests import synthetic
from tests.app.record.recordings import rows, start, static, vectors

REGISTRATION = "/metrics/registration"
WEAK = [None, "nothing holds it", None]
STAMPS_NS = [synthetic.stamp_ns(number) for number in range(4)]


def registrations() -> list[Registration]:
    return [
        Registration(
            index=number,
            stamp_ns=STAMPS_NS[number],
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


# Two clouds after the first sweep and before the second; a clock that steps back; none at the end.
FIRST, SECOND, THIRD = STAMPS_NS[:3]
CLOUDS_NS = np.array([FIRST, FIRST + 1, FIRST + 2, SECOND, FIRST + 3, THIRD - 1])


@pytest.mark.parametrize(("clouds_ns", "scans"), [(None, None), (CLOUDS_NS, [0, 3, 5])])
def test_registrations_have_the_scan_of_the_first_cloud_that_is_not_older(
    tmp_path, clouds_ns, scans
):
    recording, path = start(tmp_path, "run-3"), tmp_path / "recording.rrd"
    log = Log(recording.stream, scan_stamps_ns=clouds_ns)
    for registration, weak in zip(registrations(), WEAK, strict=True):
        log_registration(log, registration, weak)
    log.send_rows()
    recording.finish()
    timelines = {
        name
        for chunk in RrdReader(path).stream()
        if chunk.entity_path.startswith((REGISTRATION, "/world/odometry")) and not chunk.is_static
        for name in chunk.timeline_names
    }
    assert timelines == ({STAMP_TIMELINE} if scans is None else {STAMP_TIMELINE, SCAN_TIMELINE})
    if scans is not None:
        assert [row["scan"] for row in rows(path, f"{REGISTRATION}/weak")] == scans
        assert [row["scan"] for row in rows(path, "/messages")] == scans[1:2]

    def found(entity):
        return list(rows(path, entity, STAMP_TIMELINE))

    poses = [vectors(row["translation"])[0][0] for row in found("/world/odometry/sensor")]
    assert poses == [0.0, 1.0, 2.0]
    assert [row["scalars"][0] for row in found(f"{REGISTRATION}/weak")] == [0.0, 1.0, 0.0]
    (weak,) = found("/world/odometry/weak")
    assert vectors(weak["positions"])[0][0] == 1.0
    (message,) = found("/messages")
    assert "registration 1 is weak: nothing holds it" in str(message)
    assert len(found(f"{REGISTRATION}/residual_m")) == 2  # what was not measured is not logged


def test_loops_are_drawn_where_the_solved_poses_are(tmp_path):
    recording, path = start(tmp_path, "run-4"), tmp_path / "recording.rrd"
    T = np.array([transforms.make_transform(translation=[float(i), 0.0, 1.0]) for i in range(4)])
    shifts = [transforms.make_transform(translation=[0.0, 0.1 * i, 0.0]) for i in range(4)]
    shift = np.array(shifts)
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
    log, stamps_ns = Log(recording.stream), np.array(STAMPS_NS)
    T_map_odom = transforms.make_transform(translation=[0.0, 0.0, 2.0])
    log_odometry_frame(log, stamps_ns, T_map_odom @ shift)
    log_pose_graph(log, graph, T_map_odom, stamps_ns, 0.1 * np.arange(4))
    log.send_rows()
    recording.finish()
    frames = [vectors(r["translation"])[0] for r in rows(path, "/world/odometry", STAMP_TIMELINE)]
    np.testing.assert_allclose(frames, [[0.0, 0.1 * i, 2.0] for i in range(4)], atol=1e-6)
    moved = rows(path, f"{REGISTRATION}/loops_moved_m", STAMP_TIMELINE)
    np.testing.assert_allclose([row["scalars"][0] for row in moved], 0.1 * np.arange(4))
    found = static(path)
    loops = found["/world/pose_graph/loops"]
    np.testing.assert_allclose(loops["strips"][0], [[[0, 0, 3], [3, 0.3, 3]]] * 2, atol=1e-6)
    believed, doubted = loops["colors"][0]
    assert believed != doubted  # one of them contradicts the others
    assert loops["labels"][0][1] == "70% fits, 8.0 standard deviations off, weight 0.12"
    before = found["/world/pose_graph/way_of_odometry"]["strips"][0]
    np.testing.assert_allclose(before, [[[i, 0, 3] for i in range(4)]], atol=1e-6)
