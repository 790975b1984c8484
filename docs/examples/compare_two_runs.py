"""Compare the labels of two runs of one bag, scan by scan.

    python docs/examples/compare_two_runs.py runs/a runs/b

'ffmap compare runs/a runs/b' shows more, in the map too.
"""

import sys

import numpy as np

import ffmap

a, b = (ffmap.open_run(folder) for folder in sys.argv[1:])
for name in ("wall.f1", "floor.f1", "ceiling.f1", "doors.found_count"):
    if name in a.figures and name in b.figures:
        print(f"{name}: {a.figures[name]:.4f} -> {b.figures[name]:.4f}")

changed = {}
for scan in range(a.finished.record.counts["clouds"]):
    try:
        one, other = a.labels(scan).label, b.labels(scan).label
    except KeyError:
        continue  # skipped in one of the runs
    changed[scan] = np.count_nonzero(one != other)

print(f"{sum(changed.values()):,} labels differ in {len(changed)} scans")
for scan in sorted(changed, key=changed.get, reverse=True)[:3]:
    one, other = a.labels(scan).label, b.labels(scan).label
    pairs, counts = np.unique(np.stack([one, other])[:, one != other], axis=1, return_counts=True)
    told = ", ".join(
        f"{count} {ffmap.Label(before).name.lower()} -> {ffmap.Label(after).name.lower()}"
        for (before, after), count in zip(pairs.T, counts, strict=True)
    )
    print(f"scan {scan}: {told or 'none'}")
