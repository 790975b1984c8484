"""`ffmap evaluate --suite`: generated buildings of many kinds, driven through, mapped and compared with the truth.

Every drive is simulated, run by the program as a user runs it, evaluated, and deleted; what stays is its figures, cached
by the simulation, the settings and the code that they depend on.
"""

import hashlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ffmap.app.analysis.metrics_tables import PAPER, Metrics
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.names import METRICS, RUN_JSON, require_writable
from ffmap.app.progress import Progress
from ffmap.app.run.odometry_cache import cache_folder
from ffmap.app.setup.settings import load_settings
from ffmap.loaders.errors import InputError
from ffmap.loaders.text_files import read_json

DURATION_S = 60.0
QUICK_S = 40.0
LONG_S = 150.0
REPORTED_SEEDS = (1001, 1002)
"""No threshold is set on these, but on drives of lower seeds."""

CODE = ("algorithms", "loaders", "app")


@dataclass(frozen=True)
class Case:
    """One kind of building and drive: what `ffmap simulate --set` takes."""

    name: str
    simulation: Mapping[str, Any]


CASES = (
    Case("office", {"building": "office"}),
    Case("crammed office", {"building": "office", "clutter": 1.0, "walking_people": 3, "glass": 0.2}),
    Case("empty, VLP-16", {"building": "office", "clutter": 0.0, "sensor": "vlp16", "wall_thickness_m": 0.1}),
    Case(
        "odd angles, glass",
        {"building": "angled", "glass": 0.9, "recess_min_m": 0.02, "recess_max_m": 0.08, "mount_tilt_deg": 5.0},
    ),
    Case("high, OS1-16", {"building": "ell", "ceiling_m": 4.0, "wall_thickness_m": 0.35, "sensor": "os1-16"}),
    Case(
        "low, fast, swaying",
        {"building": "ell", "ceiling_m": 2.5, "double_share": 0.5, "speed_mps": 1.0, "sway_deg": 1.0},
    ),
    Case("hall, ramp", {"building": "lab", "ramp_rise_m": 0.3, "walking_people": 4}),
    Case(
        "slope, sills, step",
        {"building": "angled", "floor_slope_deg": 1.0, "door_sills_m": 0.02, "step_m": 0.15, "clutter": 0.8},
    ),
)
LONG_CASES = (Case("office, 150 s", {"building": "office"}), Case("ell, 150 s", {"building": "ell"}))


@dataclass(frozen=True)
class Figure:
    """A figure of `metrics.json` in a table.

    path: its keys; fractions become percent, metres centimetres, lists their length.
    """

    heading: str
    path: tuple[str, ...]
    less_is_better: bool = False

    def of(self, metrics: Metrics) -> float | None:
        """The figure, fractions and metres times 100; None where the run has none."""
        value: Any = metrics
        for key in self.path:
            value = value.get(key) if isinstance(value, Mapping) else None
        if isinstance(value, list):
            return float(len(value))
        return None if value is None else 100.0 * float(value)


def _label_figures(*labels: str) -> tuple[Figure, ...]:
    return tuple(
        Figure(heading, ("area", label, name))
        for label in labels
        for heading, name in ((f"{label} P", "precision"), ("R", "recall"), ("F1", "f1"))
    )


TABLES: tuple[tuple[str, tuple[Figure, ...]], ...] = (
    ("Labels by area, percent (Table II)", _label_figures("wall", "ceiling", "floor")),
    (
        "Labels by area, percent",
        (
            *_label_figures("door", "clutter"),
            Figure("outside kept", ("area", "outside_kept_as_structure"), less_is_better=True),
        ),
    ),
    (
        "Doors, trajectory, percent and centimetres",
        (
            Figure("found", ("doors", "found")),
            Figure("invented", ("doors", "invented"), less_is_better=True),
            Figure("width cm", ("doors", "width_error_m"), less_is_better=True),
            Figure("state", ("doors", "state_right")),
            Figure("ATE cm", ("trajectory", "ate_rmse_m"), less_is_better=True),
        ),
    ),
    (
        "Wall cells of the furniture-free grid, and of slices below the ceiling (c) and in the middle (m), percent",
        (
            Figure("P", ("maps", "furniture_free", "precision")),
            Figure("no cabinets", ("maps", "furniture_free", "precision_without_cabinets")),
            Figure("R", ("maps", "furniture_free", "recall")),
            Figure("off cm", ("maps", "furniture_free", "error_m"), less_is_better=True),
            Figure("blocked", ("maps", "furniture_free", "blocked"), less_is_better=True),
            Figure("c P", ("maps", "below_ceiling", "precision")),
            Figure("c R", ("maps", "below_ceiling", "recall")),
            Figure("c blocked", ("maps", "below_ceiling", "blocked"), less_is_better=True),
            Figure("m P", ("maps", "middle", "precision")),
            Figure("m R", ("maps", "middle", "recall")),
            Figure("m blocked", ("maps", "middle", "blocked"), less_is_better=True),
        ),
    ),
    (
        "Rooms: percent, and how many were split or merged",
        (
            Figure("recall", ("rooms", "recall")),
            Figure("precision", ("rooms", "precision")),
            Figure("recall of all", ("rooms", "recall_of_all")),
            Figure("split", ("rooms", "split"), less_is_better=True),
            Figure("merged", ("rooms", "merged"), less_is_better=True),
        ),
    ),
)


