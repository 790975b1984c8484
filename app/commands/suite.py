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
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from rich.table import Table

from ffmap.app.analysis.metrics_tables import PAPER, Metrics
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.figures import less_is_better
from ffmap.app.folder.names import METRICS, RUN_JSON, require_writable
from ffmap.app.progress import Progress
from ffmap.app.run.odometry_cache import cache_folder
from ffmap.app.setup.settings import load_settings
from ffmap.app.tables import make_table, table_console
from ffmap.loaders.errors import InputError
from ffmap.loaders.text_files import read_json

DURATION_S = 60.0
DRAWN_S = 45.0
QUICK_S = 40.0
LONG_S = 150.0
REPORTED_SEEDS = (1001, 1002)
"""No threshold is set on these, but on drives of lower seeds."""

CODE = ("algorithms", "loaders", "app")


Simulation = Mapping[str, Any]
"""What `ffmap simulate --set` takes."""
CASES: dict[str, Simulation] = {
    "office": {"building": "office"},
    "crammed office": {"building": "office", "clutter": 1.0, "walking_people": 3, "glass": 0.2},
    "empty, VLP-16": {"building": "office", "clutter": 0.0, "sensor": "vlp16", "wall_thickness_m": 0.1},
    "odd angles, glass": {
        "building": "angled",
        "glass": 0.9,
        "mount_tilt_deg": 5.0,
        "recess_min_m": 0.02,
        "recess_max_m": 0.08,
    },
    "high, OS1-16": {"building": "ell", "ceiling_m": 4.0, "wall_thickness_m": 0.35, "sensor": "os1-16"},
    "low, fast, swaying": {"building": "ell", "ceiling_m": 2.5, "double_share": 0.5, "speed_mps": 1.0, "sway_deg": 1.0},
    "hall, ramp": {"building": "lab", "ramp_rise_m": 0.3, "walking_people": 4},
    "slope, sills, step": {
        "building": "angled",
        "floor_slope_deg": 1.0,
        "door_sills_m": 0.02,
        "step_m": 0.15,
        "clutter": 0.8,
    },
}
"""Kinds of buildings and drives."""
DRAWN_CASES: dict[str, Simulation] = {
    "dwelling": {"building": "dwelling"},
    "workplace": {"building": "workplace", "speed_mps": 0.8},
    "institution": {"building": "institution", "speed_mps": 0.9},
    "dwelling, VLP-16": {"building": "dwelling", "sensor": "vlp16"},
    "workplace, OS0-128": {"building": "workplace", "speed_mps": 0.8, "sensor": "os0-128", "lidars": "one"},
    "institution, busy": {"building": "institution", "speed_mps": 0.9, "walking_people": 5, "mount_tilt_deg": 4.0},
    "dwelling, crammed": {"building": "dwelling", "intensity_half_m": 30.0, "clutter": 0.8},
    "workplace, VLP-16": {"building": "workplace", "speed_mps": 0.8, "sensor": "vlp16"},
    "institution, VLP-16": {"building": "institution", "speed_mps": 0.9, "sensor": "vlp16"},
    "dwelling, OS0-128": {"building": "dwelling", "sensor": "os0-128", "lidars": "one"},
    "workplace, busy": {"building": "workplace", "speed_mps": 0.8, "clutter": 0.8, "walking_people": 4},
    "institution, empty": {"building": "institution", "speed_mps": 0.9, "clutter": 0.15},
}
"""Kinds of buildings that are drawn from ranges: no rule was made for them, and no threshold may be set on them."""
DRAWN_SEEDS = (7401,)
SUITES = ("named", "drawn")
"""The first is that of `CASES`."""
LONG_CASES: dict[str, Simulation] = {"office, 150 s": {"building": "office"}, "ell, 150 s": {"building": "ell"}}


@dataclass(frozen=True)
class Figure:
    """A figure of `metrics.json` in a table. path: its keys."""

    heading: str
    path: tuple[str, ...]

    @property
    def less_is_better(self) -> bool:
        """Whether the largest is the worst."""
        return less_is_better(self.path[-1]) or self.path[-1] in ("blocked", "split", "merged")

    def of(self, metrics: Metrics) -> float | None:
        """Fractions as percent, metres as centimetres, lists as their length; None where the run has none."""
        value: Any = metrics
        for key in self.path:
            value = value.get(key) if isinstance(value, Mapping) else None
        if isinstance(value, list):
            return float(len(value))
        return None if value is None else 100.0 * float(value)


