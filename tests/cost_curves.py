"""What runs cost against the minutes of a drive, the number of bags and the number of settings, on one and two workers.

    python tests/cost_curves.py costs.json docs/costs.svg     measures what the JSON lacks, then draws all of it

A quarter of an hour on two cores; nothing else should run meanwhile. The bags are kept in the folder of --bags.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

FFMAP = str(Path(sys.executable).with_name("ffmap"))
WORKERS = (1, 2)
MINUTES = (0.5, 1.0, 2.0)
COUNTS = (1, 2, 4, 8)
DRIVEN_MIN = 0.5
"""Length of the drives of many bags and of many settings."""
COLOURS = {1: "#d1603d", 2: "#22577a"}
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 300, 250, 48, 12, 30, 44


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("measured", type=Path, help="JSON of what was measured; added to")
    parser.add_argument("picture", type=Path, help="SVG that is drawn")
    parser.add_argument("--bags", type=Path, default=Path("runs/costs"), help="folder that keeps the bags")
    options = parser.parse_args()
    options.bags.mkdir(parents=True, exist_ok=True)
    costs: dict[str, float] = json.loads(options.measured.read_text()) if options.measured.exists() else {}
    for name, measure in measurements(options.bags):
        if name not in costs:
            costs[name] = round(measure(), 1)
            options.measured.write_text(json.dumps(costs, indent=1))
    options.picture.write_text(drawn(costs))
    return 0


def measurements(bags: Path) -> Iterator[tuple[str, Callable[[], float]]]:
    """What is measured, by its name "curve/x/workers": seconds of the whole command, by the clock on the wall."""
    for workers in WORKERS:
        for minutes in MINUTES:
            yield f"minutes/{minutes:g}/{workers}", partial(run_s, bags, minutes, workers)
        for count in COUNTS:
            yield f"bags/{count}/{workers}", partial(sweep_s, bags, workers, count, 1, cached=False)
        for count in COUNTS:
            yield f"settings/{count}/{workers}", partial(sweep_s, bags, workers, 1, count, cached=True)


def run_s(bags: Path, minutes: float, workers: int) -> float:
    return seconds(["run", bag(bags, minutes, 0), f"--workers={workers}"], cached=False)


def sweep_s(bags: Path, workers: int, drives: int, settings: int, cached: bool) -> float:
    values = ",".join(f"{0.03 + 0.005 * k:g}" for k in range(settings))
    grid = ["--grid", f"wall_planes.similarity_m={values}", f"--workers={workers}"]
    return seconds(["sweep", *(bag(bags, DRIVEN_MIN, k) for k in range(drives)), *grid], cached=cached)


def bag(folder: Path, minutes: float, number: int) -> str:
    """A drive through the office, simulated where the folder has none."""
    path = folder / f"{minutes:g}min_{number}.bag"
    if not path.exists():
        made = [f"--duration={60 * minutes:g}", "--building=office", f"--seed={1 + number}", "--quiet"]
        subprocess.run([FFMAP, "simulate", str(path), *made], check=True)
    return str(path)


def seconds(command: list[str], cached: bool) -> float:
    """How long the program takes. cached: whether it finds the odometry of an earlier run, which is not counted."""
    with tempfile.TemporaryDirectory(prefix="costs-") as folder:
        environment = {**os.environ, "FFMAP_CACHE": f"{folder}/cache"}
        if cached:
            once = [FFMAP, "run", command[1], "--out", f"{folder}/once", "--outputs=maps", "--quiet"]
            subprocess.run(once, check=True, env=environment)
        start = time.perf_counter()
        subprocess.run(
            [FFMAP, *command, "--out", f"{folder}/out", "--no-evaluate", "--quiet"],
            check=True,
            env=environment,
            stdout=subprocess.DEVNULL,
        )
        return time.perf_counter() - start


def drawn(costs: dict[str, float]) -> str:
    """Three small diagrams side by side, a line for each number of workers; all axes start at zero."""
    curves = {
        "minutes": ("a run, everything written", "minutes of driving"),
        "bags": (f"a sweep over bags of {60 * DRIVEN_MIN:g} s", "bags"),
        "settings": ("a sweep over settings, poses cached", "settings"),
    }
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {len(curves) * WIDTH} {HEIGHT}" font-family="sans-serif" '
        f'font-size="11" fill="#333"><rect width="100%" height="100%" fill="white"/>'
    ]
    for place, (curve, (title, across)) in enumerate(curves.items()):
        parts.append(f'<g transform="translate({place * WIDTH} 0)">{diagram(costs, curve, title, across)}</g>')
    return "\n".join([*parts, "</svg>\n"])


def diagram(costs: dict[str, float], curve: str, title: str, across: str) -> str:
    """One curve of `measurements`, a line for each number of workers."""
    points: dict[int, list[tuple[float, float]]] = {workers: [] for workers in WORKERS}
    for name, taken_s in costs.items():
        measured, x, workers = name.split("/")
        if measured == curve:
            points[int(workers)].append((float(x), taken_s))
    x_max = max(x for line in points.values() for x, _ in line)
    y_max = max(s for line in points.values() for _, s in line) * 1.1
    across_px, up_px = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    axes = f"M{LEFT} {TOP}V{HEIGHT - BOTTOM}H{WIDTH - RIGHT}"
    parts = [f'<text x="{LEFT}" y="18" font-weight="bold">{title}</text><path d="{axes}" fill="none" stroke="#999"/>']
    parts.append(f'<text x="{LEFT + across_px / 2}" y="{HEIGHT - 8}" text-anchor="middle">{across}</text>')
    for x in sorted({x for line in points.values() for x, _ in line}):
        at = LEFT + across_px * x / x_max
        parts.append(f'<text x="{at:.0f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{x:g}</text>')
    for share in (0.5, 1.0):
        up = HEIGHT - BOTTOM - up_px * share / 1.1
        parts.append(f'<path d="M{LEFT} {up:.0f}h{across_px}" stroke="#eee"/>')
        parts.append(f'<text x="{LEFT - 5}" y="{up + 4:.0f}" text-anchor="end">{y_max / 1.1 * share:.0f} s</text>')
    for number, (count, line) in enumerate(points.items()):
        places = [(LEFT + across_px * x / x_max, HEIGHT - BOTTOM - up_px * s / y_max) for x, s in line]
        path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in places)
        dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3"/>' for x, y in places)
        parts.append(f'<path d="{path}" fill="none" stroke="{COLOURS[count]}" stroke-width="2"/>')
        parts.append(f'<g fill="{COLOURS[count]}">{dots}')
        told = f"{count} worker{'s' * (count > 1)}"
        parts.append(f'<text x="{LEFT + 10}" y="{TOP + 14 + 15 * number}">{told}</text></g>')
    return "".join(parts)


if __name__ == "__main__":
    sys.exit(main())
