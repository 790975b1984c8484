"""Refined poses where registration or odometry errs, on a drive through a box with pillars."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.poses.gaussian_map import Aligned, GaussianCloud, GaussianMap
from ffmap.algorithms.poses.refinement import Refinement, RefinementSettings, Refiner
from tests.box_drive import PERIOD_NS, T_HORIZONTAL_VERTICAL, Given, errors, true_pose
from tests.synthetic import scan_of

Change = Callable[[int, FloatArray], FloatArray]


def refined(
    scans: Iterable[Given], odometry: Change = lambda _, T: T, refiner: Refiner | None = None
) -> list[Refinement]:
    """Refine scans from their true poses, as changed by an odometry."""
    refiner = refiner or Refiner(RefinementSettings(), (0.5, 60.0), T_HORIZONTAL_VERTICAL)
    found = []
    for number, (_, scan, companion) in enumerate(scans):
        T_odometry = odometry(number, true_pose(scan.reference_ns))
        refinement = refiner.refine(scan, T_odometry, companion)
        assert refinement is not None
        found.append(refinement)
    return found


def errors_of(found: list[Refinement], first: int = 0) -> tuple[FloatArray, FloatArray]:
    true = [true_pose(r.stamp_ns) for r in found]
    return errors([r.T_odom_sensor for r in found], true, first)


def misregister(
    monkeypatch: pytest.MonkeyPatch, T_off: FloatArray, times: int, fits: float = 1.0
) -> list[FloatArray]:
    """Let the next registrations find another pose with a share of the inliers.

    Returns the guesses of all registrations.
    """
    register, guesses = GaussianMap.register, []

    def fooled(
        self: GaussianMap, cloud: GaussianCloud, guess: FloatArray, *limits: float
    ) -> Aligned:
        guesses.append(guess)
        found = register(self, cloud, guess, *limits)  # type: ignore[arg-type]
        if len(guesses) > times:
            return found
        share = found.inlier_share * fits
        return replace(found, T_map_cloud=found.T_map_cloud @ T_off, inlier_share=share)

    monkeypatch.setattr(GaussianMap, "register", fooled)
    return guesses


def moved(degrees: float, axis: str, metres: list[float]) -> FloatArray:
    return transforms.make_transform(Rotation.from_euler(axis, degrees, degrees=True), metres)


TURN, SHIFT = moved(7, "y", [0.0, 0.0, 0.0]), moved(0, "y", [0.25, 0.0, 0.0])
SMALL = moved(1, "z", [0.05, 0.0, 0.0])


@pytest.mark.parametrize(
    ("T_off", "times", "fits", "refused"),
    [
        *((T, times, 1.0, times == 7) for T in (TURN, SHIFT) for times in (1, 7)),
        # No jump: robots turn and drive as much.
        (SMALL, 1, 0.9, False),
        (SMALL, 2, 0.5, False),
    ],
)
def test_a_registration_that_jumps_or_fits_worse_is_repeated_and_else_refused(
    scans: list[Given],
    monkeypatch: pytest.MonkeyPatch,
    T_off: FloatArray,
    times: int,
    fits: float,
    refused: bool,
) -> None:
    def odometry(number: int, T: FloatArray) -> FloatArray:
        if number == 12:
            misregister(monkeypatch, T_off, times, fits)
        return T

    found = refined(scans[:14], odometry)
    assert [r.refused for r in found] == [False] * 12 + [refused, False]
    off_m, off_deg = errors_of(found, first=11)
    assert off_m[12] < 0.02
    assert off_deg[12] < 0.5


def test_a_jump_is_accepted_once_the_robot_can_have_moved_as_far(
    scans: list[Given], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wrong poses must recover."""

    def odometry(number: int, T: FloatArray) -> FloatArray:
        if number == 12:
            misregister(monkeypatch, moved(0, "z", [0.4, 0.0, 0.0]), 1000)
        return T

    refused = [r.refused for r in refined(scans[:18], odometry)]
    assert refused[:13] == [False] * 12 + [True]
    assert not all(refused[13:16])


