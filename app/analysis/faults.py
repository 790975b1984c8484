"""Which returns of a scan its run labelled wrongly, and where that came from: the scan's own labels, or the building's."""

import numpy as np

from ffmap.algorithms.base.labels import Verdict
from ffmap.algorithms.base.scan import BoolArray, Scan, UInt8Array
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.point_lines import PointLines
from ffmap.app.analysis.run_labels import CloudLabels
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.names import EVALUATION
from ffmap.app.record.errors import VERDICT_COLORS
from ffmap.app.record.inspection import ScanFaults
from ffmap.app.record.line_reasons import name_of
from ffmap.app.record.read_back import readable, rows
from ffmap.blueprints import entities
from ffmap.blueprints.entities import Fault


def find_faults(
    run: FinishedRun, number: int, scan: Scan, labelling: ScanLabelling, recorded: CloudLabels | None
) -> ScanFaults | None:
    """What is wrong with a scan's final labels; None where the run's files do not tell.

    recorded: its labels by the run's files.
    """
    final = _final(recorded, scan)
    if final is None:
        return None
    own = final == labelling.label
    wrong = _wrong(run, number)
    if wrong is None or len(wrong) != len(scan):
        return ScanFaults(np.where(own, Fault.NONE, Fault.RELABELLED).astype(np.uint8), by_truth=False)
    fault = np.where(own, Fault.OF_THE_SCAN, Fault.OF_THE_BUILDING)
    return ScanFaults(np.where(wrong, fault, Fault.NONE).astype(np.uint8), by_truth=True)


def _final(recorded: CloudLabels | None, scan: Scan) -> UInt8Array | None:
    """(n,) the final label of each return; None where the run has none."""
    if recorded is None or recorded.label is None:
        return None
    label = recorded.label[scan.cloud_index] if recorded.every_place else recorded.label
    return label if len(label) == len(scan) else None


def _wrong(run: FinishedRun, number: int) -> BoolArray | None:
    """(n,) whether the evaluation found each return's final label wrong; None where the scan was not evaluated."""
    errors = run.file(EVALUATION)
    if errors is None:
        return None
    with readable(errors) as recording:
        for row in rows(recording.path, entities.POINTS, entities.POINT_VERDICT_COLOR):
            if row.scan == number:
                return np.asarray(row.values[entities.POINT_VERDICT_COLOR] != VERDICT_COLORS[Verdict.RIGHT])
    return None


def in_words(faults: ScanFaults | None, lines: PointLines) -> str:
    """What is marked, by which of the two labels, and where most of it is."""
    if faults is None:
        return "Nothing is marked: the run holds no final labels (`label`) of this scan; told is of `label_scan`."
    total = len(faults.fault)
    count = {fault: int(np.count_nonzero(faults.fault == fault)) for fault in Fault}
    if faults.by_truth:
        wrong = count[Fault.OF_THE_SCAN] + count[Fault.OF_THE_BUILDING]
        text = (
            f"**By the truth the final label (`label`) of {wrong:,} of {total:,} returns is wrong.** "
            f"Marked in cyan are {count[Fault.OF_THE_SCAN]:,} that have it from the scan itself (`label_scan`), and why is told "
            f"line by line; in pink {count[Fault.OF_THE_BUILDING]:,} to which the building of all scans gave another one."
        )
    else:
        text = (
            f"The truth is not known. **Marked in cyan are {count[Fault.RELABELLED]:,} of {total:,} returns whose final label "
            "(`label`) is not that of the scan itself (`label_scan`)**, of which is told line by line."
        )
    worst = faults.worst_line(lines)
    if worst is None:
        return text
    return f"{text} Most are in {name_of(worst)}: {int(faults.counts(lines)[worst]):,}."
