"""Poses refined by generalised ICP: each scan, and the other lidar's beside it, registered to a map of Gaussians."""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.poses.gaussian_map import Aligned, GaussianCloud, GaussianMap
from ffmap.algorithms.poses.places import Seen

_CHANGE_DEG, _CHANGE_M = 6.0, 0.15
"""By how much a motion over a tenth of a second may differ from the one before. A robot that brakes from a quick turn changes it
by 3 degrees, a lidar in the hand by up to 6; the rest is noise."""
_CHANGE_DEG_S, _CHANGE_M_S = 90.0, 2.0
"""What a robot, or who carries a lidar, can turn and go otherwise than expected in each further second."""
_STEP_NS = 100_000_000  # the tenth of a second; a motion is carried on in such steps, along its arc
_BLIND_NS = 2_000_000_000  # for so long a motion is carried on where nothing fits: robots change theirs within a second or two
_RECALLED_MAX = 100  # scans that a place is looked for in
_SEEN_M = 5.0  # how much farther off than a place the sensor may have been when it saw what is seen from there
_PLACES_MAX, _PUT_TOGETHER_MAX = 8, 3  # places that are registered to, and of these the ones with other motions
_SAME_DEG, _SAME_M = 10.0, 0.5  # registrations that differ by less are of one place
_AGREEMENT_MIN = 0.3
"""Of 70 scans, the best place in another building's map has at most 0.12, the right place in their own at least 0.49."""
_RIVAL = 0.05  # a place at the end of what is within reach must agree by so much more than the expected one
LOST_DISTANCE_M = 0.5
"""Maximum distance (m) of a point from its Gaussian where a registration within `distance_m` jumps,
or hardly anything fits (`WEAK_INLIER_SHARE`): its guess was off. What this finds is registered
again within `distance_m`."""
_FIT_DROP_MAX = 0.03
"""Where the share of a scan that fits the map is smaller by more than this than that of the last
scan, it is registered from the other guesses too, and from all with two thirds of the distance;
what fits best counts."""
_ITERATIONS_MAX = 20
"""Maximum number of iterations of a registration."""
_MEMORY_SCANS = 50
"""Number of scans after which a voxel without points is forgotten; the pose graph joins places seen
again."""
WEAK_SHARE = 0.012
"""Minimum information in a scan's weakest direction, as a share of that in its strongest; less, as
along a bare corridor, and the registration is called weak."""
WEAK_INLIER_SHARE = 0.4
"""Minimum share of a scan that fits the map; with less, the registration is called weak."""
_PASSES_MAX = 3
"""Maximum number of times that a sweep is put together and registered, each time by the motion that
the last one found."""
_BEND_DEG = 0.25
"""A sweep is put together again where the motion that was found differs by more than this (degrees)
over half a sweep from the one by which it was put together."""
_BEND_M = 0.01
"""The same in metres as `_BEND_DEG`."""


class RefinementSettings(StepSettings):
    """Registering each scan again, to a map of Gaussians (the paper's poses are BLAM's, IV.A)."""

    enabled: bool = Field(True, description="Whether poses are refined; if not, they are KISS-ICP's own.")
    voxel_m: float = Field(
        0.2,
        ge=0.01,
        le=5,
        description="Edge (m) of the voxels of one Gaussian each: larger ones would blend the two sides of a wall.",
    )
    points_max: int = Field(
        6_000, ge=100, description="Maximum number of returns of a scan; denser clouds are thinned evenly."
    )
    companion_points_max: int = Field(
        5_000,
        ge=0,
        description="Maximum number of returns of the other lidar, which sees floor and ceiling; they are registered together.",
    )
    distance_m: float = Field(
        0.12,
        gt=0,
        description="Maximum distance (m) of a point from its Gaussian: less than walls are thick, or the side of a wall that "
        "comes into view in a doorway is registered to its other side.",
    )


@dataclass(frozen=True)
class Refinement:
    """One scan registered again.

    stamp_ns: the middle of the sweep. T_odom_sensor: (4, 4) at that time.
    T_odom_sensor_end: (4, 4) at the end of the sweep, by the motion since the last scan.
    inlier_share: share of the thinned scan's points that have a Gaussian; 1 for the first scan.
    weakest_share: how well the scan holds its place in the direction in which it holds it least, as a share of how well
        it does in the best one; near 0 in a corridor without a feature. 1 for the first scan.
    refused: whether the registration was: it jumped. The pose is then where the odometry's motion leads.
    agreement: after a gap, of the scan with what was seen before (see `Seen`); rival: the same at the best other place, 0 where
        none had to be looked for. NaN elsewhere.
    cloud_sensor: (k, 3) float32, both lidars' returns that were registered, as they are seen at `stamp_ns`.
    """

    stamp_ns: int
    T_odom_sensor: FloatArray
    T_odom_sensor_end: FloatArray
    inlier_share: float
    weakest_share: float
    refused: bool
    agreement: float
    rival: float
    cloud_sensor: FloatArray