def _figures(section: str, **names: str) -> list[Figure]:
    """section: keys joined by dots. names: of its figures by their headings, in which _ is a space."""
    return [Figure(heading.replace("_", " "), (*section.split("."), name)) for heading, name in names.items()]


def _label_figures(*labels: str) -> list[Figure]:
    return [
        Figure(heading, ("area", label, name))
        for label in labels
        for heading, name in ((f"{label} P", "precision"), ("R", "recall"), ("F1", "f1"))
    ]


TABLES = {
    "Labels by area, percent (Table II)": _label_figures("wall", "ceiling", "floor"),
    "Labels by area, percent": [
        *_label_figures("door", "clutter"),
        *_figures("area", outside_kept="outside_kept_as_structure"),
    ],
    "Doors, trajectory, percent and centimetres": [
        *_figures("doors", found="found", invented="invented", width_cm="width_error_m", state="state_right"),
        *_figures("trajectory", ATE_cm="ate_rmse_m"),
    ],
    "Wall cells of the furniture-free grid, and of slices below the ceiling (c) and in the middle (m), percent": [
        *_figures("maps.furniture_free", P="precision", no_cabinets="precision_without_cabinets", R="recall"),
        *_figures("maps.furniture_free", off_cm="error_m", blocked="blocked"),
        *_figures("maps.below_ceiling", c_P="precision", c_R="recall", c_blocked="blocked"),
        *_figures("maps.middle", m_P="precision", m_R="recall", m_blocked="blocked"),
    ],
    "Rooms: percent, and how many were split or merged": [
        *_figures("rooms", recall="recall", precision="precision", recall_of_all="recall_of_all"),
        *_figures("rooms", split="split", merged="merged"),
    ],
}


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
    name: str = SUITES[0],
) -> int:
    """Drive through every building with every seed, print the tables, write `out`; returns how many drives failed.

    name: of `SUITES`; raises InputError where there is no other. In the drawn one every case has a seed of its own, counted on
    from each of `seeds`, so that no two share a building. quick: one seed, short drives, no long ones. at_once: drives under
    way at a time, each one core's work; None for one a core.
    """
    settings = load_settings(None, overrides)
    if name not in SUITES:
        raise InputError(f"--suite: no suite {name!r}; they are {' and '.join(SUITES)}")
    drawn = name == "drawn"
    seeds, duration_s = (seeds[:1], QUICK_S) if quick else (seeds, DRAWN_S if drawn else DURATION_S)
    jobs = [
        (case, {**own, "seed": seed + drawn * number, "duration_s": duration_s})
        for number, (case, own) in enumerate((DRAWN_CASES if drawn else CASES).items())
        for seed in seeds
    ]
    if not quick and not drawn:
        jobs += [(case, {**own, "seed": seeds[0], "duration_s": LONG_S}) for case, own in LONG_CASES.items()]
    at_once = min(at_once or os.cpu_count() or 1, len(jobs))
    drives: list[Drive] = []
    started = time.monotonic()
    # Of drives that take minutes each, what came of those before an interruption stays there.
    part = out.with_name(f"{out.name}.part")
    _check_replaceable(out)
    _check_space(out.parent, at_once)
    hashed = settings.short_hash()
    with Progress(quiet) as progress, ThreadPoolExecutor(at_once) as pool:
        progress.stage("suite", len(jobs))
        try:
            for drive in pool.map(lambda job: _drive(job[0], job[1], overrides, hashed, out.parent), jobs):
                if drive.metrics is None:
                    progress.warn(f"{drive.case}, seed {drive.seed}: {drive.error}")
                drives.append(drive)
                _write(part, drives, overrides, hashed)
                progress.advance()
            part.replace(out)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    console = table_console()
    for table in [*format_suite(drives), *format_weaknesses(drives)]:
        console.print(table)
    failed = sum(drive.metrics is None for drive in drives)
    console.print(
        f"{len(drives) - failed} of {len(drives)} drives, {sum(drive.cached for drive in drives)} from the cache, "
        f"in {(time.monotonic() - started) / 60:.1f} minutes: {out}"
    )
    return failed


