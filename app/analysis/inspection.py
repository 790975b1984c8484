"""One scan of a finished run, labelled again with all evidence, and its errors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN, Verdict
from ffmap.algorithms.base.scan import BoolArray, IntArray, Scan, UInt8Array
from ffmap.algorithms.building.final_labels import ODDS_MAX
from ffmap.algorithms.building.panels import KIND_WORDS
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.point_lines import PointLines
from ffmap.algorithms.truth.labels import verdicts
from ffmap.app.analysis.ground_truth import open_classes
from ffmap.app.analysis.run_labels import read_run_labels
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.labels_file import read_labels
from ffmap.app.folder.names import EVALUATION, LABELS
from ffmap.app.record.inspection import TRUE_CLASSES, ScanFaults
from ffmap.app.record.line_reasons import name_of
from ffmap.app.record.read_back import rows
from ffmap.app.record.return_reasons import ALL
from ffmap.app.run.blocks import Block, label_alone, usable
from ffmap.app.run.given_poses import given_poses
from ffmap.app.run.poses import estimate_poses
from ffmap.app.setup.inputs import Inputs
from ffmap.app.setup.versions import git_revision
from ffmap.blueprints import entities
from ffmap.blueprints.entities import Fault
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.fingerprint import fingerprint
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan, read_scans

CHANGE_HEADINGS = ("returns", "wrong", "by the scan → final", "returns from", "median odds")


@dataclass(frozen=True, eq=False)
class InspectedScan:
    """A scan of a run, labelled again with the settings of the run.

    lidar: a sentence on which of several lidars it is from; None if there is one.
    differing: number of returns with another `label_scan` in the run; None if unknown.
    final: (n,) final label of each return; None if unknown.
    truth: (n,) true class of each return; None if unknown.
    faults: of its final labels; None if unknown.
    changes: of its labels by the building as rows under `CHANGE_HEADINGS`, most frequent first.
    why_changed: (n,) half a line on each change, "" without one; None if not recorded.
    """

    level: LevelledScan
    labelling: ScanLabelling
    lidar: str | None
    differing: int | None
    final: UInt8Array | None
    truth: UInt8Array | None
    faults: ScanFaults | None
    changes: list[tuple[str, ...]]
    why_changed: list[str] | None


def label_again(run: FinishedRun, number: int, bag: BagPath | None = None) -> InspectedScan:
    """Label one scan of a run again: same bag, poses, settings and random numbers.

    bag: where the run's bag is now; None for where it was.
    Raises InputError if the bag is missing or another, the scan out of range or skipped.
    """
    settings = run.settings()
    inputs, digest = _find_inputs(run, bag)
    if not 0 <= number < len(inputs.scans):
        last = len(inputs.scans) - 1
        raise InputError(f"--scan {number}: {run.name} has scans 0 to {last}")
    vertical = inputs.verticals[inputs.scans.lidar[number]]
    cloud, lidar = int(inputs.scans.cloud[number]), vertical.lidar
    options = run.record.options
    given = given_poses(options.trajectory, inputs, settings, options.trajectory_frame)
    poses = estimate_poses(inputs, given, settings, lambda: digest)
    block = Block(number, 1, inputs, settings, poses, "", None, run.path)
    with open_bag(inputs.bag_path) as opened:
        _, read = next(read_scans(opened, vertical.index, cloud, 1, lidar.decoding))
    scan = usable(number, read, block)
    if isinstance(scan, SkippedScan):
        raise _skipped(number, scan.reason)
    try:
        alone = label_alone(number, scan, block)
    except Exception as error:
        failed = SkippedScan.failed(number, scan.stamp_ns, error)
        raise _skipped(number, failed.reason) from error
    scan, level, labelling = alone.scan, alone.level, alone.labelling
    final, differing = _recorded_labels(run, number, scan, labelling.label)
    with open_classes(run, inputs.bag_path) as classes_at:
        truth = None
        if classes_at is not None:
            truth = classes_at(lidar.topic, scan.stamp_ns, scan.cloud_size)
    truth = truth[scan.cloud_index] if truth is not None else None
    faults, why_changed = None, None
    changes: list[tuple[str, ...]] = []
    if final is not None:
        changed = final != labelling.label
        wrong = verdicts(truth, final) != Verdict.RIGHT if truth is not None else None
        faults = _find_faults(changed, wrong)
        recorded = _recorded_changes(run, number, int(np.count_nonzero(changed)))
        if recorded is not None:
            changes = _change_rows(recorded, None if wrong is None else wrong[changed])
            why_changed = [""] * len(final)
            names = entities.POINT_REASON, entities.POINT_ODDS, entities.POINT_WALL
            of_changed = (recorded[name].tolist() for name in names)
            for i, reason, own_odds, wall in zip(np.flatnonzero(changed), *of_changed, strict=True):
                panel = f" (wall {wall})" if wall >= 0 else ""
                why_changed[i] = f"{KIND_WORDS[reason]}{panel}, odds {_odds_text(own_odds)}"
    several = len(inputs.verticals) > 1
    which = f"Scan {number} is cloud {cloud} of {lidar.topic}." if several else None
    return InspectedScan(
        level, labelling, which, differing, final, truth, faults, changes, why_changed
    )


def _find_inputs(run: FinishedRun, bag: BagPath | None) -> tuple[Inputs, str]:
    """Find the inputs of a run, and the fingerprint of its bag."""
    path = bag or run.bag_path
    missing = run.path if path is None else path.missing
    if path is None or missing is not None:
        raise InputError(f"{missing}: no such bag. Pass the bag of the run with --bag")
    inputs = run.find_inputs(path)
    digest = fingerprint(inputs.bag_path)
    if run.record.bag.digest not in (None, digest):
        raise InputError(
            f"{path}: is not the bag of {run.path}. Pass the bag of the run with --bag"
        )
    if not inputs.verticals:
        raise InputError(f"{run.path}: its bag has no vertical lidar, so no scan was labelled")
    return inputs, digest


def _skipped(number: int, reason: str) -> InputError:
    return InputError(f"--scan {number}: was skipped ({reason}); give another scan")


def _recorded_labels(
    run: FinishedRun, number: int, scan: Scan, label: UInt8Array
) -> tuple[UInt8Array | None, int | None]:
    """Return the final label (n,) of each return, and how many had another label by the scan.

    label: (n,) by the scan, now. Both are None if the run has no labels of this scan.
    """
    path = run.file(LABELS)
    recorded = read_labels(path, number, 1).get(number) if path is not None else None
    if recorded is None:
        return None, None
    final, label_scan = recorded.label, recorded.label_scan
    own = full_labels(scan.cloud_size, scan.cloud_index, label)
    if len(own) != len(label_scan):
        return None, max(len(own), len(label_scan))
    return final[scan.cloud_index], int(np.count_nonzero(own != label_scan))


def find_worst(run: FinishedRun, bag: BagPath | None = None) -> tuple[int, str]:
    """Return the scan with most errors, or without ground truth most changed labels, and why.

    bag: where the run's bag is now; None for where it was.
    Raises InputError if the run has neither.
    """
    why = "of its points have a wrong final label (`label`), by ground truth"
    percent = _recorded_errors(run)
    if not percent:
        percent, by_truth = _count_errors(run, bag or run.bag_path)
        if not by_truth:
            why = "of its final labels (`label`) are not those of the scan alone (`label_scan`)"
    if not percent:
        raise InputError(f"{run.path}: has no labels of single scans. Name a scan, as in --scan 17")
    worst = max(percent, key=lambda scan: (percent[scan], -scan))
    return worst, f"{percent[worst]:.1f} % {why}"


def _recorded_errors(run: FinishedRun) -> dict[int, float]:
    """Read the percentage of wrong labels of each scan; empty if it was not recorded."""
    percent: dict[int, float] = {}
    errors = run.file(EVALUATION)
    if errors is not None:
        for row in rows(errors, "/metrics/errors/**", "scalars"):
            percent[row.scan] = percent.get(row.scan, 0.0) + float(row.values["scalars"][0])
    return percent


def _count_errors(run: FinishedRun, bag: BagPath | None) -> tuple[dict[int, float], bool]:
    """Count the percentage of wrong labels of each scan, or else of changed ones; whether wrong."""
    wrong: dict[int, float] = {}
    changed: dict[int, float] = {}
    with open_classes(run, bag) as classes_at:
        for cloud, _ in read_run_labels(run):
            own = cloud.label_scan != NO_RETURN
            if not own.any():
                continue
            changed[cloud.scan] = 100 * float(np.mean((cloud.label != cloud.label_scan)[own]))
            if classes_at is not None:
                truth = classes_at(cloud.topic, cloud.stamp_ns, len(own))
                if truth is not None:
                    is_wrong = verdicts(truth, cloud.label)[own] != Verdict.RIGHT
                    wrong[cloud.scan] = 100 * float(np.mean(is_wrong))
    return (wrong, True) if wrong else (changed, False)


def label_counts(
    inspected: InspectedScan, chosen: IntArray | slice = ALL
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return headings and rows of a table: true class, if known, label, and number of returns."""
    final, truth = inspected.final, inspected.truth
    heading = "final label" if final is not None else "label by the scan"
    label = (final if final is not None else inspected.labelling.label)[chosen]
    if truth is None:
        codes, counts = np.unique(label, return_counts=True)
        listed = sorted(zip(counts.tolist(), codes.tolist(), strict=True), reverse=True)
        return (heading, "returns"), [(entities.CLASSES[k][0], f"{n:,}") for n, k in listed]
    pairs, counts = np.unique(np.stack([truth[chosen], label]), axis=1, return_counts=True)
    wrong = verdicts(*pairs) != Verdict.RIGHT
    found: list[tuple[str, ...]] = []
    for k in np.argsort(-counts, kind="stable"):
        own, name = pairs[:, k].tolist(), "wrong" if wrong[k] else ""
        true_class = TRUE_CLASSES.get(own[0], "unknown")
        found.append((true_class, entities.CLASSES[own[1]][0], f"{counts[k]:,}", name))
    return ("true class", heading, "returns", ""), found


