"""ffmap calibrate: find the extrinsics and clock offsets of vertical lidars from a drive."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import typer

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.app.folder.atomic import written_whole
from ffmap.app.progress import Progress
from ffmap.app.record.calibration import write_calibration
from ffmap.app.run.extrinsics import (
    CheckedExtrinsics,
    check_extrinsics,
    drive_alone,
    extrinsics_by_motion,
)
from ffmap.app.run.sampled_scans import map_of, scans_of
from ffmap.app.setup.inputs import Inputs, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings, load_settings
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.fingerprint import fingerprint

_SCANS, _RETURNS = 200, 60_000
"""Number of scans of each lidar, spread over the drive, and of the vertical lidar's returns."""
_DRAWN = 12
"""Number of scans in the recording."""
_WALLS = "drive past walls on all sides, over a floor that both lidars see"
_SPOT = "turn on the spot once: on a straight way, a shift and a clock offset look alike"
_PARAMETERS = (
    ("roll", "deg", 0.1, _WALLS),
    ("pitch", "deg", 0.1, _WALLS),
    ("yaw", "deg", 0.1, _WALLS),
    ("x", "cm", 1.0, _SPOT),
    ("y", "cm", 1.0, _SPOT),
    ("z", "cm", 1.0, "drive where both lidars see the floor"),
    ("clock", "ms", 2.0, "turn on the spot once, left and right, as fast as possible"),
)
"""Name, unit, the standard deviation up to which it is well known, and the motion to improve it."""
_UNITS = {"deg": np.degrees(1.0), "cm": 100.0, "ms": 1e3}


def calibrate(
    bag: BagPath,
    options: RunOptions,
    out: Path,
    recording: Path | None,
    seconds: float,
    from_motion: bool,
) -> None:
    """Refine extrinsics, print and draw them, and write a rig file.

    from_motion: start from the lidars' motion instead of given extrinsics.
    Raises InputError without two lidars, or where they see too little in common.
    """
    inputs = find_inputs(bag, options, unplaced=from_motion)
    horizontal = inputs.horizontal
    if horizontal is None or not inputs.others:
        raise InputError(
            f"{bag}: a single lidar needs no calibration; give a bag of two, 'ffmap info "
            f"{bag.words}' lists them"
        )
    settings = load_settings(None, [])
    with Progress(options.quiet) as progress:
        hash_bag = partial(fingerprint, inputs.bag_path)
        drive = partial(drive_alone, inputs, settings, seconds, hash_bag, progress)
        odometry = drive(horizontal)
        if from_motion:
            seen = map_of(inputs, odometry, settings, _SCANS)
            first = []
            for sensor in inputs.others:
                found = extrinsics_by_motion(inputs, sensor, odometry, seen, settings, drive)
                if isinstance(found, str):
                    raise InputError(f"{bag}: {found}")
                first.append(found)
            inputs = inputs.with_mounts(first)
        progress.stage("extrinsics", None)
        checked: list[CheckedExtrinsics] = []
        if len(odometry) > 1:
            checked = check_extrinsics(inputs, odometry, settings, _SCANS, _SCANS, _RETURNS)
        topics = {sensor.lidar.topic for sensor in inputs.others}
        if unseen := sorted(topics - {mount.topic for mount in checked}):
            raise InputError(
                f"{bag}: {horizontal.lidar.topic} and {unseen[0]} see too little in common; drive "
                "between walls, and start from extrinsics within 20 deg and half a metre"
            )
        for lidar in checked:
            if not lidar.fits:
                raise InputError(
                    f"{bag}: no extrinsics of {lidar.topic} near the given ones fit: surfaces that "
                    f"both lidars see stay {100 * lidar.found.rms_after_m:.1f} cm apart (noise: "
                    f"{100 * lidar.own_rms_m:.1f} cm); start without them, by --from-motion"
                )
        refined = inputs.with_mounts(mount.correction for mount in checked)
        if recording is not None:
            room = map_of(inputs, odometry, settings, _SCANS)
            before, after = (_placed(i, odometry, settings) for i in (inputs, refined))
            height_m = float(horizontal.lidar.T_base_sensor[2, 3])
            write_calibration(recording, height_m, room, before, after)
    with written_whole(out) as part:
        part.write_text(_rig_text(refined, checked))
    for mount in checked:
        _print(mount)
    typer.echo(f"rig file: {out}  (ffmap run {bag.words} --rig {out})")
    if recording is not None:
        typer.echo(f"recording: {recording}  (before red, after green; ffmap view {recording})")


def _placed(inputs: Inputs, odometry: Trajectory, settings: Settings) -> FloatArray:
    """(n, 3) some returns of the vertical lidars by their extrinsics."""
    placed = [
        place_scan(scan, odometry, sensor.lidar.T_base_sensor)
        for sensor in inputs.others
        for scan in scans_of(inputs, sensor, odometry, settings, _DRAWN)
    ]
    return np.concatenate([p.to_map(p.points_level[::4]) for p in placed])


def _rig_text(inputs: Inputs, checked: Sequence[CheckedExtrinsics]) -> str:
    """The rig file of all lidars."""
    text = [
        f"# {mount.topic}: surfaces of both lidars were {100 * mount.found.rms_before_m:.1f} cm "
        f"apart, refined {100 * mount.found.rms_after_m:.1f} cm."
        for mount in checked
    ]
    text.append(f"base = {json.dumps(inputs.rig.base_frame)}")
    labelled = {sensor.lidar.topic for sensor in inputs.verticals}
    for sensor in inputs.sensors:
        lidar = sensor.lidar
        drives = inputs.horizontal is not None and lidar.topic == inputs.horizontal.lidar.topic
        role = "vertical" if not drives else "both" if lidar.topic in labelled else "horizontal"
        quaternion_xyzw = transforms.quaternion_xyzw(lidar.T_base_sensor)
        text += [
            "",
            "[[lidar]]",
            f"topic = {json.dumps(lidar.topic)}",
            f"role = {json.dumps(role)}",
            f"translation = {[round(float(v), 5) for v in lidar.T_base_sensor[:3, 3]]}",
            f"quaternion_xyzw = {[round(float(v), 7) for v in quaternion_xyzw]}",
        ]
        if lidar.decoding.clock_ns:
            text.append(f"clock_s = {lidar.decoding.clock_ns / 1e9:.6f}")
    return "\n".join(text) + "\n"


def _print(checked: CheckedExtrinsics) -> None:
    found = checked.found
    typer.echo(f"{checked.topic}:")
    for parameter, change, sigma in zip(_PARAMETERS, checked.change, found.sigma, strict=True):
        name, unit, known_max, advice = parameter
        change, sigma = _UNITS[unit] * change, _UNITS[unit] * sigma
        advice = f"  to improve: {advice}" if sigma > known_max else ""
        typer.echo(f"  {name:<5} changed by {change:+8.2f} {unit:<3} (1 sigma {sigma:.2f}){advice}")
    before, after = 100 * found.rms_before_m, 100 * found.rms_after_m
    typer.echo(
        f"distance of both lidars' surfaces: {before:.2f} cm as given, {after:.2f} cm refined, "
        f"{found.returns} returns"
    )
