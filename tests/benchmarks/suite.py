"""Simulate, run and evaluate drives through buildings of many kinds; print tables of figures.

    python tests/benchmarks/suite.py runs/named.json --write
    python tests/benchmarks/suite.py runs/drawn.json --suite drawn --write
    python tests/benchmarks/suite.py runs/quick.json --duration 40 --cases office "hall, ramp"

Every drive is simulated, run as a user runs it, evaluated, and deleted. Its figures are kept in the
JSON file; drives in the file are not made again. --write replaces the tables in docs/measured.md.
No threshold is set on the reported seeds, only on lower ones.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from ffmap.app.analysis.figures import FIGURES, MAPS

FFMAP = str(Path(sys.executable).with_name("ffmap"))
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
"""Buildings drawn from wide ranges, 45 s each; no threshold may be set on them."""
SUITES = {"named": (NAMED | LONG, 60.0, 1001), "drawn": (DRAWN, 45.0, 7401)}
"""Cases, seconds of driving, and the seed."""
DRIVES = {
    "wall P / R / F1": "{wall.precision} / {wall.recall} / {wall.f1}",
    "ceiling F1": "{ceiling.f1}",
    "floor F1": "{floor.f1}",
    "closed leaf F1": "{door.f1}",
    "clutter F1": "{clutter.f1}",
    "outside kept": "{outside_kept}",
    "doors found": "{doors.found_count} of {doors.passed}",
    "invented": "{doors.invented_count} of {doors.detections}",
    "map P / R": "{maps.furniture_free.precision} / {maps.furniture_free.recall}",
    "rooms R / P": "{rooms.furniture_free.recall} / {rooms.furniture_free.precision}",
    "ATE": "{trajectory.ate_rmse_m} cm",
}
"""Columns of the table of drives: headings, and cells with the names of figures."""
OF_MAP = {
    "precision": "{maps.MAP.precision}",
    "without cabinets": "{maps.MAP.precision_without_cabinets}",
    "recall": "{maps.MAP.recall}",
    "error": "{maps.MAP.error_m} cm",
    "doors blocked": "{maps.MAP.doors_blocked} of {maps.MAP.doors_passed}",
}
PAPER = (
    "| *paper, its building* | 99.6 / 95.3 / 97.4 | 92.0 | 94.4 | 81.8 | – | by hand | 94.7 % |"
    " – | – | – | – |"
)
DOCUMENT = Path(__file__).parents[2] / "docs" / "measured.md"

Drive = Mapping[str, Any]
Metrics = Mapping[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="JSON file of all figures")
    parser.add_argument("--suite", choices=SUITES, default="named")
    parser.add_argument("--seeds", type=int, nargs="*", help="[default: 1001; drawn: 7401]")
    parser.add_argument("--cases", nargs="*", help="some of the cases by their names")
    parser.add_argument("--duration", type=float, help="seconds of driving, of all cases")
    parser.add_argument("--set", action="append", default=[], help="a setting of the runs")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="drives at once")
    parser.add_argument("--write", action="store_true", help="write tables into docs/measured.md")
    asked = parser.parse_args()
    jobs = [
        job
        for job in drives_of(asked.suite, asked.seeds, asked.duration)
        if not asked.cases or job["case"] in asked.cases
    ]
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    done = json.loads(asked.out.read_text()) if asked.out.exists() else []
    known = [row["simulation"] for row in done]
    waiting = [job for job in jobs if job["simulation"] not in known]
    with ThreadPoolExecutor(asked.workers) as pool:
        for row in pool.map(lambda job: drive(job, asked.set, asked.out.parent), waiting):
            print(row["case"], row["simulation"]["seed"], row.get("error", "done"), flush=True)
            done.append(row)
            asked.out.write_text(json.dumps(done, indent=1))
    written = tables(asked.suite, done)
    print("\n\n".join("\n".join(lines) for lines in written.values()))
    if asked.write:
        DOCUMENT.write_text(with_tables(DOCUMENT.read_text("utf-8"), written), "utf-8")
    return 1 if any("error" in row for row in done) else 0


def drives_of(suite: str, seeds: Sequence[int] | None, duration_s: float | None) -> list[Drive]:
    """The drives of a suite. In the drawn one no two drives share a seed, and so a building."""
    cases, usual_s, seed = SUITES[suite]
    rows = []
    for number, (case, own) in enumerate(cases.items()):
        for own_seed in seeds or (seed,):
            simulation = {"duration_s": usual_s, **own, "seed": own_seed}
            if suite == "drawn":
                simulation["seed"] += number
            if duration_s is not None:
                simulation["duration_s"] = duration_s
            rows.append({"case": case, "simulation": simulation})
    return rows


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


def tables(suite: str, drives: Sequence[Drive]) -> dict[str, list[str]]:
    """The suite's Markdown tables by their names in docs/measured.md."""
    by_case: dict[str, list[Metrics]] = defaultdict(list)
    for row in drives:
        if "metrics" in row:
            by_case[row["case"]].append(row["metrics"])
    everything = [metrics for rows in by_case.values() for metrics in rows]
    found = {suite: drive_table(by_case)}
    if suite == "named":
        found["maps"] = markdown_head("map", *OF_MAP)
        for name in MAPS:
            cells = {key: cell.replace("MAP", name) for key, cell in OF_MAP.items()}
            found["maps"].append(filled(name.replace("_", " "), cells, everything))
    else:
        found["parts"] = part_table(everything)
        found["doors"] = door_table(everything)
    return found


