"""Query the recording of a run: the wall planes of every scan as a table.

    python docs/examples/query_a_recording.py runs/a/recording.rrd

docs/recording.md lists every entity and component.
"""

import sys

import numpy as np
from rerun.chunk import RrdReader

counts: dict[int, list[int]] = {}  # of point lines in each plane, by scan
for chunk in RrdReader(sys.argv[1]).stream().filter(content=["/scan/planes"]):
    batch = chunk.to_record_batch()
    if {"scan", "line_count"} <= set(batch.schema.names):
        columns = (batch[name].to_pylist() for name in ("scan", "line_count"))
        counts |= {scan: lines for scan, lines in zip(*columns, strict=True) if lines}

every = np.concatenate(list(counts.values()))
print(f"{len(every):,} wall planes in {len(counts):,} scans")
print(f"point lines of a plane: median {np.median(every):.0f}, most {every.max()}")
most = max(counts, key=lambda scan: len(counts[scan]))
print(f"scan {most} has most planes: {len(counts[most])}")