@dataclass(frozen=True)
class _Registered:
    """What is kept of a scan for the next one: its pose by KISS-ICP, at the sweep's end, and its refined one, at its middle."""

    stamp_ns: int
    T_kiss_end: FloatArray
    T_refined: FloatArray
    motion_per_ns: FloatArray


@dataclass(frozen=True)
class _Fit:
    """A registration, and whether it jumped."""

    aligned: Aligned
    jumped: bool

    @property
    def rank(self) -> tuple[bool, float]:
        """The least is the best."""
        return self.jumped, -self.aligned.inlier_share


class _Found(NamedTuple):
    """What a scan's registration came to; see `Refinement`."""

    T_odom_sensor: FloatArray
    inlier_share: float
    weakest_share: float
    refused: bool
    agreement: float = float("nan")
    rival: float = float("nan")


class _Place(NamedTuple):
    """A scan after a gap, registered at one place: by which motion it was put together, and how far off the place is."""

    aligned: Aligned
    number: int
    off: float
    agreement: float


class Change(NamedTuple):
    """By how much a pose may differ from another one."""

    degrees: float
    metres: float

    def share_of(self, T_expected: FloatArray, T_found: FloatArray) -> float:
        """How far a pose is off, 1 being as far as it may be."""
        off = transforms.to_twist(transforms.invert(T_expected) @ T_found)
        turn_deg, way_m = np.degrees(np.linalg.norm(off[:3])), np.linalg.norm(off[3:])
        return float(max(turn_deg / self.degrees, way_m / self.metres))


def may_change(elapsed_ns: int) -> Change:
    """By how much the pose of a scan may differ from where the motion until so long ago leads."""
    further_s = max(elapsed_ns - _STEP_NS, 0) * 1e-9
    return Change(_CHANGE_DEG + _CHANGE_DEG_S * further_s, _CHANGE_M + _CHANGE_M_S * further_s)


def is_clear(agreement: float, rival: float) -> bool:
    """Whether a scan agrees so well at its place, and so much less at the next best one, that it was taken there."""
    return agreement >= _AGREEMENT_MIN and agreement - rival >= _RIVAL


def carried_on(T: FloatArray, motion_per_ns: FloatArray, elapsed_ns: int) -> FloatArray:
    """The pose (4, 4) that a motion leads to from another one, along its arc."""
    steps = max(round(elapsed_ns / _STEP_NS), 1)
    way = np.linalg.matrix_power(transforms.from_twist(motion_per_ns * elapsed_ns / steps), steps)
    return transforms.orthonormal(T @ way) if steps > 1 else np.asarray(T @ way)


def middle_ns(scan: Scan) -> int:
    """The middle of a sweep: the time of its refined pose."""
    return (scan.start_ns + scan.end_ns) // 2


