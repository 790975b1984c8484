"""One scan of a finished run, labelled again with all evidence, and what is wrong with its labels."""

from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN, Verdict
from ffmap.algorithms.base.scan import BoolArray, Scan, UInt8Array, within_range
from ffmap.algorithms.building.label_reasons import REASONS
from ffmap.algorithms.poses.levelling import LevelledScan, place_and_level
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.point_lines import PointLines
from ffmap.algorithms.scan.smoothing import smooth_ranges
from ffmap.app.analysis.run_labels import labels_file, read_run_labels
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.labels_file import read_labels
from ffmap.app.folder.names import EVALUATION, LABELS
from ffmap.app.record.errors import VERDICT_COLORS
from ffmap.app.record.inspection import ScanFaults
from ffmap.app.record.line_reasons import name_of
from ffmap.app.record.read_back import readable, rows
from ffmap.app.run.given_poses import given_poses
from ffmap.app.run.poses import estimate_poses
from ffmap.app.run.scans import seed_of
from ffmap.app.setup.versions import git_revision
from ffmap.blueprints import entities
from ffmap.blueprints.entities import Fault
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.fingerprint import fingerprint
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan, read_scans


@dataclass(frozen=True, eq=False)
class InspectedScan:
    """A scan of a run, labelled again by the functions and settings of the run.

    lidar: which of several it is from, in a sentence; None where there is one. labelling: with all evidence. differing: how many
    returns the run itself had labelled otherwise; None where its labels do not tell. faults: what is wrong with its final labels;
    None where they do not tell. changes: why the building changed labels, most first; none where no recording tells.
    """

    index: int
    lidar: str | None
    scan: Scan
    level: LevelledScan
    labelling: ScanLabelling
    differing: int | None
    faults: ScanFaults | None
    changes: tuple["LabelChange", ...]


@dataclass(frozen=True)
class LabelChange:
    """Returns of a scan that the building gave one label in place of another for one reason, in words.

    wrong: how many of them are wrong by the truth; None where it is not known. off_face_m: median distance to the nearest wall's
    face; None where most have none near.
    """

    before: str
    after: str
    reason: str
    count: int
    wrong: int | None
    off_face_m: float | None


def label_again(run: FinishedRun, number: int, bag: BagPath | None = None) -> InspectedScan:
    """Label one scan of a run as the run did: same bag, poses, settings and random numbers.

    bag: where the run's bag lies now; None for where it was.
    Raises InputError where the bag has gone or is another, the scan is out of range, or it was skipped.
    """
    bag_path = bag or run.bag_path
    missing = run.path if bag_path is None else bag_path.missing
    if bag_path is None or missing is not None:
        raise InputError(
            f"{missing}: the run's bag is not there, and a scan is labelled again from it; say with --bag where it is"
        )
    settings = run.settings()
    inputs = run.find_inputs(bag_path)
    bag_digest = fingerprint(inputs.bag_path)
    if run.bag_digest not in (None, bag_digest):
        raise InputError(
            f"{inputs.bag_path}: is not the bag that {run.path} was made from; give that one with --bag"
        )
    if not inputs.verticals:
        raise InputError(f"{run.path}: its bag has no lidar that sweeps the walls, so no scan was labelled")
    if not 0 <= number < len(inputs.scans):
        raise InputError(f"--scan {number}: {run.name} has scans 0 to {len(inputs.scans) - 1}")
    vertical, cloud = inputs.verticals[inputs.scans.lidar[number]], int(inputs.scans.cloud[number])
    with open_bag(bag_path) as opened:
        _, scan = next(read_scans(opened, vertical.index, cloud, 1, vertical.lidar.decoding))
    if isinstance(scan, SkippedScan):
        raise InputError(f"--scan {number}: was skipped ({scan.reason}); give another scan")
    scan = within_range(scan, settings.scan.range_max_m)
    options = run.options
    given = given_poses(options.trajectory, inputs, settings, options.trajectory_frame)
    poses = estimate_poses(inputs, given, settings, lambda: bag_digest)
    margin_ns = int(settings.trajectory.extrapolate_s * 1e9)
    if not poses.registered.covers(np.array([scan.start_ns, scan.end_ns]), margin_ns).all():
        raise InputError(f"--scan {number}: was skipped (no pose at its time); give another scan")
    try:
        scan = vertical.lidar.seen(scan, poses.registered)
        level = place_and_level(
            scan,
            smooth_ranges(scan, settings.smoothing),
            poses.registered,
            vertical.lidar.T_base_sensor,
            poses.base_height_m,
            poses.floor_slope,
            settings.rearrangement,
            settings.trajectory.level_scan_max_deg,
        )
        seed, columns = seed_of(settings.seed, cloud), vertical.lidar.column_pairs
        labelling = label_scan(scan, level.placed, settings.method, seed, level.floor, columns)
    except Exception as error:
        reason = SkippedScan.failed(number, scan.stamp_ns, error).reason
        raise InputError(f"--scan {number}: was skipped ({reason}); give another scan") from error
    final, differing = _compare_recorded(run, number, scan, labelling.label)
    wrong = _wrong(run, number, len(scan))
    faults = None if final is None else _find_faults(final == labelling.label, wrong)
    wrong_changed = None if final is None or wrong is None else wrong[final != labelling.label]
    several = len(inputs.verticals) > 1
    lidar = f"Scan {number} is cloud {cloud} of {vertical.lidar.topic}." if several else None
    return InspectedScan(number, lidar, scan, level, labelling, differing, faults, _changes(run, number, wrong_changed))


