"""What four drives come to, to the bit: written down once, and compared after each change that should change nothing.

    python tests/benchmarks/freeze.py frozen.json      writes the digests where there are none, compares where there are

Digests depend on the machine's numerical libraries, so the file is made anew on each machine, of the code before a change.
Bags are kept in the folder of --bags and used again; exit code 1 says that something differs.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

DRIVES = {
    "office": {"building": "office"},
    "hall, ramp": {"building": "lab", "ramp_rise_m": 0.3, "walking_people": 4},
    "slope, sills": {
        "building": "angled",
        "floor_slope_deg": 1.0,
        "door_sills_m": 0.02,
        "step_m": 0.15,
        "clutter": 0.8,
    },
    "16 rings": {"building": "ell", "ceiling_m": 4.0, "wall_thickness_m": 0.35, "sensor": "os1-16"},
}
FILES = (
    "trajectory.tum",
    "walls.geojson",
    "doors.geojson",
    "rooms.geojson",
    "map.pgm",
    "map.yaml",
    "map_below_ceiling.pgm",
    "map_middle.pgm",
    "cloud.ply",
    "floorplan.svg",
)
FIGURES = (
    ("area", "wall", "f1"),
    ("area", "door", "f1"),
    ("area", "clutter", "f1"),
    ("doors", "found"),
    ("maps", "furniture_free", "recall"),
)
FFMAP = str(Path(sys.executable).with_name("ffmap"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="where the digests stand, or are to be written")
    parser.add_argument("--bags", type=Path, default=Path("runs/freeze"), help="folder that keeps the bags")
    parser.add_argument("--duration", type=float, default=25.0, help="seconds of driving")
    parser.add_argument("--workers", type=int, default=2, help="labelling processes")
    parser.add_argument("--drives", nargs="*", choices=DRIVES, default=list(DRIVES))
    options = parser.parse_args()
    options.bags.mkdir(parents=True, exist_ok=True)
    now = {name: digests(bag(options.bags, name, options.duration), options.workers) for name in options.drives}
    if not options.file.exists():
        options.file.write_text(json.dumps(now, indent=1))
        print(f"{options.file}: written")
        return 0
    before = json.loads(options.file.read_text())
    differing = [
        f"{drive}: {name} {before.get(drive, {}).get(name)} → {value}"
        for drive, values in now.items()
        for name, value in values.items()
        if before.get(drive, {}).get(name) != value
    ]
    print("\n".join(differing) or f"{len(now)} drives, {len(FILES) + 1} digests each: all equal")
    return 1 if differing else 0


def bag(folder: Path, name: str, duration_s: float) -> Path:
    """The drive's bag, simulated where the folder has none."""
    path = folder / f"{name.replace(', ', '_').replace(' ', '_')}_{duration_s:g}s.bag"
    if not path.exists():
        values = {**DRIVES[name], "seed": 1, "duration_s": duration_s}
        options = [argument for key, value in values.items() for argument in ("--set", f"{key}={json.dumps(value)}")]
        subprocess.run([FFMAP, "simulate", str(path), "--quiet", *options], check=True)
    return path


def digests(bag: Path, workers: int) -> dict[str, object]:
    """SHA-256 (its first 16 digits) of what a run of this bag wrote, its digest of labels, and figures to look at."""
    with tempfile.TemporaryDirectory(prefix="freeze-") as folder:
        run = Path(folder) / "run"
        command = [FFMAP, "run", str(bag), "--out", str(run), "--no-save", "--quiet", f"--workers={workers}"]
        # A cache of its own: an odometry from before the change would hide what the change does to poses.
        subprocess.run(command, check=True, env={**os.environ, "FFMAP_CACHE": f"{folder}/cache"})
        found = {"labels_digest": json.loads((run / "run.json").read_text())["labels_digest"][:16]}
        found |= {name: hashlib.sha256((run / name).read_bytes()).hexdigest()[:16] for name in FILES}
        metrics = json.loads((run / "metrics.json").read_text())
    figures = {}
    for path in FIGURES:
        value = metrics
        for key in path:
            value = value[key]
        figures[".".join(path)] = value
    return {**found, **figures}


if __name__ == "__main__":
    sys.exit(main())