def agreement(run: FinishedRun, inspected: InspectedScan) -> str:
    """Return a sentence on whether the labels are those of the run."""
    total = len(inspected.labelling.label)
    if inspected.differing is None:
        return f"Labelled again; {run.name} has no labels of this scan to compare with."
    if not inspected.differing:
        return f"Labelled again: all {total:,} labels equal label_scan in {LABELS}."
    made, now = run.record.versions.get("git_revision"), git_revision()
    return (
        f"**Labelled again: {inspected.differing:,} of {total:,} labels differ from {LABELS}.** "
        f"The explanation is of this program (revision {now or 'unknown'}), "
        f"not of the run's (revision {made or 'unknown'})."
    )


def _find_faults(changed: BoolArray, wrong: BoolArray | None) -> ScanFaults:
    """Return the fault of each return (n,).

    changed: (n,) by the building. wrong: (n,) by ground truth; None if it is not known.
    """
    if wrong is None:
        fault = np.where(changed, Fault.RELABELLED, Fault.NONE)
    else:
        fault = np.where(changed, Fault.OF_THE_BUILDING, Fault.OF_THE_SCAN)
        fault = np.where(wrong, fault, Fault.NONE)
    return ScanFaults(fault.astype(np.uint8), by_truth=wrong is not None)