@dataclass(frozen=True)
class Drive:
    """One case with one seed; `metrics` is None where the drive failed, `error` says how then."""

    case: str
    seed: int
    metrics: Metrics | None
    error: str = ""
    seconds: float = 0.0
    cached: bool = False


def run_suite(
    out: Path,
    seeds: Sequence[int],
    quick: bool,
    overrides: Sequence[str],
    quiet: bool = False,
    at_once: int | None = None,
) -> int:
    """Drive through every building with every seed, print the tables, write `out`; returns how many drives failed.

    quick: one seed, short drives, no long ones. at_once: drives under way at a time, each one core's work; None for one a core.
    """
    settings = load_settings(None, overrides)
    duration_s = QUICK_S if quick else DURATION_S
    jobs = [(case, seed, duration_s) for case in CASES for seed in (seeds[:1] if quick else seeds)]
    jobs += [] if quick else [(case, seeds[0], LONG_S) for case in LONG_CASES]
    at_once = min(at_once or os.cpu_count() or 1, len(jobs))
    drives: list[Drive] = []
    started = time.monotonic()
    # Of drives that take minutes each, what came of those before an interruption stays there.
    part = out.with_name(f"{out.name}.part")
    _check_replaceable(out)
    _check_space(out.parent, at_once)

    def drive_through(job: tuple[Case, int, float]) -> Drive:
        case, seed, duration_s = job
        simulation = {**case.simulation, "seed": seed, "duration_s": duration_s}
        return _drive(case, seed, simulation, overrides, settings.short_hash(), out.parent)

    with Progress(quiet) as progress, ThreadPoolExecutor(at_once) as pool:
        progress.stage("suite", len(jobs))
        try:
            for drive in pool.map(drive_through, jobs):
                if drive.metrics is None:
                    progress.warn(f"{drive.case}, seed {drive.seed}: {drive.error}")
                drives.append(drive)
                _write(part, drives, overrides, settings.short_hash())
                progress.advance()
            part.replace(out)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    console = Console(width=max(Console().width, _WIDTH))
    for table in format_suite(drives):
        console.print(table)
    failed = sum(drive.metrics is None for drive in drives)
    console.print(
        f"{len(drives) - failed} of {len(drives)} drives, {sum(drive.cached for drive in drives)} from the cache, "
        f"in {(time.monotonic() - started) / 60:.1f} minutes: {out}",
        highlight=False,
    )
    return failed


def parse_seeds(text: str | None) -> tuple[int, ...]:
    """Seeds from a list like 1,2; raises InputError where it is none."""
    if text is None:
        return REPORTED_SEEDS
    try:
        seeds = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--seeds {text}: write whole numbers, as in --seeds 1001,1002") from None
    if any(seed < 0 for seed in seeds):
        raise InputError(f"--seeds {text}: a seed is not negative")
    return seeds


def _drive(
    case: Case, seed: int, simulation: Mapping[str, Any], overrides: Sequence[str], settings_hash: str, folder: Path
) -> Drive:
    """Simulate, run, evaluate and delete one drive, or take its figures from the cache."""
    key = json.dumps({"simulation": simulation, "settings": settings_hash, "code": code_digest()}, sort_keys=True)
    cached = cache_folder().parent / "suite" / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.json"
    with suppress(OSError, ValueError):
        return Drive(case.name, seed, json.loads(cached.read_text()), cached=True)
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="suite-", dir=folder) as work:
        bag, run = Path(work) / "drive.bag", Path(work) / "run"
        values = [f"{name}={json.dumps(value)}" for name, value in simulation.items()]
        named = [argument for value in values for argument in ("--set", value)]
        options = [argument for override in overrides for argument in ("--set", override)]
        for command in (
            ["simulate", str(bag), "--quiet", *named],
            ["run", str(bag), "--out", str(run), "--no-save", "--quiet", "--workers", "1", *options],
        ):
            done = subprocess.run([*_FFMAP, *command], capture_output=True, text=True, check=False)
            if done.returncode:
                return Drive(case.name, seed, None, (done.stderr.strip().splitlines() or ["no reason given"])[-1])
        metrics: Metrics = json.loads((run / METRICS).read_text())
        record = json.loads((run / RUN_JSON).read_text())
        metrics["run"] = {name: record[name] for name in ("timings_s", "counts")}
    cached.parent.mkdir(parents=True, exist_ok=True)
    write_json(cached, metrics)
    return Drive(case.name, seed, metrics, seconds=time.monotonic() - started)


