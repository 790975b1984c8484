"""KISS-ICP and its refinement on a lidar that is driven through a box with pillars: the way is known."""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.poses.gaussian_map import Aligned, GaussianCloud, GaussianMap
from ffmap.algorithms.poses.odometry import OdometrySettings, Registration, register_scans, weakness
from ffmap.algorithms.poses.refinement import Refinement, RefinementSettings, Refiner, may_change
from tests import synthetic

PERIOD_NS = 100_000_000
LOW_M, HIGH_M = np.array([-5.0, -3.0, 0.0]), np.array([7.0, 3.5, 2.8])
PILLARS_M = np.array([[[-3.0, 1.5, 0.0], [-2.6, 1.9, 2.8]], [[2.0, -2.2, 0.0], [2.5, -1.7, 2.8]]])
T_BASE_HORIZONTAL = transforms.make_transform(None, [0.0, 0.0, 1.0])
T_BASE_VERTICAL = transforms.make_transform(Rotation.from_euler("y", 90, degrees=True), [0.1, 0.0, 0.8])


def true_pose(time_s: float) -> FloatArray:
    """T_map_base: half a second at rest, then 0.6 m/s in a gentle curve."""
    driven = max(time_s - 0.5, 0.0)
    yaw = 0.15 * driven
    return transforms.from_yaw(yaw, [0.6 * driven * np.cos(yaw / 2), 0.6 * driven * np.sin(yaw / 2), 0.0])


