"""Check the extrinsics of vertical lidars by the surfaces that the horizontal lidar sees too."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, Scan, within_range
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.poses.extrinsics import RefinedExtrinsics, refine_extrinsics, surfaces_agreement
from ffmap.algorithms.poses.patches import Patches
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.rig import MountCorrection
from ffmap.loaders.scans import read_scans

_OFF_DEG, _OFF_M, _OFF_S = 0.3, 0.02, 0.005
"""What a mount may be off by, and a clock, before it is mended."""
_SIGMAS = 3.0
"""Standard deviations beyond which an offset is one of the mount, and not of the estimate."""
_BETTER = 1.15
"""How much worse the clouds agree as given than as refined, at least, where the mount is off."""
_MAPPED, _LAID, _RETURNS = 16, 20, 10_000
"""Number of scans of the horizontal lidar that make the patches, of the vertical one that are laid on them, and of its returns."""
_MAP_POINTS = 12_000
"""Maximum number of returns of one scan in the map."""
_REFINED_DEG, _REFINED_M = 5.0, 0.1
"""Maximum change by a refinement: extrinsics that are farther off may settle on the next wall. The
clock may be off by any time."""
_NOISE_MAX = 1.5
"""Maximum distance between both lidars' surfaces after a refinement, as a multiple of the distance
between the horizontal lidar's own. Right extrinsics have 1.05 to 1.15, those of other walls 2 to 4."""


@dataclass(frozen=True)
class CheckedMount:
    """What a drive shows of a vertical lidar's mount, and what it is off by where that is certain.

    topic: the lidar's. alone: whether it is the only one whose mount matters. change: (7,) what was found less what was given, as
    of `RefinedExtrinsics.change`. clock_given_ns: what was added to its times already. own_rms_m: RMS distance (m) of
    the horizontal lidar's returns from the surfaces of its other scans.
    """

    topic: str
    alone: bool
    found: RefinedExtrinsics
    change: FloatArray
    clock_given_ns: int
    is_off: bool
    own_rms_m: float

    @property
    def agrees(self) -> bool:
        """Whether the surfaces of both lidars agree to the noise at the mount that was found."""
        return not self.found.rms_after_m > _NOISE_MAX * self.own_rms_m

    @property
    def is_refined(self) -> bool:
        """Whether the mount that was found is near enough to the given one to be used."""
        return self.agrees and self.off_deg <= _REFINED_DEG and self.off_m <= _REFINED_M

    @property
    def off_deg(self) -> float:
        """Angle between how the lidar was said to be turned and how it was found."""
        return float(np.degrees(np.linalg.norm(self.change[:3])))

    @property
    def off_m(self) -> float:
        """Distance between where the lidar was said to sit and where it was found."""
        return float(np.linalg.norm(self.change[3:6]))

    @property
    def correction(self) -> MountCorrection:
        return MountCorrection(
            self.topic,
            tuple(map(tuple, self.found.T_base_sensor.tolist())),
            self.clock_given_ns + round(1e9 * self.found.clock_s),
        )

    @property
    def record(self) -> dict[str, Any]:
        """As it stands in run.json."""
        found, used = self.found, "refined" if self.is_off else "as given"
        told = {"rms_as_given_m": found.rms_before_m, "rms_horizontal_m": self.own_rms_m}
        if refined := bool(np.isfinite(found.sigma).all()):
            told |= {"rms_refined_m": found.rms_after_m, "clock_s": found.clock_s}
            told |= {"off_deg": self.off_deg, "off_m": self.off_m}
        record: dict[str, Any] = {"used": used} | {name: round(v, 6) for name, v in told.items()}
        if refined:
            angles, shifts, clock = np.degrees(found.sigma[:3]), found.sigma[3:6], found.sigma[6:]
            sigma = {"rotation_deg": angles, "shift_m": shifts, "clock_s": clock}
            record["sigma"] = {name: v.round(6).tolist() for name, v in sigma.items()}
        if self.is_off:
            record |= {"T_base_sensor": found.T_base_sensor.tolist(), "clock_ns": self.correction.clock_ns}
        return record

    def late_warning(self, bag: str) -> str:
        """What a user can do where only the whole drive shows the extrinsics to be off. bag: as it is typed."""
        found = self.found
        return (
            f"{self.topic} sits {self.off_deg:.1f} deg and {100 * self.off_m:.1f} cm from where the bag or the rig file "
            f"says, or its clock is {1e3 * found.clock_s:+.0f} ms off, as the whole drive shows: surfaces that both lidars "
            f"see are {100 * found.rms_before_m:.1f} cm apart, and {100 * found.rms_after_m:.1f} cm by extrinsics that fit; "
            f"run 'ffmap calibrate {bag} --out rig.toml', then 'ffmap run {bag} --rig rig.toml'"
        )

    @property
    def warning(self) -> str:
        found, which = self.found, "" if self.alone else f"{self.topic} "
        return (
            f"the vertical lidar {which}sits {self.off_deg:.1f} deg and {100 * self.off_m:.1f} cm from where the bag or the rig "
            f"file says, and its clock is {1e3 * found.clock_s:+.0f} ms off (known to {1e3 * found.sigma[6]:.0f}): surfaces that "
            f"both lidars see were {100 * found.rms_before_m:.1f} cm apart, and are {100 * found.rms_after_m:.1f} cm with the "
            "mount that was found and is used; --mount as-given keeps the bag's"
        )


