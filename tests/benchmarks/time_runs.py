"""Time whole runs: seconds by stage and peak memory, of this checkout or of two in turn.

    python tests/benchmarks/time_runs.py drive.bag --runs 5
    python tests/benchmarks/time_runs.py drive.bag --runs 5 --other ../before/.venv/bin/ffmap

Every run has an empty cache of odometries. One run of each program comes first and is not counted:
it compiles. Prints medians; the programs alternate, so that both meet the same load.
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import psutil

STAGES = ("odometry", "scans", "building", "final", "total")
_SAMPLE_S = 0.1


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bag", type=Path)
    parser.add_argument("--runs", type=int, default=3, help="runs of each program that are counted")
    parser.add_argument("--other", type=Path, help="the ffmap command of another checkout")
    parser.add_argument("--options", default="", help="further options of ffmap run")
    asked = parser.parse_args()
    programs = [Path(sys.executable).with_name("ffmap")]
    programs += [asked.other] if asked.other else []
    rows: dict[Path, list[dict[str, float]]] = {program: [] for program in programs}
    for number in range(asked.runs + 1):
        for program in programs:
            row = one_run(program, asked.bag, asked.options.split())
            if number:
                rows[program].append(row)
    for program, measured in rows.items():
        medians = {name: statistics.median(row[name] for row in measured) for name in measured[0]}
        print(program, ", ".join(f"{name} {value:.1f}" for name, value in medians.items()))


def one_run(program: Path, bag: Path, options: list[str]) -> dict[str, float]:
    """Run once; returns seconds by stage, and the peak memory of all processes in MiB."""
    with tempfile.TemporaryDirectory(prefix="time-runs-") as folder:
        out = Path(folder) / "run"
        command = [program, "run", bag, "--out", out, "--no-evaluate", "--quiet", *options]
        environment = {**os.environ, "FFMAP_CACHE": f"{folder}/cache"}
        process = psutil.Popen(list(map(str, command)), env=environment)
        peak = 0
        while process.poll() is None:
            peak = max(peak, memory_of(process))
            time.sleep(_SAMPLE_S)
        if process.returncode:
            raise SystemExit(f"{program}: the run ended with exit code {process.returncode}")
        record = json.loads((out / "run.json").read_text())
    seconds = {name: float(record["timings_s"].get(name, 0.0)) for name in STAGES}
    return {**seconds, "MiB": peak / 2**20}


def memory_of(process: psutil.Popen) -> int:
    """Proportional set size of a process and its children, in bytes."""
    total = 0
    for member in [process, *process.children(recursive=True)]:
        try:
            total += member.memory_full_info().pss
        except psutil.Error:
            continue
    return total


if __name__ == "__main__":
    main()
