"""The odometry of a bag: registered in a process of its own, for KISS-ICP holds the interpreter's lock, and cached.

The cache lies in the user's cache folder. Its key holds all that a pose depends on and no labelling setting, so that a
sweep over labelling settings costs one odometry.
"""

import hashlib
import json
import multiprocessing as mp
import os
import queue
import shutil
import sys
from collections.abc import Iterator
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path

import numpy as np

from algorithms import transforms
from algorithms.odometry import Registration
from algorithms.pose_graph import PoseGraph
from algorithms.scan import FloatArray, Scan, within_range
from algorithms.trajectory import Trajectory
from app.inputs import Inputs, Sensor
from app.processes import leave_interrupts_to_the_run, process_context
from app.settings import Settings
from loaders.bag import open_bag
from loaders.scans import read_scans

CACHE_VARIABLE = "FFMAP_CACHE"
"""The environment variable that names the folder of the cache, before anything else does."""

_PER_FILE = 50
_GRAPH = "pose_graph.npz"
_FORMAT = 7
"""Raised whenever a change to reading or registering scans changes poses."""


def cache_folder() -> Path:
    """Where odometries are kept: in $FFMAP_CACHE, else in $XDG_CACHE_HOME or ~/.cache, or what the system uses instead."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named) / "odometry"
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "furniture-free-mapping" / "odometry"


def cache_key(inputs: Inputs, sensor: Sensor, settings: Settings) -> str:
    """What the poses depend on, as a name."""
    companion = _companion(inputs, settings)
    content = {
        "format": _FORMAT,
        "bag": inputs.bag_digest,
        "topic": sensor.lidar.topic,
        "time_from": sensor.lidar.decoding.time_from,
        "companion": companion.lidar.topic if companion else None,
        "rig": [s.lidar.T_base_sensor.tolist() for s in (sensor, companion) if s is not None],
        "kiss_icp": version("kiss-icp"),
        "small_gicp": version("small_gicp"),
        "gtsam": version("gtsam"),
        "scan": settings.scan.model_dump(mode="json"),
        "odometry": settings.odometry.model_dump(mode="json"),
        "refinement": settings.refinement.model_dump(mode="json"),
        "pose_graph": settings.pose_graph.model_dump(mode="json"),
        "trajectory": settings.trajectory.model_dump(mode="json"),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


class Odometry:
    """The registration of every usable horizontal scan in order, and after them the loops that were closed.

    What is not cached is registered while it is iterated over, once, and cached when that has come to its end.
    """

    def __init__(self, inputs: Inputs, sensor: Sensor, settings: Settings) -> None:
        folder = cache_folder() / cache_key(inputs, sensor, settings)
        self.from_cache = is_cached(folder)
        self._source = _from_cache(folder) if self.from_cache else _register(inputs, sensor, settings, folder)
        self._T_sensor_base = transforms.invert(sensor.lidar.T_base_sensor)
        self._stamps: list[int] = []
        self._T_odom_sensor: list[FloatArray] = []
        self.pose_graph: PoseGraph | None = None
        """None before the end, and where loops are not to be closed."""

    def __iter__(self) -> Iterator[Registration]:
        for result in self._source:
            if isinstance(result, PoseGraph):
                self.pose_graph = result
            else:
                self._stamps.append(result.stamp_ns)
                self._T_odom_sensor.append(result.T_odom_sensor)
                yield result

    def __len__(self) -> int:
        """How many scans have been registered so far."""
        return len(self._stamps)

    @property
    def trajectory(self) -> Trajectory:
        """T_odom_base of the scans so far; of all of them with the loops closed."""
        T_odom_sensor = self._all_poses()
        if self.pose_graph is not None:
            T_odom_sensor = self.pose_graph.corrected(T_odom_sensor)
        return Trajectory(np.array(self._stamps, np.int64), T_odom_sensor @ self._T_sensor_base)

    @property
    def before_loops(self) -> Trajectory:
        """T_odom_base of the scans so far, as they were registered."""
        return Trajectory(np.array(self._stamps, np.int64), self._all_poses() @ self._T_sensor_base)

    def _all_poses(self) -> FloatArray:
        return np.array(self._T_odom_sensor).reshape(-1, 4, 4)


def is_cached(folder: Path) -> bool:
    """Whether the odometry that this folder of the cache is for need not be computed again."""
    return (folder / "complete").exists()


def _from_cache(folder: Path) -> Iterator[Registration | PoseGraph]:
    for path in sorted(folder.glob("[0-9]*.npz")):
        with np.load(path) as stored:
            columns = {field.name: stored[field.name] for field in fields(Registration)}
            lengths = {name: stored[f"{name}_length"] for name in ("keypoints_sensor", "local_map_odom")}
        ragged = {name: np.split(columns.pop(name), np.cumsum(lengths[name])[:-1]) for name in lengths}
        for i in range(len(columns["index"])):
            yield Registration(
                index=int(columns["index"][i]),
                stamp_ns=int(columns["stamp_ns"][i]),
                T_odom_sensor=columns["T_odom_sensor"][i],
                keypoints_sensor=ragged["keypoints_sensor"][i],
                local_map_odom=ragged["local_map_odom"][i],
                threshold_m=float(columns["threshold_m"][i]),
                correction_m=float(columns["correction_m"][i]),
                residual_m=float(columns["residual_m"][i]),
                inlier_share=float(columns["inlier_share"][i]),
                refined_m=float(columns["refined_m"][i]),
                refined_inlier_share=float(columns["refined_inlier_share"][i]),
                weakest_share=float(columns["weakest_share"][i]),
                refused=bool(columns["refused"][i]),
                milliseconds=float(columns["milliseconds"][i]),
            )
    if (folder / _GRAPH).exists():
        with np.load(folder / _GRAPH) as stored:
            yield PoseGraph(**stored)


def _register(
    inputs: Inputs, sensor: Sensor, settings: Settings, folder: Path
) -> Iterator[Registration | PoseGraph]:
    part = folder.with_name(f"{folder.name}.{os.getpid()}.part")
    shutil.rmtree(part, ignore_errors=True)
    context = process_context()
    results: mp.Queue[Registration | PoseGraph | str | None] = context.Queue(maxsize=64)
    process = context.Process(
        target=_odometry_process, args=(inputs, sensor, settings, results), name="odometry", daemon=True
    )
    process.start()
    waiting: list[Registration] = []
    written = 0
    cachable = _make(part)
    try:
        while True:
            try:
                result = results.get(timeout=1.0)
            except queue.Empty:
                if not process.is_alive():
                    raise RuntimeError(f"the odometry process ended with exit code {process.exitcode}") from None
                continue
            if isinstance(result, str):
                raise RuntimeError(f"the odometry failed:\n{result}")
            if cachable and waiting and (result is None or len(waiting) == _PER_FILE):
                _store(part / f"{written:06d}.npz", waiting)
                written += 1
                waiting = []
            if result is None:
                break
            if cachable and isinstance(result, PoseGraph):
                np.savez(part / _GRAPH, allow_pickle=False, **{f.name: getattr(result, f.name) for f in fields(result)})
            elif cachable and isinstance(result, Registration):
                waiting.append(result)
            yield result
        if cachable:
            (part / "complete").touch()
            shutil.rmtree(folder, ignore_errors=True)
            part.replace(folder)
    finally:
        process.kill()
        process.join()
        shutil.rmtree(part, ignore_errors=True)


def _make(part: Path) -> bool:
    """A cache that cannot be written costs time, nothing else."""
    try:
        part.mkdir(parents=True)
    except OSError:
        return False
    return True


def _store(path: Path, stored: list[Registration]) -> None:
    columns = {field.name: [getattr(r, field.name) for r in stored] for field in fields(Registration)}
    ragged = {name: columns.pop(name) for name in ("keypoints_sensor", "local_map_odom")}
    arrays = {
        **{name: np.array(values) for name, values in columns.items()},
        **{name: np.concatenate(values) for name, values in ragged.items()},
        **{f"{name}_length": np.array([len(v) for v in values]) for name, values in ragged.items()},
    }
    np.savez(path, allow_pickle=False, **arrays)


def _odometry_process(
    inputs: Inputs, sensor: Sensor, settings: Settings, results: "mp.Queue[Registration | PoseGraph | str | None]"
) -> None:
    leave_interrupts_to_the_run()
    # Imported here: only this process needs KISS-ICP.
    import traceback

    from algorithms.odometry import register_scans
    from algorithms.pose_graph import close_loops

    companion = _companion(inputs, settings)
    T_sensor_companion = None
    if companion is not None:
        T_sensor_companion = transforms.invert(sensor.lidar.T_base_sensor) @ companion.lidar.T_base_sensor
    try:
        scans = _with_companions(inputs.bag_path, sensor, companion, settings.scan.range_max_m)
        poses: list[FloatArray] = []
        clouds: list[FloatArray] = []
        last_ns = -1
        for registration in register_scans(scans, settings.odometry, settings.refinement, T_sensor_companion):
            # A clock that steps back gives a second pose for a time that has one.
            if registration.stamp_ns <= last_ns:
                continue
            last_ns = registration.stamp_ns
            results.put(registration)
            poses.append(registration.T_odom_sensor)
            clouds.append(registration.keypoints_sensor)
        if settings.pose_graph.enabled:
            results.put(close_loops(np.array(poses).reshape(-1, 4, 4), clouds, settings.pose_graph))
        results.put(None)
    except Exception:
        results.put(traceback.format_exc())


def _companion(inputs: Inputs, settings: Settings) -> Sensor | None:
    """The lidar whose scans are registered with the horizontal one's."""
    wanted = settings.refinement.enabled and settings.refinement.companion_points_max > 0
    return inputs.vertical if wanted else None