class Refiner:
    """Registers scan after scan to the map that the earlier ones made.

    A sweep is put together as seen from its middle, by the motion that the refined poses had: an error of this motion then
    bends both halves of a sweep the opposite way and leaves the pose as it is. (The odometry's own motion is noisy where
    few returns hold it.) The first motion is found with the second scan, from rest on, and the first scan put together
    again by it.

    settings: of the refinement. range_m: returns nearer or farther than these are left out.
    T_sensor_companion: (4, 4) where the other lidar sits, if there is one. T_base_sensor: (4, 4) where
        this one sits on a base that stands level at the start; None where its own z points up.
    """

    def __init__(
        self,
        settings: RefinementSettings,
        range_m: tuple[float, float],
        T_sensor_companion: FloatArray | None = None,
        T_base_sensor: FloatArray | None = None,
    ) -> None:
        self._settings = settings
        self._range_m = range_m
        self._T_sensor_companion = T_sensor_companion
        self._T_level_odom = np.eye(4) if T_base_sensor is None else T_base_sensor
        self._map = GaussianMap(settings.voxel_m, _MEMORY_SCANS)
        self._last: _Registered | None = None
        self._first: tuple[Scan, Scan | None] | None = None
        self._trusted_ns = 0
        self._inlier_share = 1.0
        self._seen: list[tuple[FloatArray, FloatArray]] = []

    def refine(
        self, scan: Scan, T_odom_sensor_end: FloatArray, companion: Scan | None = None, after_gap: bool = False
    ) -> Refinement | None:
        """Register one scan, later than the last one, and beside it the last one of the other lidar that ended before it.

        None, as if there had been no such scan, where it is found nowhere after a gap too long to carry the motion on.

        T_odom_sensor_end: the odometry's pose at the scan's end. Where the motion so far leads is the first guess, and where the
            odometry's motion since the last scan does, the second.
        after_gap: whether so much time has passed that the scan may be anywhere within reach.
        """
        stamp_ns = middle_ns(scan)
        last = self._last
        motion_per_ns: FloatArray = np.zeros(6)
        if last is None:
            registered = self._put_together(scan, companion, stamp_ns, motion_per_ns)
            found = _Found(T_odom_sensor_end, 1.0, 1.0, False)
            self._first = scan, companion
        elif after_gap:
            found, registered, motion_per_ns = self._find_again(scan, companion, last)
            if found.refused:
                if stamp_ns - last.stamp_ns > _BLIND_NS:
                    return None
                # What is seen from a place that is guessed must not be taken for what was seen before.
                self._map = GaussianMap(self._settings.voxel_m, _MEMORY_SCANS)
            self._first = None
        else:
            elapsed_ns = stamp_ns - last.stamp_ns
            T_predicted_by_odometry = last.T_refined @ transforms.invert(last.T_kiss_end) @ T_odom_sensor_end
            motion_per_ns = last.motion_per_ns
            expected = [carried_on(last.T_refined, motion_per_ns, elapsed_ns), T_predicted_by_odometry]
            guesses = list(expected)
            change = may_change(stamp_ns - self._trusted_ns)
            # The second scan is registered from rest on, then with the motion that was found.
            for number in range(_PASSES_MAX):
                if self._first is not None:
                    self._start_again(*self._first, last, motion_per_ns)
                source = self._put_together(scan, companion, stamp_ns, motion_per_ns)
                again = self._register(source, guesses, expected, change)
                if number and again.refused:
                    break
                found, registered, assumed_per_ns = again, source, motion_per_ns
                motion_per_ns = transforms.to_twist(transforms.invert(last.T_refined) @ found.T_odom_sensor) / elapsed_ns
                # What was refused says nothing of how the sensor moved within the sweep.
                bend = (motion_per_ns - assumed_per_ns) * (scan.end_ns - stamp_ns)
                if self._first is None and (found.refused or not self._bends(bend)):
                    break
                guesses = [found.T_odom_sensor, *expected]
            self._first = None
        if not found.refused:
            self._trusted_ns = stamp_ns
        self._inlier_share = found.inlier_share
        self._map.insert(registered, found.T_odom_sensor)
        self._last = _Registered(stamp_ns, T_odom_sensor_end, found.T_odom_sensor, motion_per_ns)
        T_middle_end = transforms.from_twist(motion_per_ns * (scan.end_ns - stamp_ns))
        cloud_sensor = registered.points
        self._seen.append((found.T_odom_sensor, cloud_sensor))
        return Refinement(
            stamp_ns=stamp_ns,
            T_odom_sensor=found.T_odom_sensor,
            T_odom_sensor_end=found.T_odom_sensor @ T_middle_end,
            inlier_share=found.inlier_share,
            weakest_share=found.weakest_share,
            refused=found.refused,
            agreement=found.agreement,
            rival=found.rival,
            cloud_sensor=cloud_sensor,
        )

    def _find_again(
        self, scan: Scan, companion: Scan | None, last: _Registered
    ) -> tuple[_Found, GaussianCloud, FloatArray]:
        """The scan after a gap registered from wherever it may be to all that was seen: what it found, the cloud, the motion.

        The sensor may have moved on as it did, or stand, or be at one of the likeliest places within reach. Where it agrees
        best counts; the farther from where the motion so far, or none, leads, the better it has to agree.
        """
        stamp_ns = middle_ns(scan)
        elapsed_ns = stamp_ns - last.stamp_ns
        change = may_change(elapsed_ns)
        motions = [last.motion_per_ns, np.zeros(6)]
        sources = [self._put_together(scan, companion, stamp_ns, motion) for motion in motions]
        expected = [carried_on(last.T_refined, motion, elapsed_ns) for motion in motions]

        seen = self._recall(last.T_refined, change.metres + _SEEN_M)
        fits: list[_Place] = []

        def try_from(number: int, guess: FloatArray) -> None:
            aligned = self._settled(sources[number], guess)
            off = min(change.share_of(T, aligned.T_map_cloud) for T in expected)
            if off <= 1.0:
                fits.append(_Place(aligned, number, off, seen.agreement(sources[number], aligned.T_map_cloud)))

        for number, guess in enumerate(expected):
            try_from(number, guess)
        if max((fit.agreement for fit in fits), default=0.0) < 1.0 - _RIVAL:
            places: list[FloatArray] = []
            for T in seen.likely_places(sources[0].points, last.T_refined):
                within_reach = min(change.share_of(T_expected, T) for T_expected in expected) <= 1.0
                if within_reach and len(places) < _PLACES_MAX and not any(_is_same(T, other) for other in places):
                    places.append(T)
            for T in places:
                try_from(0, T)
        # How the sensor moved within this sweep, as before, not at all or as in the gap, only a fit shows.
        for fit in sorted(fits, key=lambda fit: -fit.agreement)[:_PUT_TOGETHER_MAX]:
            way = transforms.to_twist(transforms.invert(last.T_refined) @ fit.aligned.T_map_cloud)
            for motion_per_ns in (motions[1 - fit.number], way / elapsed_ns):
                motions.append(motion_per_ns)
                sources.append(self._put_together(scan, companion, stamp_ns, motion_per_ns))
                try_from(len(sources) - 1, fit.aligned.T_map_cloud)
        nowhere = _Place(Aligned(expected[0], 0.0, np.zeros((6, 6))), 0, 0.0, 0.0)
        best = max(fits, key=lambda fit: fit.agreement - _RIVAL * fit.off, default=nowhere)
        rivals = (fit.agreement for fit in fits if not _is_same(best.aligned.T_map_cloud, fit.aligned.T_map_cloud))
        refused = best.agreement < _AGREEMENT_MIN
        T_found = expected[0] if refused else best.aligned.T_map_cloud
        share, weakest = best.aligned.inlier_share, _weakest_share(best.aligned)
        found = _Found(T_found, share, weakest, refused, best.agreement, max(rivals, default=0.0))
        return found, sources[best.number], motions[best.number]

    def _recall(self, T_odom_last: FloatArray, reach_m: float) -> Seen:
        """What was seen from within reach, which is put into the map again."""
        seen = [pair for pair in self._seen if np.linalg.norm(pair[0][:3, 3] - T_odom_last[:3, 3]) < reach_m]
        seen = seen[:: -(-len(seen) // _RECALLED_MAX)]
        points_odom = np.concatenate([transforms.apply(T, points) for T, points in seen])
        cloud_odom = GaussianCloud(points_odom)
        self._map.insert(cloud_odom, np.eye(4))
        return Seen(cloud_odom, self._T_level_odom)

    def _settled(self, source: GaussianCloud, guess: FloatArray) -> Aligned:
        """A registration from afar, then within the usual distance."""
        lost = self._map.register(source, guess, LOST_DISTANCE_M, _ITERATIONS_MAX)
        return self._map.register(
            source, lost.T_map_cloud, self._settings.distance_m, _ITERATIONS_MAX
        )

    def _start_again(self, scan: Scan, companion: Scan | None, first: _Registered, motion_per_ns: FloatArray) -> None:
        """The map of the first scan alone, put together by a motion that was not known when it came."""
        self._map = GaussianMap(self._settings.voxel_m, _MEMORY_SCANS)
        self._map.insert(self._put_together(scan, companion, first.stamp_ns, motion_per_ns), first.T_refined)

    def _put_together(
        self, scan: Scan, companion: Scan | None, stamp_ns: int, motion_per_ns: FloatArray
    ) -> GaussianCloud:
        """Both lidars' returns, thinned, as they are seen at a time, with their covariances."""
        points = [self._moved(scan, self._settings.points_max, np.eye(4), stamp_ns, motion_per_ns)]
        if companion is not None and self._T_sensor_companion is not None and self._settings.companion_points_max:
            most = self._settings.companion_points_max
            points.append(self._moved(companion, most, self._T_sensor_companion, stamp_ns, motion_per_ns))
        return GaussianCloud(np.concatenate(points))

    def _register(
        self, source: GaussianCloud, guesses: list[FloatArray], expected: list[FloatArray], change: "Change"
    ) -> _Found:
        """The pose that a registration finds, or the odometry's where it was refused.

        guesses: from these one after another, until as much of the scan fits as of the last one; least squares over what fits
            may lead to where less does, so if none does, what fits best counts.
        expected: where the motion so far leads, and last where the odometry's does, which holds if no registration does.
        change: by how much a registration may differ from both; what differs more is refused: it matched another place that
            looks like this one.
        """
        near_m = self._settings.distance_m
        usual = max(WEAK_INLIER_SHARE, self._inlier_share - _FIT_DROP_MAX)
        fit = self._best_fit(source, guesses, expected, change, (near_m, 2 / 3 * near_m), usual)
        if fit.jumped or fit.aligned.inlier_share < WEAK_INLIER_SHARE:
            lost = self._best_fit(
                source, guesses, expected, change, (LOST_DISTANCE_M,), WEAK_INLIER_SHARE
            )
            # More of a scan lies within more: shares are compared at one distance.
            near = self._best_fit(source, [lost.aligned.T_map_cloud], expected, change, (near_m,), usual)
            fit = min(fit, near, key=lambda own: own.rank)
        found = fit.aligned
        T_found = expected[-1] if fit.jumped or not found.inlier_share else found.T_map_cloud
        return _Found(T_found, found.inlier_share, _weakest_share(found), fit.jumped)

    def _best_fit(
        self,
        source: GaussianCloud,
        guesses: list[FloatArray],
        expected: list[FloatArray],
        change: "Change",
        distances_m: tuple[float, ...],
        share_min: float,
    ) -> _Fit:
        """The first registration that fits at least this share of a scan and is no jump; where none does, the best."""
        fits: list[_Fit] = []
        for distance_m, guess in product(distances_m, guesses):
            found = self._map.register(source, guess, distance_m, _ITERATIONS_MAX)
            jumped = all(change.share_of(T, found.T_map_cloud) > 1.0 for T in expected)
            fits.append(_Fit(found, found.inlier_share > 0 and jumped))
            if not fits[-1].jumped and found.inlier_share >= share_min:
                return fits[-1]
        return min(fits, key=lambda own: own.rank)

    def _bends(self, change: FloatArray) -> bool:
        """Whether a sweep that was put together by a motion that is off by so much, a twist within its half, is bent."""
        return _is_more_than(change, _BEND_DEG, _BEND_M)

    def _moved(
        self, scan: Scan, most: int, T_sensor_own: FloatArray, at_ns: int, motion_per_ns: FloatArray
    ) -> FloatArray:
        """At most `most` returns (n, 3) of a lidar, as seen at a time from the sensor that is registered."""
        stride = -(-len(scan) // most) or 1
        points: FloatArray = scan.points_sensor[::stride].astype(np.float64)
        range_m = np.linalg.norm(points, axis=1)
        kept = (range_m > self._range_m[0]) & (range_m < self._range_m[1])
        points = transforms.apply(T_sensor_own, points[kept])
        if scan.time_ns is None:
            return points
        return _at_one_time(points, scan.start_ns + scan.time_ns[::stride][kept] - at_ns, motion_per_ns)


def _weakest_share(found: Aligned) -> float:
    hold = np.linalg.eigvalsh(found.information[3:, 3:])
    return float(max(hold[0], 0.0) / max(hold[2], 1e-9))


def _is_same(T: FloatArray, T_other: FloatArray) -> bool:
    return Change(_SAME_DEG, _SAME_M).share_of(T, T_other) <= 1.0


def _is_more_than(twist: FloatArray, most_deg: float, most_m: float) -> bool:
    """Whether a twist turns, or moves, by more."""
    return bool(np.degrees(np.linalg.norm(twist[:3])) > most_deg or np.linalg.norm(twist[3:]) > most_m)


@numba.njit(cache=True, nogil=True)
def _at_one_time(points: FloatArray, before_ns: IntArray, motion_per_ns: FloatArray) -> FloatArray:  # pragma: no cover
    """Points (n, 3), each seen from where the sensor was so long after a common time (n,), as seen from where it was at that."""
    seen = np.empty_like(points)
    for i in range(len(points)):
        a, b, c = motion_per_ns[0] * before_ns[i], motion_per_ns[1] * before_ns[i], motion_per_ns[2] * before_ns[i]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        # A turn within a sweep is small: two terms of its series leave less than a millimetre.
        dx, dy, dz = b * z - c * y, c * x - a * z, a * y - b * x
        seen[i, 0] = x + dx + 0.5 * (b * dz - c * dy) + motion_per_ns[3] * before_ns[i]
        seen[i, 1] = y + dy + 0.5 * (c * dx - a * dz) + motion_per_ns[4] * before_ns[i]
        seen[i, 2] = z + dz + 0.5 * (a * dy - b * dx) + motion_per_ns[5] * before_ns[i]
    return seen