def _recorded_changes(run: FinishedRun, number: int, count: int) -> dict[str, Any] | None:
    """Read the changes of a scan's labels by the building; None if they were not recorded.

    count: number of changed labels; a recording with another one is of other labels.
    """
    if run.recording is None:
        return None
    found = rows(run.recording, entities.RELABELLED, entities.POINT_REASON)
    values = next((row.values for row in found if row.scan == number), None)
    return values if values is not None and len(values["class_ids"]) == count else None


def _change_rows(values: Mapping[str, Any], wrong: BoolArray | None) -> list[tuple[str, ...]]:
    """Tabulate recorded changes; see `InspectedScan`.

    wrong: (c,) whether each changed label is wrong; None if unknown.
    """
    names = entities.POINT_LABEL_SCAN, "class_ids", entities.POINT_REASON
    codes = np.column_stack([values[name] for name in names])
    odds = values[entities.POINT_ODDS].astype(np.float64)
    kinds, kind, counts = np.unique(codes, axis=0, return_inverse=True, return_counts=True)
    changes: list[tuple[str, ...]] = []
    for k in np.argsort(-counts, kind="stable"):
        own = kind.ravel() == k
        before, after, reason = kinds[k].tolist()
        changes.append(
            (
                f"{counts[k]:,}",
                "–" if wrong is None else f"{np.count_nonzero(wrong[own]):,}",
                f"{entities.CLASSES[before][0]} → {entities.CLASSES[after][0]}",
                KIND_WORDS[reason],
                _odds_text(float(np.sort(odds[own])[np.count_nonzero(own) // 2])),
            )
        )
    return changes


def _odds_text(odds: float) -> str:
    if np.isnan(odds):
        return "unknown"
    return f"over {ODDS_MAX:,.0f}:1" if odds >= 0.99 * ODDS_MAX else f"{odds:,.{int(odds < 10)}f}:1"


def faults_in_words(faults: ScanFaults | None, lines: PointLines) -> str:
    """Return a sentence on the marked returns, and where most of them are."""
    if faults is None:
        return "Nothing is marked: the run has no final labels (`label`) of this scan."
    total = f"{len(faults.fault):,}"
    of_scan, of_building, changed = (
        f"{np.count_nonzero(faults.fault == fault):,}"
        for fault in (Fault.OF_THE_SCAN, Fault.OF_THE_BUILDING, Fault.RELABELLED)
    )
    if faults.by_truth:
        wrong = f"{np.count_nonzero(faults.fault):,}"
        text = (
            f"**The final label (`label`) of {wrong} of {total} returns is wrong.** Marked cyan: "
            f"{of_scan} with that label by the scan itself (`label_scan`). Marked pink: "
            f"{of_building} whose label was changed by the building."
        )
    else:
        text = (
            f"Ground truth is not known. **Marked cyan: {changed} of {total} returns whose final "
            "label (`label`) is not the label by the scan itself (`label_scan`).**"
        )
    worst = faults.worst_line(lines)
    if worst is None:
        return text
    return f"{text} Most are in {name_of(worst)}: {int(faults.counts(lines)[worst]):,}."