_FFMAP = [sys.executable, "-c", "from ffmap.app.cli import main; main()"]


@cache
def code_digest() -> str:
    """Of all the code that figures depend on."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for path in sorted(path for folder in CODE for path in (root / folder).rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _write(out: Path, drives: Iterable[Drive], overrides: Sequence[str], settings_hash: str) -> None:
    write_json(
        out,
        {
            "settings_hash": settings_hash,
            "overrides": list(overrides),
            "code": code_digest(),
            "drives": [
                {"case": d.case, "seed": d.seed, "seconds": d.seconds, "error": d.error, "metrics": d.metrics}
                for d in drives
            ],
        },
    )


def _check_replaceable(out: Path) -> None:
    """Raises InputError where a file would be replaced that no suite has written."""
    if not out.exists():
        return
    advice = "it is not by 'ffmap evaluate --suite'; name another file with --out"
    content = read_json(out, advice)
    if not isinstance(content, dict) or "drives" not in content:
        raise InputError(f"{out}: is there already, and {advice}")


def format_suite(drives: Sequence[Drive]) -> list[Table]:
    """One line a building: the mean over its seeds and half their spread; then mean and worst of the buildings."""
    return [_table(title, figures, drives) for title, figures in TABLES]


def _table(title: str, figures: Sequence[Figure], drives: Sequence[Drive]) -> Table:
    table = Table(title=title, title_justify="left", padding=(0, 1, 0, 0))
    table.add_column("building", no_wrap=True)
    for figure in figures:
        table.add_column(figure.heading, justify="right", no_wrap=True)
    means: list[list[float]] = [[] for _ in figures]
    for case in dict.fromkeys(drive.case for drive in drives):
        own = [drive.metrics for drive in drives if drive.case == case and drive.metrics is not None]
        columns = [[v for metrics in own if (v := figure.of(metrics)) is not None] for figure in figures]
        table.add_row(case, *map(_cell, columns))
        for mean, values in zip(means, columns, strict=True):
            mean.extend([statistics.fmean(values)] if values else [])
    table.add_section()
    table.add_row("mean", *(_cell([statistics.fmean(mean)] if mean else []) for mean in means))
    worst = [max if figure.less_is_better else min for figure in figures]
    table.add_row("worst", *(_cell([of(mean)] if mean else []) for of, mean in zip(worst, means, strict=True)))
    table.add_row("paper", *map(_paper, figures))
    return table


def _cell(values: Sequence[float]) -> str:
    """The mean, and half the spread where there are several."""
    if not values:
        return "–"
    mean = f"{statistics.fmean(values):.1f}"
    return mean if len(values) < 2 else f"{mean}±{(max(values) - min(values)) / 2:.1f}"


def _paper(figure: Figure) -> str:
    by_name = {label.name.lower(): figures for label, figures in PAPER.items()}
    if figure.path[0] != "area" or figure.path[1] not in by_name:
        return "–"
    return f"{100 * by_name[figure.path[1]][('precision', 'recall', 'f1').index(figure.path[2])]:.1f}"


def _check_space(folder: Path, at_once: int) -> None:
    """Raises InputError where the bags and runs of the drives under way cannot be written, or would not fit on the disk."""
    require_writable(folder, "name a file in another folder with --out")
    free, needed = shutil.disk_usage(folder).free, at_once * _NEEDED_BYTES
    if free < needed:
        raise InputError(
            f"{folder}: {free / 1e9:.0f} GB are free and {at_once} drives of the suite at once need {needed / 1e9:.0f}; "
            "free some, choose another folder with --out, or fewer drives at once with --workers"
        )


_NEEDED_BYTES = 9_000_000_000
"""Of one drive: the bag of a long one, the bag with labels, and the run's spool."""
_WIDTH = 120
"""Where nobody's terminal says how wide it is, the tables stay whole."""
