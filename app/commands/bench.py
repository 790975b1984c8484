"""ffmap bench: how fast this machine labels, and how much memory a run takes."""

import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import typer

from ffmap.algorithms.base.scan import FloatArray, Scan, within_range
from ffmap.algorithms.base.trajectory import PlacedScan, place_scan
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.algorithms.scan.smoothing import smooth_ranges
from ffmap.app.analysis.metrics_tables import PAPER_STATISTICS
from ffmap.app.commands import run as run_command
from ffmap.app.commands.simulate import simulate
from ffmap.app.folder.names import RECORDING, RunFolder
from ffmap.app.run.odometry_cache import CACHE_VARIABLE
from ffmap.app.run.poses import poses_of
from ffmap.app.run.start import Arguments
from ffmap.app.setup.inputs import InputOptions, find_inputs
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import read_scans

_SCANS = 60


def bench(bag: Path | None, duration_s: float) -> None:
    """Print labelling times of single scans on one thread, and time and memory of a whole run."""
    with tempfile.TemporaryDirectory(prefix="ffmap-bench-") as folder, _odometries_kept_in(Path(folder)):
        if bag is None:
            bag = Path(folder) / "office.bag"
            typer.echo(f"simulating {duration_s:.0f} s in building 'office' ...")
            simulate(bag, {"building": "office", "seed": 1, "duration_s": duration_s})
        _bench_run(bag, Path(folder) / "run")
        _bench_labelling(bag)


@contextmanager
def _odometries_kept_in(folder: Path) -> Iterator[None]:
    """Meanwhile an empty cache: an odometry from the user's would make the run look faster than it is."""
    before = {name: value for name, value in os.environ.items() if name == CACHE_VARIABLE}
    os.environ[CACHE_VARIABLE] = str(folder)
    try:
        yield
    finally:
        del os.environ[CACHE_VARIABLE]
        os.environ.update(before)


def _bench_run(bag: Path, out: Path) -> None:
    started = time.perf_counter()
    with _peak_memory() as peak:
        arguments = Arguments(bag=bag, out=out, workers=os.cpu_count() or 1, evaluate=False, quiet=True)
        run_command.run(arguments, None)
    seconds = time.perf_counter() - started
    with open_bag(bag) as opened:
        covered_s = ((opened.end_ns or 0) - (opened.start_ns or 0)) / 1e9
        clouds = sum(t.count for t in opened.topics.values() if t.msgtype.endswith("PointCloud2"))
    record = RunFolder(out).read_json()
    stages = ", ".join(
        f"{name.replace('_', ' ')} {record['timings_s'][name]:.1f} s"
        for name in ("odometry", "scans", "building", "final")
    )
    share = (out / RECORDING).stat().st_size / max(_cloud_bytes(bag), 1)
    typer.echo(
        f"whole run: takes {seconds:.1f} s for {covered_s:.1f} s of driving ({clouds} clouds), "
        f"{covered_s / seconds:.2f} s of driving a second"
    )
    typer.echo(f"  stages: {stages}")
    typer.echo(f"  memory: peak {peak[0] / 2**20:.0f} MiB (proportional set sizes of all processes, summed)")
    typer.echo(f"  recording: {share:.3f} of the clouds' bytes (22 a point)")


def _cloud_bytes(bag: Path) -> int:
    """22 bytes for each place of the lidars' clouds."""
    sensors = find_inputs(bag, InputOptions()).used(given_poses=False)
    return sum(22 * sensor.lidar.points_per_cloud * len(sensor.index) for sensor in sensors)


def _bench_labelling(bag: Path) -> None:
    settings = Settings()
    scans = _placed_scans(bag, settings)
    for index, scan, placed in scans[:5]:
        label_scan(scan, placed, settings.method, index)
    times_ms: FloatArray = np.empty(len(scans))
    for k, (index, scan, placed) in enumerate(scans):
        started = time.perf_counter()
        smooth_ranges(scan, settings.smoothing)
        label_scan(scan, placed, settings.method, index)
        times_ms[k] = 1e3 * (time.perf_counter() - started)
    points = np.mean([len(scan) for _, scan, _ in scans])
    typer.echo(f"labelling: {len(scans)} scans of {points:,.0f} points, smoothed and labelled, one thread, warm")
    mean, deviation, low, high = PAPER_STATISTICS["milliseconds_per_cloud"]
    typer.echo(
        f"  median {np.median(times_ms):.1f} ms, mean {times_ms.mean():.1f}, standard deviation {times_ms.std():.1f}, "
        f"min {times_ms.min():.1f}, max {times_ms.max():.1f} (paper: mean {mean}, standard deviation {deviation}, "
        f"min {low}, max {high} for {PAPER_STATISTICS['points_in_cloud'][0]:,} points)"
    )


def _placed_scans(bag: Path, settings: Settings) -> list[tuple[int, Scan, PlacedScan]]:
    """Some scans from all over the bag with their poses, from the odometry that the run left in the cache."""
    inputs = find_inputs(bag, InputOptions())
    if inputs.vertical is None or inputs.horizontal is None:
        raise InputError(f"{bag}: has no vertical lidar to label; give a bag of two lidars")
    trajectory = poses_of(inputs, None, settings).trajectory
    sensor, scans = inputs.vertical, []
    with open_bag(bag) as opened:
        for first in np.linspace(0, len(sensor.index) - 1, _SCANS).astype(int):
            for index, scan in read_scans(opened, sensor.index, int(first), 1, sensor.lidar.decoding):
                if isinstance(scan, Scan):
                    scan = within_range(scan, settings.scan.range_max_m)
                    ranges = smooth_ranges(scan, settings.smoothing)
                    scans.append((index, scan, place_scan(ranges.of(scan), trajectory, sensor.lidar.T_base_sensor)))
    return scans


@contextmanager
def _peak_memory() -> Iterator[list[int]]:
    """Samples the proportional set sizes of this process and all below it; the peak in bytes is the list's only entry."""
    peak, done = [0], threading.Event()

    def sample() -> None:
        own = psutil.Process()
        while not done.wait(0.2):
            total = 0
            for process in [own, *own.children(recursive=True)]:
                try:
                    total += process.memory_full_info().pss
                except (psutil.NoSuchProcess, psutil.AccessDenied, FileNotFoundError, ProcessLookupError):
                    continue
            peak[0] = max(peak[0], total)

    sampler = threading.Thread(target=sample, daemon=True)
    sampler.start()
    try:
        yield peak
    finally:
        done.set()
        sampler.join()