def _with_companions(
    bag_path: Path, sensor: Sensor, companion: Sensor | None, range_max_m: float
) -> Iterator[tuple[int, Scan, Scan | None]]:
    """The usable scans in order; beside each the companion's last one that ended before it, once."""
    others = _usable_scans(bag_path, companion, range_max_m) if companion is not None else iter(())
    following = next(others, None)
    for index, scan in _usable_scans(bag_path, sensor, range_max_m):
        latest: Scan | None = None
        while following is not None and following[1].end_ns <= scan.end_ns:
            latest = following[1]
            following = next(others, None)
        if latest is not None and scan.end_ns - latest.end_ns > _COMPANION_NS:
            latest = None
        yield index, scan, latest


_COMPANION_NS = 200_000_000
"""A companion's scan that ended longer ago says too little of where the sensor is now."""


def _usable_scans(bag_path: Path, sensor: Sensor, range_max_m: float) -> Iterator[tuple[int, Scan]]:
    """The usable scans in order, without the returns that are too far away: a registration may fail on them."""
    with open_bag(bag_path) as bag:
        for index, scan in read_scans(bag, sensor.index, 0, None, sensor.lidar.decoding):
            if isinstance(scan, Scan) and len(near := within_range(scan, range_max_m)):
                yield index, near
