"""Simulate, run and evaluate drives through buildings of many kinds; print tables of figures.

    python tests/benchmarks/suite.py runs/suite.json
    python tests/benchmarks/suite.py runs/drawn.json --suite drawn
    python tests/benchmarks/suite.py runs/quick.json --quick --cases office "hall, ramp"

Every drive is simulated, run as a user runs it, evaluated, and deleted. Its figures are kept in the
JSON file; drives in the file are not made again. No threshold is set on the reported seeds, only on
lower ones.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

FFMAP = str(Path(sys.executable).with_name("ffmap"))
QUICK_S = 40.0
NAMED = {
    "office": {"building": "office"},
    "crammed office": {"building": "office", "clutter": 1.0, "walking_people": 3},
    "empty, VLP-16": {
        "building": "office",
        "clutter": 0.0,
        "sensor": "vlp16",
        "wall_thickness_m": 0.1,
    },
    "odd angles, glass": {
        "building": "angled",
        "window": ["single", "curtain wall"],
        "glazed_share": 0.4,
        "mount_tilt_deg": 5.0,
        "recess_m": [0.02, 0.08],
    },
    "high, OS1-16": {
        "building": "ell",
        "ceiling_m": 4.0,
        "wall_thickness_m": 0.35,
        "sensor": "os1-16",
    },
    "low, fast, swaying": {
        "building": "ell",
        "ceiling_m": 2.5,
        "door": ["hinged", "double"],
        "speed_mps": 1.0,
        "sway_deg": 1.0,
    },
    "hall, ramp": {"building": "lab", "ramp_rise_m": 0.3, "walking_people": 4},
    "slope, sills, step": {
        "building": "angled",
        "floor_slope_deg": 1.0,
        "door_sills_m": 0.02,
        "step_m": 0.15,
        "clutter": 0.8,
    },
}
LONG = {
    "office, 150 s": {"building": "office", "duration_s": 150.0},
    "ell, 150 s": {"building": "ell", "duration_s": 150.0},
}
DRAWN = {
    "dwelling": {"building": "dwelling"},
    "workplace": {"building": "workplace", "speed_mps": 0.8},
    "institution": {"building": "institution", "speed_mps": 0.9},
    "dwelling, VLP-16": {"building": "dwelling", "sensor": "vlp16"},
    "workplace, OS0-128": {
        "building": "workplace",
        "speed_mps": 0.8,
        "sensor": "os0-128",
        "lidars": "one",
    },
    "institution, busy": {
        "building": "institution",
        "speed_mps": 0.9,
        "walking_people": 5,
        "mount_tilt_deg": 4.0,
    },
    "dwelling, crammed": {"building": "dwelling", "intensity_half_m": 30.0, "clutter": 0.8},
    "workplace, VLP-16": {"building": "workplace", "speed_mps": 0.8, "sensor": "vlp16"},
    "institution, VLP-16": {"building": "institution", "speed_mps": 0.9, "sensor": "vlp16"},
    "dwelling, OS0-128": {"building": "dwelling", "sensor": "os0-128", "lidars": "one"},
    "workplace, busy": {
        "building": "workplace",
        "speed_mps": 0.8,
        "clutter": 0.8,
        "walking_people": 4,
    },
    "institution, empty": {"building": "institution", "speed_mps": 0.9, "clutter": 0.15},
}
"""Buildings that are drawn from wide ranges; no threshold may be set on them."""
COLUMNS = {
    "wall P": "wall.precision",
    "wall R": "wall.recall",
    "wall F1": "wall.f1",
    "ceiling F1": "ceiling.f1",
    "floor F1": "floor.f1",
    "closed leaf F1": "door.f1",
    "clutter F1": "clutter.f1",
    "outside kept": "outside_kept",
    "doors found": "doors.recall",
    "invented": "doors.invented",
    "state right": "doors.state_right",
    "width cm": "doors.width_error_m",
    "map P": "maps.furniture_free.precision",
    "map R": "maps.furniture_free.recall",
    "below ceiling P": "maps.below_ceiling.precision",
    "below ceiling R": "maps.below_ceiling.recall",
    "middle P": "maps.middle.precision",
    "middle R": "maps.middle.recall",
    "rooms R": "rooms.furniture_free.recall",
    "rooms P": "rooms.furniture_free.precision",
    "ATE cm": "trajectory.ate_rmse_m",
}
"""Headings and figures; shares in percent, lengths in centimetres."""

Drive = Mapping[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="JSON file of all figures")
    parser.add_argument("--suite", choices=("named", "drawn"), default="named")
    parser.add_argument("--seeds", type=int, nargs="*", help="[default: 1001 1002; drawn: 7401]")
    parser.add_argument("--cases", nargs="*", help="some of the cases by their names")
    parser.add_argument("--quick", action="store_true", help="one seed, short drives, no long ones")
    parser.add_argument("--set", action="append", default=[], help="a setting of the runs")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="drives at once")
    asked = parser.parse_args()
    jobs = drives_of(asked.suite, asked.seeds, asked.quick, asked.cases)
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    done = json.loads(asked.out.read_text()) if asked.out.exists() else []
    known = [row["simulation"] for row in done]
    waiting = [job for job in jobs if job["simulation"] not in known]
    with ThreadPoolExecutor(asked.workers) as pool:
        for row in pool.map(lambda job: drive(job, asked.set, asked.out.parent), waiting):
            print(row["case"], row["simulation"]["seed"], row.get("error", "done"), flush=True)
            done.append(row)
            asked.out.write_text(json.dumps(done, indent=1))
    print("\n".join([*table(done), "", *doors_by_design(done), "", *elements(done)]))
    return 1 if any("error" in row for row in done) else 0


def drives_of(
    suite: str, seeds: Sequence[int] | None, quick: bool, cases: Sequence[str] | None
) -> list[Drive]:
    """The drives of a suite. In the drawn one no two drives share a seed, and so a building."""
    drawn = suite == "drawn"
    seeds = seeds or ((7401,) if drawn else (1001, 1002))
    duration_s = QUICK_S if quick else 45.0 if drawn else 60.0
    rows = []
    for number, (case, own) in enumerate((DRAWN if drawn else NAMED).items()):
        for seed in seeds[:1] if quick else seeds:
            simulation = {**own, "seed": seed + drawn * number, "duration_s": duration_s}
            rows.append({"case": case, "simulation": simulation})
    if not quick and not drawn:
        for case, own in LONG.items():
            rows.append({"case": case, "simulation": {**own, "seed": seeds[0]}})
    return [row for row in rows if not cases or row["case"] in cases]


def drive(job: Drive, overrides: Sequence[str], folder: Path) -> Drive:
    """Simulate, run and evaluate one drive; its metrics, or what went wrong."""
    with tempfile.TemporaryDirectory(prefix="suite-", dir=folder) as work:
        bag, run = Path(work) / "drive.bag", Path(work) / "run"
        values = [f"{name}={json.dumps(value)}" for name, value in job["simulation"].items()]
        named = [word for value in values for word in ("--set", value)]
        options = [word for value in overrides for word in ("--set", value)]
        for command in (
            ["simulate", str(bag), "--quiet", *named],
            ["run", str(bag), "--out", str(run), "--quiet", "--workers", "1", *options],
        ):
            done = subprocess.run([FFMAP, *command], capture_output=True, text=True, check=False)
            if done.returncode:
                errors = done.stderr.strip().splitlines() or ["no reason given"]
                return {**job, "error": errors[-1]}
        record = json.loads((run / "run.json").read_text())
        metrics = json.loads((run / "metrics.json").read_text())
    return {**job, "metrics": metrics, "seconds": record["timings_s"]["total"]}


def table(drives: Iterable[Drive]) -> list[str]:
    """A Markdown table: the mean over the seeds of each case, and the mean of the cases."""
    by_case: dict[str, list[list[float | None]]] = defaultdict(list)
    for row in drives:
        if "metrics" in row:
            values = (row["metrics"].get(name) for name in COLUMNS.values())
            by_case[row["case"]].append([None if v is None else 100.0 * v for v in values])
    means = {case: list(map(mean, zip(*rows, strict=True))) for case, rows in by_case.items()}
    means["**mean**"] = list(map(mean, zip(*means.values(), strict=True)))
    lines = markdown_head("building", *COLUMNS)
    for case, row in means.items():
        cells = ("–" if value is None else f"{value:.1f}" for value in row)
        lines.append(f"| {case} | {' | '.join(cells)} |")
    return lines


def doors_by_design(drives: Iterable[Drive]) -> list[str]:
    """Doors of all drives by their design."""
    counted: dict[str, Counter[str]] = defaultdict(Counter)
    for row in drives:
        for design, counts in row.get("metrics", {}).get("doors.by_design", {}).items():
            counted[design].update(counts)
    keys = ("passed", "found", "state_right")
    lines = markdown_head("door", *keys)
    for name, n in sorted(counted.items()):
        lines.append(f"| {name} | {' | '.join(str(n[key]) for key in keys)} |")
    return lines


def elements(drives: Iterable[Drive]) -> list[str]:
    """Parts of buildings: the share of their voxels by label."""
    counted: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    for row in drives:
        for name, element in row.get("metrics", {}).get("elements", {}).items():
            counted[name, element["truth"]].update(element["labels"])
    labels = ("wall", "ceiling", "floor", "door", "clutter", "outside")
    lines = markdown_head("element", "cubes", "right", *labels)
    for (name, truth), n in sorted(counted.items()):
        shares = " | ".join(f"{100 * n[key] / n.total():.1f}" for key in (truth, *labels))
        lines.append(f"| {name} | {n.total()} | {shares} |")
    return lines


def mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known else None


def markdown_head(*names: str) -> list[str]:
    return [f"| {' | '.join(names)} |", "|" + "---|" * len(names)]


if __name__ == "__main__":
    sys.exit(main())