def test_the_first_guess_is_by_the_motion_of_the_refined_poses(
    scans: list[Given], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a corridor whose walls are all alike, the scan may also fit at the odometry's pose."""
    guesses: list[list[FloatArray]] = []

    def odometry(number: int, T: FloatArray) -> FloatArray:
        if number < 20:
            return T
        guesses.append(misregister(monkeypatch, np.eye(4), 0))
        return T @ moved(0, "z", [0.4, 0.0, 0.0])

    found = refined(scans[:21], odometry)
    (own,) = guesses
    assert len(own) == 1
    way = transforms.invert(found[-1].T_odom_sensor) @ own[0]
    assert np.linalg.norm(way[:3, 3]) < 0.03


@pytest.mark.parametrize("from_scan", [0, 20])
def test_a_wild_odometry_does_not_affect_the_first_poses(
    scans: list[Given], from_scan: int
) -> None:
    """At rest, and where the recording begins in motion."""
    generator = np.random.default_rng(6)

    def odometry(_: int, T: FloatArray) -> FloatArray:
        turn = Rotation.from_rotvec(generator.normal(0, np.radians(3.0), 3))
        return T @ transforms.make_transform(turn, generator.normal(0, 0.1, 3))

    found = refined(scans[from_scan : from_scan + 10], odometry)
    assert not any(r.refused for r in found)
    off_m, off_deg = errors_of(found)
    assert off_m.max() < 0.01
    assert off_deg.max() < 0.5


def test_a_pause_after_the_first_scan_is_bridged_by_the_odometry(scans: list[Given]) -> None:
    found = refined([scans[0], *scans[30:]])
    assert not any(r.refused for r in found)
    off_m, off_deg = errors_of(found)
    assert off_m.max() < 0.04
    assert off_deg.max() < 1.0


def rectangles(seed: int, corners: list[list[list[float]]]) -> Scan:
    """400 returns on a square metre of rectangles, with 1 cm of noise across them."""
    generator = np.random.default_rng(seed)
    parts = []
    for low_m, high_m in np.array(corners):
        extent_m = high_m - low_m
        count = int(400 * np.prod(extent_m[extent_m > 0]))
        noise_m = np.where(extent_m > 0, 0.0, generator.normal(0, 0.01, (count, 3)))
        parts.append(low_m + extent_m * generator.uniform(size=(count, 3)) + noise_m)
    points = np.concatenate(parts)
    return replace(scan_of(points, np.zeros(len(points)), 1), start_ns=seed * PERIOD_NS)


BESIDE = [[[-4, -5, 0], [-4, 0, 2.6]], [[4, -5, 0], [4, 0, 2.6]], [[-4, -5, 0], [4, -5, 2.6]]]
ROOM = [[[-4, 0.02, 0], [4, 0.02, 2.6]], [[-4, -5, 0], [4, 2, 0]], *BESIDE]
CORRIDOR = [[[-4, 0.18, 0], [4, 0.18, 2.6]], [[-4, 0.18, 0], [4, 2, 0]], [[-4, 2, 0], [4, 2, 2.6]]]
SEEN_OF_ROOM = [[[-1.5, -5, 0], [1.5, -5, 2.6]], [[-1.5, -5, 0], [1.5, 2, 0]]]


@pytest.mark.parametrize("distance_m", [RefinementSettings().distance_m, 0.5])
def test_the_other_side_of_a_wall_is_not_taken_for_the_known_side(distance_m: float) -> None:
    """Out of a room through a doorway: the map knows the room's side of a wall of 16 cm."""
    settings = RefinementSettings(distance_m=distance_m, points_max=1_000_000)
    refiner = Refiner(settings, (0.0, 60.0))
    refiner.refine(rectangles(1, ROOM), np.eye(4))
    found = refiner.refine(rectangles(2, [*CORRIDOR, *SEEN_OF_ROOM]), np.eye(4))
    assert found is not None
    assert not found.refused
    off_m = float(np.linalg.norm(found.T_odom_sensor[:3, 3]))
    # Within half a metre, the sides are merged.
    assert off_m < 0.01 if distance_m < 0.2 else off_m > 0.03