def parse_seeds(text: str | None, name: str = SUITES[0]) -> tuple[int, ...]:
    """Seeds from a list like 1,2, else those of a suite; raises InputError where it is none."""
    if text is None:
        return DRAWN_SEEDS if name == "drawn" else REPORTED_SEEDS
    try:
        seeds = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--seeds {text}: write whole numbers, as in --seeds 1001,1002") from None
    if any(seed < 0 for seed in seeds):
        raise InputError(f"--seeds {text}: a seed is not negative")
    return seeds


def _drive(case: str, simulation: Simulation, overrides: Sequence[str], settings_hash: str, folder: Path) -> Drive:
    """Simulate, run, evaluate and delete one drive, or take its figures from the cache."""
    key = json.dumps({"simulation": simulation, "settings": settings_hash, "code": code_digest()}, sort_keys=True)
    cached = cache_folder().parent / "suite" / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.json"
    with suppress(OSError, ValueError):
        return Drive(case, simulation["seed"], json.loads(cached.read_text()), cached=True)
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
                return Drive(
                    case, simulation["seed"], None, (done.stderr.strip().splitlines() or ["no reason given"])[-1]
                )
        metrics: Metrics = json.loads((run / METRICS).read_text())
        record = json.loads((run / RUN_JSON).read_text())
        metrics["run"] = {name: record[name] for name in ("timings_s", "counts")}
    cached.parent.mkdir(parents=True, exist_ok=True)
    write_json(cached, metrics)
    return Drive(case, simulation["seed"], metrics, seconds=time.monotonic() - started)


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
            "drives": [{name: value for name, value in vars(drive).items() if name != "cached"} for drive in drives],
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
    return [_table(title, figures, drives) for title, figures in TABLES.items()]


def format_weaknesses(drives: Sequence[Drive]) -> list[Table]:
    """Doors by their design, and parts of buildings, added up over all drives; none where no truth tells of them."""
    metrics = [drive.metrics for drive in drives if drive.metrics is not None]
    doors: dict[str, Counter[str]] = defaultdict(Counter)
    parts: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    for own in metrics:
        for design, counts in own.get("doors", {}).get("by_design", {}).items():
            doors[design].update(counts)
        for name, element in own.get("elements", {}).items():
            parts[name, element["truth"]].update(element["labels"])
    tables = []
    if doors:
        rows = [[name, *(str(n[key]) for key in ("passed", "found", "state_right"))] for name, n in sorted(doors.items())]
        tables.append(make_table("Doors by design", ("door", "passed", "found", "state right"), rows, no_wrap=True))
    if parts:
        labels = ("wall", "ceiling", "floor", "door", "clutter", "outside")
        rows = []
        for (name, truth), n in sorted(parts.items()):
            total = sum(n.values())
            rows.append([name, str(total), *(f"{100 * n[key] / total:.1f}" for key in (truth, *labels))])
        headings = ("element", "cubes", "right", *(f"as {label}" for label in labels))
        tables.append(make_table("Parts of buildings: percent of their 5 cm cubes", headings, rows, no_wrap=True))
    return tables


def _table(title: str, figures: Sequence[Figure], drives: Sequence[Drive]) -> Table:
    rows, means = [], [[] for _ in figures]  # type: tuple[list[list[str]], list[list[float]]]
    for case in dict.fromkeys(drive.case for drive in drives):
        own = [drive.metrics for drive in drives if drive.case == case and drive.metrics is not None]
        columns = [[v for metrics in own if (v := figure.of(metrics)) is not None] for figure in figures]
        rows.append([case, *map(_cell, columns)])
        for mean, values in zip(means, columns, strict=True):
            mean.extend([statistics.fmean(values)] if values else [])
    headings = ("building", *(figure.heading for figure in figures))
    table = make_table(title, headings, rows, no_wrap=True, padding=(0, 1, 0, 0))
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
