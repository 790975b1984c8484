"""ffmap calibrate: where vertical lidars sit and by which clocks they run, from a drive; a rig file and a picture of all."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import typer

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.app.folder.atomic import written_whole
from ffmap.app.progress import Progress
from ffmap.app.record.calibration import write_calibration
from ffmap.app.run.mount_check import CheckedMount, check_mounts, map_of, scans_of
from ffmap.app.run.stage_mounts import drive_alone, mount_by_motion
from ffmap.app.setup.inputs import Inputs, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings, load_settings
from ffmap.app.tables import make_table, table_console
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

_SCANS, _RETURNS = 200, 60_000
"""Number of scans of each lidar that are used, spread over the drive, and of returns that are laid on the other's map."""
_DRAWN = 12
_NAMES = ("roll", "pitch", "yaw", "x", "y", "z", "clock")
_SCALE = np.array([np.degrees(1.0)] * 3 + [100.0] * 3 + [1e3])
"""To degrees, centimetres and milliseconds."""
_KNOWN = (*(0.1,) * 3, *(1.0,) * 3, 2.0)
"""Degrees, centimetres and milliseconds up to which each of the seven is well known."""
_MOTION = (
    *("drive past walls on all sides, and over a floor that both lidars see",) * 3,
    "turn on the spot once: along the way a shift does what a clock does",
    "turn on the spot once: along the way a shift does what a clock does",
    "drive where both lidars see the floor",
    "turn on the spot once, left and right: the faster the motion, the more it tells of the clock",
)


def calibrate(
    bag: BagPath,
    options: RunOptions,
    out: Path,
    recording: Path | None,
    seconds: float,
    from_motion: bool,
) -> None:
    """Refine, tell, draw and write; raises InputError where the bag has no two lidars, or too little that both see.

    from_motion: whether to start from the lidars' motion in place of the mounts that are given.
    """
    inputs = find_inputs(bag, options, unplaced=from_motion)
    horizontal = inputs.horizontal
    if horizontal is None or not inputs.others:
        raise InputError(
            f"{bag}: one lidar alone has no mount to refine; give a bag of two, 'ffmap info {bag.words}' lists them"
        )
    settings = load_settings(None, [])
    with Progress(options.quiet) as progress:
        odometry = drive_alone(inputs, horizontal, settings, seconds, progress)
        if from_motion:
            seen = map_of(inputs, odometry, settings, _SCANS)
            motions = []
            for sensor in inputs.others:
                found = mount_by_motion(inputs, sensor, odometry, seen, settings, seconds, progress)
                if isinstance(found, str):
                    raise InputError(f"{bag}: {found}")
                motions.append(found)
            inputs = inputs.with_mounts(motions)
        progress.stage("mount", None)
        checked = check_mounts(inputs, odometry, settings, _SCANS, _SCANS, _RETURNS) if len(odometry) > 1 else []
        placed = {mount.topic for mount in checked}
        if unseen := [sensor.lidar.topic for sensor in inputs.others if sensor.lidar.topic not in placed]:
            raise InputError(
                f"{bag}: {horizontal.lidar.topic} and {unseen[0]} see too little in common; drive between walls, "
                "and start from a mount that is off by less than about 20 deg and half a metre"
            )
        refined = inputs.with_mounts(mount.correction for mount in checked)
        if recording is not None:
            room, height_m = map_of(inputs, odometry, settings, _SCANS), float(horizontal.lidar.T_base_sensor[2, 3])
            write_calibration(recording, height_m, room, *(_laid(i, odometry, settings) for i in (inputs, refined)))
    with written_whole(out) as part:
        part.write_text(_rig_text(refined, checked))
    for mount in checked:
        _tell(mount)
    typer.echo(f"rig file: {out}  (ffmap run {bag.words} --rig {out})")
    if recording is not None:
        typer.echo(f"recording: {recording}  (before red, after green; ffmap view {recording})")


def _laid(inputs: Inputs, odometry: Trajectory, settings: Settings) -> FloatArray:
    """(n, 3) what the vertical lidars saw, where the mounts put it."""
    placed = [
        place_scan(scan, odometry, sensor.lidar.T_base_sensor)
        for sensor in inputs.others
        for scan in scans_of(inputs, sensor, odometry, settings, _DRAWN)
    ]
    return np.concatenate([p.to_map(p.points_level[::4]) for p in placed])


def _rig_text(inputs: Inputs, checked: Sequence[CheckedMount]) -> str:
    """The rig file that says where all lidars sit."""
    text = [
        f"# Refined{'' if mount.alone else f' {mount.topic}'}: {100 * mount.found.rms_before_m:.1f} cm between what both lidars "
        f"see before, {100 * mount.found.rms_after_m:.1f} cm after."
        for mount in checked
    ]
    text.append(f"base = {json.dumps(inputs.rig.base_frame)}")
    labelled = {sensor.lidar.topic for sensor in inputs.verticals}
    for sensor in inputs.used(given_poses=False):
        drives = inputs.horizontal is not None and sensor.lidar.topic == inputs.horizontal.lidar.topic
        role = "vertical" if not drives else "both" if sensor.lidar.topic in labelled else "horizontal"
        T = sensor.lidar.T_base_sensor
        text += [
            "",
            "[[lidar]]",
            f"topic = {json.dumps(sensor.lidar.topic)}",
            f"role = {json.dumps(role)}",
            f"translation = {[round(float(v), 5) for v in T[:3, 3]]}",
            f"quaternion_xyzw = {[round(float(v), 7) for v in transforms.quaternion_xyzw(T)]}",
        ]
        if sensor.lidar.decoding.clock_ns:
            text.append(f"clock_s = {sensor.lidar.decoding.clock_ns / 1e9:.6f}")
    return "\n".join(text) + "\n"


def _tell(checked: CheckedMount) -> None:
    found = checked.found
    if not checked.alone:
        typer.echo(f"{checked.topic}:")
    changes, sigma = _SCALE * checked.change, _SCALE * found.sigma
    units = (*("deg",) * 3, *("cm",) * 3, "ms")
    rows = (
        (name, f"{change:+.2f} {unit}", f"{known:.2f} {unit}", motion if known > limit else "")
        for name, unit, change, known, limit, motion in zip(_NAMES, units, changes, sigma, _KNOWN, _MOTION, strict=True)
    )
    headings = ("", "refined by", "known to (1 sigma)", "what would tell more")
    table_console().print(make_table(None, headings, rows, left=(0, 3)))
    before, after = 100 * found.rms_before_m, 100 * found.rms_after_m
    typer.echo(
        f"what both lidars see: {before:.2f} cm apart as given, {after:.2f} cm as refined, {found.returns} returns"
    )