def sweep(index: int, T_base_sensor: FloatArray, seed: int, shift_ns: int = 0) -> Scan:
    """16 rings; every firing at its own time and pose, 1 cm of noise."""
    firings, rings = 600, 16
    azimuth = np.repeat((np.arange(firings) + 0.5) * 2 * np.pi / firings, rings)
    elevation = np.tile(np.radians(np.linspace(-15, 15, rings)), firings)
    rays = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    start_ns = index * PERIOD_NS + shift_ns
    time_ns = np.repeat(np.arange(firings) * PERIOD_NS // firings, rings)
    range_m = np.empty(len(rays))
    for firing in range(firings):
        own = slice(firing * rings, (firing + 1) * rings)
        T = true_pose((start_ns + time_ns[own][0]) * 1e-9) @ T_base_sensor
        range_m[own] = ranges(T[:3, 3], rays[own] @ T[:3, :3].T)
    range_m += np.random.default_rng((seed, index)).normal(0, 0.01, len(range_m))
    count = len(rays)
    return Scan(
        points_sensor=(rays * range_m[:, None]).astype(np.float32),
        ring=np.tile(np.arange(rings, dtype=np.uint16), firings),
        ring_count=rings,
        time_ns=time_ns.astype(np.int64),
        start_ns=start_ns,
        stamp_ns=start_ns,
        cloud_index=np.arange(count, dtype=np.int32),
        cloud_size=count,
    )


def ranges(origin: FloatArray, rays: FloatArray) -> FloatArray:
    return ranges_in_box(origin, rays, LOW_M, HIGH_M, PILLARS_M)


def ranges_in_box(
    origin: FloatArray, rays: FloatArray, low_m: FloatArray, high_m: FloatArray, pillars_m: FloatArray
) -> FloatArray:
    nearest = np.where(rays > 0, (high_m - origin) / rays, (low_m - origin) / rays).min(axis=1)
    for pillar in pillars_m:
        to_faces = (pillar[:, None] - origin) / rays
        near, far = to_faces.min(axis=0).max(axis=1), to_faces.max(axis=0).min(axis=1)
        nearest = np.where((near < far) & (near > 0) & (near < nearest), near, nearest)
    return nearest


@pytest.fixture(scope="module")
def scans() -> list[tuple[int, Scan, Scan | None]]:
    """The other lidar turns half a sweep later."""
    horizontal = [sweep(i, T_BASE_HORIZONTAL, 1) for i in range(40)]
    vertical = [sweep(i, T_BASE_VERTICAL, 2, PERIOD_NS // 2) for i in range(40)]
    return [(i, scan, vertical[i - 1] if i else None) for i, scan in enumerate(horizontal)]


def errors(found: list[Registration]) -> tuple[FloatArray, FloatArray]:
    """Metres and degrees from the true poses, all seen from the first."""
    T_true = np.array([true_pose(r.stamp_ns * 1e-9) @ T_BASE_HORIZONTAL for r in found])
    T_found = np.array([r.T_odom_sensor for r in found])
    off = transforms.invert(transforms.invert(T_true[:1]) @ T_true) @ transforms.invert(T_found[:1]) @ T_found
    return np.linalg.norm(off[:, :3, 3], axis=1), np.degrees(Rotation.from_matrix(off[:, :3, :3]).magnitude())


@pytest.mark.parametrize("companions", [True, False])
def test_the_way_through_a_box_is_found(scans: list[tuple[int, Scan, Scan | None]], companions: bool) -> None:
    given = scans if companions else [(i, scan, None) for i, scan, _ in scans]
    T_sensor_companion = transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL
    found = list(register_scans(given, OdometrySettings(), RefinementSettings(), T_sensor_companion))
    assert [r.index for r in found] == list(range(40))
    assert [r.stamp_ns for r in found] == [(scan.start_ns + scan.end_ns) // 2 for _, scan, _ in scans]
    off_m, off_deg = errors(found)
    # Two metres driven, 30 degrees turned.
    assert off_m.max() < 0.03
    assert off_deg.max() < 1.0
    # The first scans see what the map does not hold yet.
    assert np.nanmedian([r.refined_inlier_share for r in found]) > 0.8
    assert all(0 < r.weakest_share <= 1 for r in found)
    for r in found:
        np.testing.assert_allclose(r.T_odom_sensor[:3, :3] @ r.T_odom_sensor[:3, :3].T, np.eye(3), atol=1e-9)


def test_the_refinement_can_be_left_out(scans: list[tuple[int, Scan, Scan | None]]) -> None:
    found = list(register_scans(scans[:15], OdometrySettings(), RefinementSettings(enabled=False)))
    assert np.isnan([r.weakest_share for r in found]).all()
    assert {r.refined_m for r in found} == {0.0}
    assert errors(found)[0].max() < 0.1


def test_the_same_scans_give_the_same_poses(scans: list[tuple[int, Scan, Scan | None]]) -> None:
    runs = [
        np.array([r.T_odom_sensor for r in register_scans(scans[:12], OdometrySettings(), RefinementSettings())])
        for _ in range(2)
    ]
    np.testing.assert_array_equal(*runs)


def test_a_cloud_of_nothing_keeps_the_odometrys_motion(scans: list[tuple[int, Scan, Scan | None]]) -> None:
    index, scan, _ = scans[5]
    few = np.flatnonzero(np.arange(len(scan)) % 2000 == 0)
    assert scan.time_ns is not None
    thin = Scan(
        scan.points_sensor[few],
        scan.ring[few],
        scan.ring_count,
        scan.time_ns[few],
        scan.start_ns,
        scan.stamp_ns,
        scan.cloud_index[few],
        scan.cloud_size,
    )
    found = list(
        register_scans([*scans[:5], (index, thin, None), *scans[6:8]], OdometrySettings(), RefinementSettings())
    )
    assert len(found) == 8
    assert np.isfinite([r.T_odom_sensor for r in found]).all()


@pytest.mark.parametrize("later_ns", [-20_000_000, 0, 1_000])
@pytest.mark.parametrize("refined", [True, False])
def test_a_scan_that_is_not_later_than_the_one_before_gets_no_pose_and_spoils_none(
    scans: list[tuple[int, Scan, Scan | None]], refined: bool, later_ns: int, capfd: pytest.CaptureFixture[str]
) -> None:
    _, scan, _ = scans[4]
    again = replace(scan, start_ns=scan.start_ns + later_ns)
    given = [*scans[:5], (99, again, None), *scans[5:9]]
    found = list(register_scans(given, OdometrySettings(), RefinementSettings(enabled=refined)))
    assert [r.index for r in found] == list(range(9))
    assert errors(found)[0].max() < 0.1
    assert "out of range" not in capfd.readouterr().err


def test_a_bare_corridor_raises_the_alarm_and_a_room_does_not(
    scans: list[tuple[int, Scan, Scan | None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    room = list(register_scans(scans[:12], OdometrySettings(), RefinementSettings()))
    assert [weakness(r) for r in room] == [None] * 12
    monkeypatch.setattr(
        sys.modules[__name__],
        "ranges",
        lambda origin, rays: ranges_in_box(
            origin, rays, np.array([-300.0, -1.2, 0.0]), np.array([300.0, 1.2, 2.8]), np.zeros((0, 2, 3))
        ),
    )
    given = [(i, sweep(i, T_BASE_HORIZONTAL, 1), None) for i in range(8)]
    corridor = list(register_scans(given, OdometrySettings(range_max_m=20.0), RefinementSettings()))
    alarms = [weakness(r) for r in corridor]
    assert alarms[0] is None  # the first scan is the map, of which the second one knows little
    assert all(why is not None and "nothing holds it in one direction" in why for why in alarms[2:])


def test_the_second_scan_is_not_judged_by_a_map_of_one_scan(
    scans: list[tuple[int, Scan, Scan | None]],
) -> None:
    found = list(register_scans(scans[:3], OdometrySettings(), RefinementSettings()))
    assert [bool(np.isnan(r.refined_inlier_share)) for r in found] == [False, True, False]


def test_a_scan_of_another_place_raises_the_alarm(scans: list[tuple[int, Scan, Scan | None]]) -> None:
    index, scan, _ = scans[5]
    elsewhere = replace(scan, points_sensor=(scan.points_sensor + np.float32([40.0, 0.0, 9.0])))
    found = list(register_scans([*scans[:5], (index, elsewhere, None)], OdometrySettings(), RefinementSettings()))
    why = weakness(found[-1])
    assert why is not None
    assert "of the scan fits the map" in why


def test_a_robot_that_swings_to_and_fro_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """From 80 degrees a second to the left to as much to the right within a second: no scan moves as the last one did."""

    def swinging(time_s: float) -> FloatArray:
        return transforms.from_yaw(np.radians(25.0) * (1.0 - np.cos(3.3 * max(time_s - 0.5, 0.0))), [0.0, 0.0, 0.0])

    monkeypatch.setattr(sys.modules[__name__], "true_pose", swinging)
    given = [(i, sweep(i, T_BASE_HORIZONTAL, 1), None) for i in range(30)]
    found = list(register_scans(given, OdometrySettings(), RefinementSettings()))
    assert not any(r.refused for r in found)
    off_m, off_deg = errors(found)
    assert off_deg.max() < 0.5
    assert off_m.max() < 0.05


@pytest.mark.parametrize(("turn_deg", "far_m", "jumps"), [(5, 0.0, False), (-5, 0.1, False), (7, 0.0, True), (0, 0.2, True)])
def test_a_turn_that_robots_brake_from_is_no_jump(turn_deg: float, far_m: float, jumps: bool) -> None:
    T = transforms.make_transform(Rotation.from_euler("z", turn_deg, degrees=True), [far_m, 0.0, 0.0])
    assert (may_change(PERIOD_NS).share_of(np.eye(4), T) > 1.0) == jumps


def jumping(monkeypatch: pytest.MonkeyPatch, off: FloatArray, times: int, fits: float = 1.0) -> list[FloatArray]:
    """Registration falls for another place, `off` from the right one, `times` times; returns what it is given as guesses.

    fits: the share of what fits at the right place that fits there.
    """
    register = GaussianMap.register
    guesses: list[FloatArray] = []

    def fooled(self: GaussianMap, cloud: GaussianCloud, guess: FloatArray, *limits: float) -> Aligned:
        guesses.append(guess)
        found = register(self, cloud, guess, *limits)  # type: ignore[arg-type]
        if len(guesses) > times:
            return found
        return replace(found, T_map_cloud=found.T_map_cloud @ off, inlier_share=found.inlier_share * fits)

    monkeypatch.setattr(GaussianMap, "register", fooled)
    return guesses


@pytest.mark.parametrize("off", [Rotation.from_euler("y", 7, degrees=True), [0.25, 0.0, 0.0]])
@pytest.mark.parametrize("times", [1, 7])
def test_a_registration_that_jumps_is_tried_again_and_then_refused(
    scans: list[tuple[int, Scan, Scan | None]], monkeypatch: pytest.MonkeyPatch, off: Rotation | list[float], times: int
) -> None:
    refiner = Refiner(RefinementSettings(), (0.5, 60.0), transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL)
    T_off = transforms.make_transform(off) if isinstance(off, Rotation) else transforms.make_transform(None, off)
    found = []
    for number, (_, scan, companion) in enumerate(scans[:14]):
        if number == 12:
            guesses = jumping(monkeypatch, T_off, times)
        found.append(refiner.refine(scan, true_pose(scan.end_ns * 1e-9) @ T_BASE_HORIZONTAL, companion))
    assert [r.refused for r in found] == [False] * 12 + [times == 7, False]
    assert np.linalg.norm(guesses[0] - guesses[1]) > 0  # not from where it was fooled
    T_true = np.array([true_pose(r.stamp_ns * 1e-9) @ T_BASE_HORIZONTAL for r in found])
    T_found = np.array([r.T_odom_sensor for r in found])
    error = transforms.invert(transforms.invert(T_true[0]) @ T_true[12]) @ transforms.invert(T_found[0]) @ T_found[12]
    assert np.linalg.norm(error[:3, 3]) < 0.02
    assert np.degrees(Rotation.from_matrix(error[:3, :3]).magnitude()) < 0.5


@pytest.mark.parametrize(("times", "fits"), [(1, 0.9), (2, 0.5)])
def test_a_registration_that_less_fits_than_the_last_is_tried_again(
    scans: list[tuple[int, Scan, Scan | None]], monkeypatch: pytest.MonkeyPatch, times: int, fits: float
) -> None:
    """It is no jump: a degree and five centimetres are less than robots turn and drive."""
    refiner = Refiner(RefinementSettings(), (0.5, 60.0), transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL)
    T_off = transforms.make_transform(Rotation.from_euler("z", 1, degrees=True), [0.05, 0.0, 0.0])
    found = []
    for number, (_, scan, companion) in enumerate(scans[:13]):
        if number == 12:
            jumping(monkeypatch, T_off, times, fits)
        found.append(refiner.refine(scan, true_pose(scan.end_ns * 1e-9) @ T_BASE_HORIZONTAL, companion))
    T_true = np.array([true_pose(r.stamp_ns * 1e-9) @ T_BASE_HORIZONTAL for r in found])
    T_step = transforms.invert(found[11].T_odom_sensor) @ found[12].T_odom_sensor
    error = transforms.invert(transforms.invert(T_true[11]) @ T_true[12]) @ T_step
    assert np.linalg.norm(error[:3, 3]) < 0.01
    assert np.degrees(Rotation.from_matrix(error[:3, :3]).magnitude()) < 0.2


def flat(low: list[float], high: list[float], seed: int) -> FloatArray:
    """(n, 3) points with 1 cm of noise on an upright or level rectangle, 400 on a square metre."""
    low_m, high_m = np.array(low), np.array(high)
    generator = np.random.default_rng(seed)
    count = int(400 * np.prod((high_m - low_m)[high_m > low_m]))
    return generator.uniform(low_m, high_m, (count, 3)) + np.where(high_m > low_m, 0.0, generator.normal(0, 0.01, (count, 3)))


@pytest.mark.parametrize(("distance_m", "most_m"), [(RefinementSettings().distance_m, 0.01), (0.5, np.inf)])
def test_the_side_of_a_wall_that_comes_into_view_is_not_taken_for_its_other_side(distance_m: float, most_m: float) -> None:
    """Out of a room through a doorway: one wall of 16 cm, of which the map knows the room's side."""
    refiner = Refiner(RefinementSettings(distance_m=distance_m), (0.5, 60.0))
    room = [
        flat([-4, 0.02, 0], [4, 0.02, 2.6], 1), flat([-4, -5, 0], [-4, 0, 2.6], 2), flat([4, -5, 0], [4, 0, 2.6], 3),
        flat([-4, -5, 0], [4, 2, 0], 4), flat([-4, -5, 0], [4, -5, 2.6], 5),
    ]  # fmt: skip
    # From the doorway, some of the room is seen, and all of the corridor's wall.
    seen = [
        flat([-4, 0.18, 0], [4, 0.18, 2.6], 6), flat([-1.5, -5, 0], [1.5, -5, 2.6], 7), flat([-1.5, -5, 0], [1.5, 2, 0], 8),
        flat([-4, 0.18, 0], [4, 2, 0], 9), flat([-4, 2, 0], [4, 2, 2.6], 10),
    ]  # fmt: skip
    refiner._map.insert(GaussianCloud(np.concatenate(room)), np.eye(4))
    cloud = GaussianCloud(np.concatenate(seen))
    found = refiner._register(cloud, [np.eye(4)], [np.eye(4)], may_change(PERIOD_NS))
    assert not found.refused
    off_m = float(np.linalg.norm(found.T_odom_sensor[:3, 3]))
    assert off_m < most_m
    assert distance_m < 0.2 or off_m > 0.03  # what it is for


def test_a_registration_that_jumps_every_time_is_accepted_once_the_robot_can_have_gone_there(
    scans: list[tuple[int, Scan, Scan | None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses that went wrong must recover, and a robot that sets off must not be held where it was."""
    refiner = Refiner(RefinementSettings(), (0.5, 60.0), transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL)
    found = []
    for number, (_, scan, companion) in enumerate(scans[:18]):
        if number == 12:
            jumping(monkeypatch, transforms.make_transform(None, [0.4, 0.0, 0.0]), 1000)
        found.append(refiner.refine(scan, true_pose(scan.end_ns * 1e-9) @ T_BASE_HORIZONTAL, companion))
    refused = [r.refused for r in found if r is not None]
    assert refused[:13] == [False] * 12 + [True]
    assert not all(refused[13:16])


def test_a_refused_registration_raises_the_alarm(scans: list[tuple[int, Scan, Scan | None]]) -> None:
    (first,) = register_scans(scans[:1], OdometrySettings(), RefinementSettings())
    assert weakness(first) is None
    why = weakness(replace(first, refused=True))
    assert why is not None
    assert "refused" in why


def test_an_odometry_that_jitters_bends_no_sweep(scans: list[tuple[int, Scan, Scan | None]]) -> None:
    """Where few returns hold it, an odometry's pose errs anew with each scan; what it says of a sweep's motion is noise."""
    generator = np.random.default_rng(4)
    refiner = Refiner(RefinementSettings(), (0.5, 60.0), transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL)
    off = []
    for number, (_, scan, companion) in enumerate(scans):
        T_end = true_pose(scan.end_ns * 1e-9) @ T_BASE_HORIZONTAL
        if number:
            turn = Rotation.from_rotvec(generator.normal(0, np.radians(0.6), 3))
            T_end = T_end @ transforms.make_transform(turn, generator.normal(0, 0.03, 3))
        found = refiner.refine(scan, T_end, companion)
        off.append(transforms.invert(true_pose(found.stamp_ns * 1e-9) @ T_BASE_HORIZONTAL) @ found.T_odom_sensor)
    # From scan to scan, for what drifts is another matter.
    step = transforms.invert(np.array(off[:-1])) @ np.array(off[1:])
    step_m = np.linalg.norm(step[:, :3, 3], axis=1)
    step_deg = np.degrees(Rotation.from_matrix(step[:, :3, :3]).magnitude())
    assert np.sqrt(np.mean(step_m**2)) < 0.003
    assert np.sqrt(np.mean(step_deg**2)) < 0.1


@pytest.mark.parametrize("from_scan", [0, 20])
def test_an_odometry_that_is_wild_at_first_moves_no_first_pose(
    scans: list[tuple[int, Scan, Scan | None]], from_scan: int
) -> None:
    """At rest and when the recording begins in motion: nothing but the scans tells what the motion was."""
    generator = np.random.default_rng(6)
    refiner = Refiner(RefinementSettings(), (0.5, 60.0), transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL)
    T_found, T_true = [], []
    for _, scan, companion in scans[from_scan : from_scan + 10]:
        turn = Rotation.from_rotvec(generator.normal(0, np.radians(3.0), 3))
        T_end = true_pose(scan.end_ns * 1e-9) @ T_BASE_HORIZONTAL
        found = refiner.refine(scan, T_end @ transforms.make_transform(turn, generator.normal(0, 0.1, 3)), companion)
        assert not found.refused
        T_found.append(found.T_odom_sensor)
        T_true.append(true_pose(found.stamp_ns * 1e-9) @ T_BASE_HORIZONTAL)
    way = transforms.invert(np.array(T_found[:1])) @ np.array(T_found)
    off = transforms.invert(transforms.invert(np.array(T_true[:1])) @ np.array(T_true)) @ way
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.01
    assert np.degrees(Rotation.from_matrix(off[:, :3, :3]).magnitude()).max() < 0.5


def later(scan: Scan, by_ns: int) -> Scan:
    return replace(scan, start_ns=scan.start_ns + by_ns, stamp_ns=scan.stamp_ns + by_ns)


@pytest.mark.parametrize("first_alone", [True, False])
def test_a_pause_in_the_scans_carries_no_motion_on(
    scans: list[tuple[int, Scan, Scan | None]], first_alone: bool
) -> None:
    """The robot moved on, or stood, while nothing was recorded; the odometry knows."""
    refiner = Refiner(RefinementSettings(), (0.5, 60.0), transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL)
    before, after = ([0], range(30, 40)) if first_alone else (range(20), range(20, 30))
    pause_ns = 0 if first_alone else 12 * 10**9
    T_found, T_true = [], []
    for number, by_ns in [*((n, 0) for n in before), *((n, pause_ns) for n in after)]:
        _, scan, companion = scans[number]
        T_end = true_pose(scan.end_ns * 1e-9) @ T_BASE_HORIZONTAL
        beside = None if companion is None else later(companion, by_ns)
        found = refiner.refine(later(scan, by_ns), T_end, beside, after_gap=by_ns > 0 and len(T_found) == 20)
        assert found is not None
        assert not found.refused
        T_found.append(found.T_odom_sensor)
        T_true.append(true_pose((scan.start_ns + scan.end_ns) / 2 * 1e-9) @ T_BASE_HORIZONTAL)
    way = transforms.invert(np.array(T_found[:1])) @ np.array(T_found)
    off = transforms.invert(transforms.invert(np.array(T_true[:1])) @ np.array(T_true)) @ way
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.04
    assert np.degrees(Rotation.from_matrix(off[:, :3, :3]).magnitude()).max() < 1.0


def test_from_scan_to_scan_the_first_guess_is_where_the_motion_leads_however_wild_the_odometry(
    scans: list[tuple[int, Scan, Scan | None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What falls on the odometry's guess first may fit the map there, in a corridor whose walls are all alike."""
    refiner = Refiner(RefinementSettings(), (0.5, 60.0), transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL)
    found = []
    for number, (_, scan, companion) in enumerate(scans[:21]):
        T_end = true_pose(scan.end_ns * 1e-9) @ T_BASE_HORIZONTAL
        if number == 20:
            guesses = jumping(monkeypatch, np.eye(4), 0)
            T_end = T_end @ transforms.make_transform(None, [0.4, 0.0, 0.0])
        found.append(refiner.refine(scan, T_end, companion))
    off = transforms.invert(found[-1].T_odom_sensor) @ guesses[0]
    assert np.linalg.norm(off[:3, 3]) < 0.03
    assert len(guesses) == 1


def test_scans_that_hold_no_pose_are_left_out_and_the_others_registered() -> None:
    """KISS-ICP ends the whole program where returns determine no motion."""
    scans = [synthetic.scan(i, 360) for i in range(6)]
    few = replace(scans[2], points_sensor=scans[2].points_sensor[:1], ring=scans[2].ring[:1], time_ns=None)
    at_one_place = replace(scans[3], points_sensor=np.full_like(scans[3].points_sensor, 1.0))
    in_a_line = replace(scans[4], points_sensor=scans[4].points_sensor * np.array([1, 0, 0], np.float32))
    given = [scans[0], scans[1], few, at_one_place, in_a_line, scans[5]]
    found = list(
        register_scans(((i, scan, None) for i, scan in enumerate(given)), OdometrySettings(), RefinementSettings())
    )
    assert [registration.index for registration in found] == [0, 1, 5]
    assert np.isfinite(found[-1].T_odom_sensor).all()


def test_a_scan_whose_times_are_all_the_same_is_registered_as_one_without_times() -> None:
    """KISS-ICP divides by their span, and ends the whole program."""
    scans = [synthetic.scan(i, 360) for i in range(4)]
    scans[2] = replace(scans[2], time_ns=np.zeros(len(scans[2]), np.int64))
    found = list(
        register_scans(((i, scan, None) for i, scan in enumerate(scans)), OdometrySettings(), RefinementSettings())
    )
    assert [registration.index for registration in found] == [0, 1, 2, 3]
    assert np.isfinite(found[-1].T_odom_sensor).all()


def test_a_scan_whose_registration_fails_has_no_pose_and_spoils_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    scans = [(i, synthetic.scan(i, 360), None) for i in range(5)]
    usual, failed = Refiner.refine, []

    def refine(self: Refiner, scan: Scan, *more: Any, **options: Any) -> Refinement | None:
        if scan is scans[2][1]:
            raise ValueError("no surface")
        return usual(self, scan, *more, **options)

    monkeypatch.setattr(Refiner, "refine", refine)
    steps = OdometrySettings(), RefinementSettings()
    found = list(register_scans(scans, *steps, on_failure=lambda index, _, error: failed.append((index, str(error)))))
    assert [registration.index for registration in found] == [0, 1, 3, 4]
    assert failed == [(2, "no surface")]
    with pytest.raises(ValueError, match="no surface"):
        list(register_scans(scans, *steps))