def check_mounts(
    inputs: Inputs,
    odometry: Trajectory,
    settings: Settings,
    mapped: int = _MAPPED,
    laid: int = _LAID,
    returns: int = _RETURNS,
    keep_agreeing: bool = False,
) -> list[CheckedMount]:
    """The mounts by the scans that were registered, of each vertical lidar that has enough in sight that the horizontal one sees
    too; none where there is but one lidar.

    odometry: T_odom_base.
    mapped, laid: number of the horizontal lidar's scans that make the patches, and of a vertical one's that are laid on them;
    returns: of those, at most. keep_agreeing: whether a mount is not refined at which surfaces agree.
    """
    if inputs.horizontal is None or not inputs.others:
        return []
    patches = Patches.of(map_of(inputs, odometry, settings, mapped), voxel_m=0.1, neighbours=16)
    # Those between the scans that made the patches.
    own = scans_of(inputs, inputs.horizontal, odometry, settings, 2 * mapped - 1)[1::2]
    T_base_own = inputs.horizontal.lidar.T_base_sensor
    own_rms_m, _ = surfaces_agreement(patches, odometry, own, T_base_own, returns)
    checked = []
    for sensor in inputs.others:
        scans = scans_of(inputs, sensor, odometry, settings, laid)
        topic, T_given = sensor.lidar.topic, sensor.lidar.T_base_sensor
        agree_m = _BETTER * own_rms_m if keep_agreeing else 0.0
        if found := refine_extrinsics(patches, odometry, scans, T_given, returns, agree_m):
            alone, clock_ns = len(inputs.others) == 1, sensor.lidar.decoding.clock_ns
            change = found.change(T_given)
            off = _is_off(found, change)
            checked.append(CheckedMount(topic, alone, found, change, clock_ns, off, own_rms_m))
    return checked


def _is_off(found: RefinedExtrinsics, change: FloatArray) -> bool:
    least = np.array([np.radians(_OFF_DEG)] * 3 + [_OFF_M] * 3 + [_OFF_S])
    off = np.abs(change) > np.maximum(least, _SIGMAS * found.sigma)
    return bool(off.any()) and found.rms_before_m > _BETTER * found.rms_after_m


def map_of(inputs: Inputs, odometry: Trajectory, settings: Settings, count: int) -> FloatArray:
    """(n, 3) some returns of some of the horizontal lidar's scans, where they lie."""
    assert inputs.horizontal is not None
    scans = scans_of(inputs, inputs.horizontal, odometry, settings, count)
    return laid_out(scans, odometry, inputs.horizontal.lidar.T_base_sensor)


def laid_out(scans: Sequence[Scan], odometry: Trajectory, T_base_sensor: FloatArray) -> FloatArray:
    """(n, 3) some returns of scans, where they lie."""
    points: list[FloatArray] = [np.zeros((0, 3))]
    for scan in scans:
        placed = place_scan(scan, odometry, T_base_sensor)
        points.append(placed.to_map(placed.points_level[:: max(1, len(scan) // _MAP_POINTS)]))
    return np.concatenate(points).astype(np.float64)


def scans_of(inputs: Inputs, sensor: Sensor, odometry: Trajectory, settings: Settings, count: int) -> list[Scan]:
    """Some of a lidar's scans, at most `count`, spread over the time of the poses."""
    covered = np.flatnonzero(odometry.covers(sensor.index.stamp_ns, margin_ns=-100_000_000))
    chosen = covered[np.unique(np.linspace(0, len(covered) - 1, min(count, len(covered))).astype(int))]
    scans: list[Scan] = []
    with open_bag(inputs.bag_path) as bag:
        for number in chosen.tolist():
            for _, scan in read_scans(bag, sensor.index, number, 1, sensor.lidar.decoding):
                if isinstance(scan, Scan) and len(near := within_range(scan, settings.scan.range_max_m)):
                    scans.append(near)
    return scans
