"""Digests of the results of four drives, to compare before and after a change.

    python tests/benchmarks/freeze.py frozen.json

Writes the file if it does not exist, else compares; exit code 1 if something differs. Digests
depend on the machine's numerical libraries. Bags are kept in --bags.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from suite import FFMAP, NAMED

DRIVES = {
    name: NAMED[name] for name in ("office", "hall, ramp", "slope, sills, step", "high, OS1-16")
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
FIGURES = ("wall.f1", "door.f1", "clutter.f1", "doors.recall", "maps.furniture_free.recall")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="JSON file of digests")
    parser.add_argument("--bags", type=Path, default=Path("runs/freeze"), help="folder of bags")
    parser.add_argument("--duration", type=float, default=25.0, help="seconds of driving")
    parser.add_argument("--workers", type=int, default=2, help="labelling processes")
    parser.add_argument("--drives", nargs="*", choices=DRIVES, default=list(DRIVES))
    asked = parser.parse_args()
    asked.bags.mkdir(parents=True, exist_ok=True)
    now = {
        name: digests(bag(asked.bags, name, asked.duration), asked.workers) for name in asked.drives
    }
    if not asked.file.exists():
        asked.file.write_text(json.dumps(now, indent=1))
        print(f"{asked.file}: written")
        return 0
    before = json.loads(asked.file.read_text())
    differing = [
        f"{drive}: {name} {before.get(drive, {}).get(name)} → {value}"
        for drive, values in now.items()
        for name, value in values.items()
        if before.get(drive, {}).get(name) != value
    ]
    print("\n".join(differing) or f"{len(now)} drives: all equal")
    return 1 if differing else 0


def bag(folder: Path, name: str, duration_s: float) -> Path:
    """The drive's bag, simulated if it does not exist."""
    path = folder / f"{name.replace(', ', '_').replace(' ', '_')}_{duration_s:g}s.bag"
    if not path.exists():
        values = {**DRIVES[name], "seed": 1, "duration_s": duration_s}
        options = [f"--set={key}={json.dumps(value)}" for key, value in values.items()]
        subprocess.run([FFMAP, "simulate", str(path), "--quiet", *options], check=True)
    return path


def digests(bag: Path, workers: int) -> dict[str, object]:
    """SHA-256 (16 digits) of the files of a run, its digest of labels, and some figures."""
    with tempfile.TemporaryDirectory(prefix="freeze-") as folder:
        run = Path(folder) / "run"
        options = ["--out", str(run), "--quiet", f"--workers={workers}"]
        # A cache of its own: an odometry from before the change would hide its effect.
        environment = {**os.environ, "FFMAP_CACHE": f"{folder}/cache"}
        subprocess.run([FFMAP, "run", str(bag), *options], check=True, env=environment)
        found = {"labels_digest": json.loads((run / "run.json").read_text())["labels_digest"][:16]}
        for name in FILES:
            found[name] = hashlib.sha256((run / name).read_bytes()).hexdigest()[:16]
        metrics = json.loads((run / "metrics.json").read_text())
    return {**found, **{name: metrics[name] for name in FIGURES}}


if __name__ == "__main__":
    sys.exit(main())