def drive_table(by_case: Mapping[str, Sequence[Metrics]]) -> list[str]:
    """A row for each case, their mean, and then the long drives."""
    lines = {case: filled(case, DRIVES, rows) for case, rows in by_case.items()}
    long = [lines.pop(case) for case in LONG if case in lines]
    usual = [metrics for case in lines for metrics in by_case[case]]
    lines["mean"] = filled("**mean, or sum**", DRIVES, usual)
    return [*markdown_head("building", *DRIVES), *lines.values(), *([PAPER, *long] if long else [])]


def part_table(rows: Iterable[Metrics]) -> list[str]:
    """Parts of buildings by the share of their voxels with each label, the worst first."""
    counted: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    for metrics in rows:
        for name, element in metrics.get("elements", {}).items():
            counted[name, element["truth"]].update(element["labels"])
    labels = ("wall", "ceiling", "floor", "door", "clutter", "outside")
    lines = markdown_head("part", "voxels", "right", *labels)
    worst_first = sorted(counted.items(), key=lambda part: part[1][part[0][1]] / part[1].total())
    for (name, truth), n in worst_first:
        shares = " | ".join(f"{100 * n[key] / n.total():.1f}" for key in (truth, *labels))
        lines.append(f"| {name} | {n.total()} | {shares} |")
    return lines


def door_table(rows: Iterable[Metrics]) -> list[str]:
    """Doors by their design."""
    counted: dict[str, Counter[str]] = defaultdict(Counter)
    for metrics in rows:
        for design, counts in metrics.get("doors.by_design", {}).items():
            counted[design].update(counts)
    keys = ("passed", "found", "state_right")
    cells = {design: " | ".join(str(n[key]) for key in keys) for design, n in counted.items()}
    lines = [f"| {design} | {row} |" for design, row in sorted(cells.items())]
    return [*markdown_head("door leaf", "passed", "found", "state right"), *lines]


def filled(heading: str, cells: Mapping[str, str], rows: Sequence[Metrics]) -> str:
    """A row of a table: sums of counts, means of shares in percent and of lengths in cm."""

    def value(name: re.Match[str]) -> str:
        known = [row[name[1]] for row in rows if row.get(name[1]) is not None]
        if not known:
            return "–"
        if not FIGURES[name[1]].unit:
            return f"{sum(known):.0f}"
        return f"{100 * statistics.fmean(known):.1f}"

    values = (re.sub(r"\{(.+?)\}", value, cell) for cell in cells.values())
    return f"| {heading} | {' | '.join(values)} |"


def markdown_head(*names: str) -> list[str]:
    return [f"| {' | '.join(names)} |", "|" + "---|" * len(names)]


def with_tables(text: str, tables: Mapping[str, Sequence[str]]) -> str:
    """Replace what is between `<!-- table NAME -->` and the next `<!-- end -->` in a document."""
    for name, lines in tables.items():
        place = re.compile(rf"(?<=<!-- table {name} -->\n).*?(?=<!-- end -->)", re.DOTALL)
        assert place.search(text), f"{DOCUMENT}: no place for the table {name}"
        text = place.sub(lambda _, table=lines: "\n".join([*table, ""]), text, count=1)
    return text


if __name__ == "__main__":
    sys.exit(main())
