"""Recordings of a few synthetic scans, and what they hold."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.scans import log_scan
from ffmap.app.record.stream import Recording, send_properties
from ffmap.app.record.whole_run import explain, log_static
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import run as run_blueprint
from ffmap.blueprints.entities import SCAN_TIMELINE
from tests import synthetic

SCANS = 4
Labelled = tuple[Scan, LevelledScan, ScanLabelling]


def write_block(
    path: Path, labelled: list[Labelled], first: int, count: int, detail: Detail = Detail.LINES
) -> None:
    with open_log(path, "run-1", detail) as log:
        for index in range(first, first + count):
            log_scan(log, index, *labelled[index][1:], synthetic.stamp_ns(index))


def write_run(folder: Path, labelled: list[Labelled], detail: Detail = Detail.LINES) -> Path:
    """Two blocks, and what holds for the whole recording."""
    recording = start(folder, "run-1")
    log = Log(recording.stream, detail)
    log_static(log, {"vertical": synthetic.T_BASE_SENSOR}, explain({}), 1.0)
    log.send_rows()
    send_properties(log.stream, "settings", {"wall_planes": {"similarity_m": 0.05}, "name": None})
    for first in (0, 2):
        block = folder / f"{first:04d}.rrd"
        write_block(block, labelled, first, 2, detail)
        recording.add(block)
    recording.finish()
    return folder / "recording.rrd"


def start(folder: Path, recording_id: str, *viewer: Any) -> Recording:
    """viewer: its URL, and who prints that it has ended; none if omitted."""
    (folder / "spool").mkdir(exist_ok=True)
    path, layout = folder / "recording.rrd", run_blueprint.build()
    return Recording(path, folder / "spool", recording_id, layout, *viewer)


def rows(path: Path, entity: str, index: str = SCAN_TIMELINE) -> Iterator[dict[str, Any]]:
    """The rows of one entity on a timeline, components by their short names."""
    chunks = RrdReader(path).stream().filter(content=entity).collect()
    table = chunks.reader(index=index).to_pandas()
    for row in table.to_dict("records"):
        yield {str(key).split(":")[-1]: value for key, value in row.items()}


def static(path: Path) -> dict[str, dict[str, Any]]:
    """What holds for the whole recording, by entity, components by their short names."""
    found: dict[str, dict[str, Any]] = {}
    for chunk in RrdReader(path).stream():
        if chunk.is_static:
            columns = chunk.to_record_batch().to_pydict().items()
            own = found.setdefault(chunk.entity_path, {})
            own |= {str(name).split(":")[-1]: value for name, value in columns}
    return found


def temporal_paths(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream() if not chunk.is_static}


def vectors(values: Any) -> np.ndarray:
    return np.stack([np.asarray(value) for value in values])