def _compare_recorded(
    run: FinishedRun, number: int, scan: Scan, label: UInt8Array
) -> tuple[UInt8Array | None, int | None]:
    """(n,) the run's final label of each return, and how many it had labelled otherwise by the scan alone.

    Both None where the run has no labels of this scan.
    """
    path = labels_file(run)
    recorded = read_labels(path, number, 1).get(number) if path is not None else None
    if recorded is None:
        return None, None
    final, label_scan = recorded
    own = full_labels(scan.cloud_size, scan.cloud_index, label)
    if len(own) != len(label_scan):
        return None, max(len(own), len(label_scan))
    return final[scan.cloud_index], int(np.count_nonzero(own != label_scan))


def find_worst(run: FinishedRun) -> tuple[int, str]:
    """The scan with the largest error where the run was evaluated, else with the most final labels unlike its own.

    Returns its number and why. Raises InputError where the run's files tell neither.
    """
    percent: dict[int, float] = {}
    errors = run.file(EVALUATION)
    if errors is not None:
        with readable(errors) as recording:
            for row in rows(recording.path, f"{entities.SCAN_ERRORS}/**", "scalars"):
                percent[row.scan] = percent.get(row.scan, 0.0) + float(row.values["scalars"][0])
    why = "of its points have a wrong final label (`label`), by the truth"
    if not percent:
        for cloud in read_run_labels(run):
            own = cloud.label_scan != NO_RETURN
            if own.any():
                percent[cloud.scan] = 100 * float(np.mean((cloud.label != cloud.label_scan)[own]))
        why = "of its final labels (`label`) are not those of the scan alone (`label_scan`)"
    if not percent:
        raise InputError(f"{run.path}: holds no labels of single scans to find the worst by; name one, as in --scan 17")
    worst = max(percent, key=lambda scan: (percent[scan], -scan))
    return worst, f"{percent[worst]:.1f} % {why}"


def agreement(run: FinishedRun, inspected: InspectedScan) -> str:
    """Whether the labels are the run's own, in a sentence."""
    total = len(inspected.labelling.label)
    if inspected.differing is None:
        return f"Labelled again; {run.name} holds no labels of this scan to compare with."
    if not inspected.differing:
        return f"Labelled again: all {total:,} labels equal label_scan in {LABELS}."
    made, now = run.part("versions").get("git_revision") or "unknown", git_revision() or "unknown"
    return (
        f"**Labelled again, {inspected.differing:,} of {total:,} labels are not those of {LABELS}:** what "
        f"follows tells of this program (revision {now}), not of the run's (revision {made})."
    )


def _find_faults(own: BoolArray, wrong: BoolArray | None) -> ScanFaults:
    """What is wrong with a scan's final labels. own: (n,) which of them are the scan's own. wrong: see `_wrong`."""
    if wrong is None:
        return ScanFaults(np.where(own, Fault.NONE, Fault.RELABELLED).astype(np.uint8), by_truth=False)
    fault = np.where(own, Fault.OF_THE_SCAN, Fault.OF_THE_BUILDING)
    return ScanFaults(np.where(wrong, fault, Fault.NONE).astype(np.uint8), by_truth=True)


def _changes(run: FinishedRun, number: int, wrong: BoolArray | None) -> tuple[LabelChange, ...]:
    """Why the building changed a scan's labels, by the recording; the most frequent first.

    wrong: (c,) whether each label that it changed is wrong by the truth; None where that is not known.
    """
    if run.recording is None:
        return ()
    with readable(run.recording) as recording:
        found = rows(recording.path, entities.RELABELLED, entities.POINT_REASON)
        values = next((row.values for row in found if row.scan == number), None)
    if values is None:
        return ()
    codes = np.column_stack([values[name] for name in (entities.POINT_LABEL_SCAN, "class_ids", entities.POINT_REASON)])
    off_face_m = values[entities.POINT_OFF_FACE].astype(np.float64)
    kinds, kind, counts = np.unique(codes, axis=0, return_inverse=True, return_counts=True)
    if wrong is not None and len(wrong) != len(codes):
        wrong = None  # the recording was cut or is of other labels
    changes = []
    for k in np.argsort(-counts, kind="stable"):
        own = kind.ravel() == k
        before, after, reason = kinds[k].tolist()
        median_m = float(np.median(off_face_m[own]))
        changes.append(
            LabelChange(
                before=entities.CLASSES[before][0],
                after=entities.CLASSES[after][0],
                reason=REASONS[reason],
                count=int(counts[k]),
                wrong=None if wrong is None else int(np.count_nonzero(wrong[own])),
                off_face_m=median_m if np.isfinite(median_m) else None,
            )
        )
    return tuple(changes)


def _wrong(run: FinishedRun, number: int, count: int) -> BoolArray | None:
    """(count,) whether the evaluation found each return's final label wrong; None where the scan was not evaluated."""
    errors = run.file(EVALUATION)
    if errors is None:
        return None
    with readable(errors) as recording:
        for row in rows(recording.path, entities.POINTS, entities.POINT_VERDICT_COLOR):
            if row.scan == number:
                wrong = np.asarray(row.values[entities.POINT_VERDICT_COLOR] != VERDICT_COLORS[Verdict.RIGHT])
                return wrong if len(wrong) == count else None
    return None


def faults_in_words(faults: ScanFaults | None, lines: PointLines) -> str:
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
