"""ffmap inspect: one scan of a finished run, labelled again with all evidence, line by line."""

import re
import tempfile
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from ffmap.algorithms.base.scan import Scan, UInt8Array, within_range
from ffmap.algorithms.poses.levelling import LevelledScan, place_and_level
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.smoothing import smooth_ranges
from ffmap.app.analysis.faults import find_faults, in_words
from ffmap.app.analysis.run_labels import CloudLabels, LabelSource
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.names import EVALUATION, check_no_run_loses, make_writable
from ffmap.app.record.inspection import ScanFaults, write
from ffmap.app.record.line_reasons import LineReason, explain_lines, name_of, scan_document
from ffmap.app.record.read_back import readable, rows
from ffmap.app.record.stream import start_viewer
from ffmap.app.run.blocks import seed_of
from ffmap.app.run.poses import given_poses, poses_of
from ffmap.app.setup.inputs import Inputs, digest_clouds, digest_stamps, find_inputs
from ffmap.blueprints import entities
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan, read_scans

WORST = "worst"
_PLAIN = re.compile(r"\*\*|`")
"""What Markdown has and a terminal does not."""


@dataclass(frozen=True, eq=False)
class InspectedScan:
    """A scan of a run, labelled again by the functions and settings of the run.

    labelling: with all evidence. differing: how many returns the run itself had labelled otherwise; None where its files
    do not tell. compared_with: the file that told. faults: what is wrong with its final labels; None where they do not tell.
    """

    index: int
    scan: Scan
    level: LevelledScan
    labelling: ScanLabelling
    differing: int | None
    compared_with: str | None
    faults: ScanFaults | None


def inspect(run_path: Path, wanted: str, line: int | None, bag: Path | None, out: Path | None, spawn: bool) -> None:
    """Record one scan line by line; raises InputError for what the user can mend.

    line: the one to open at; None for the worst, as far as the run's files tell.
    bag: where the run's bag lies now; None for where it was.
    """
    run = open_run(run_path)
    number = None if wanted == WORST else _number(wanted)
    notes: list[str] = []
    if number is None:
        number, why = find_worst(run)
        notes.append(f"Scan {number} is the worst: {why}.")
    target = _target(run, out, number)
    inspected = label_again(run, number, bag)
    lines = len(inspected.labelling.lines)
    if line is not None and not 0 <= line < lines:
        raise InputError(f"--line {line}: a scan of this lidar has lines 0 to {lines - 1} (2 × emitter + side)")
    labelling, faults = inspected.labelling, inspected.faults
    notes += [in_words(faults, labelling.lines), agreement(run, inspected)]
    reasons = explain_lines(labelling)
    counts = faults.counts(labelling.lines).tolist() if faults is not None else None
    document = scan_document(f"Scan {number} of {run.name}", notes, labelling, reasons, counts)
    opened = line if line is not None or faults is None else faults.worst_line(labelling.lines)
    with tempfile.TemporaryDirectory(prefix="ffmap-inspect-") as spool:
        write(target, Path(spool), str(uuid.uuid4()), inspected.level, labelling, reasons, faults, document, opened)
    for note in notes:
        typer.echo(_PLAIN.sub("", note))
    if line is None:
        _print_outcomes(reasons)
    if opened is not None:
        _print_reason(reasons[opened])
    typer.echo(f"recording: {target}  (open it: ffmap view {target}; step through the timeline 'line')")
    if spawn:
        open_viewer(target)


def open_viewer(path: Path) -> None:
    """Raises InputError where no viewer starts."""
    try:
        start_viewer(files=[path])
    except RuntimeError as error:
        raise InputError(f"--spawn: {error} Leave it out: {path} can be opened later") from error


def _check_same_clouds(run: FinishedRun, inputs: Inputs) -> None:
    """Raises InputError where the bag is not what the run was made from, be it by one byte.

    Of a run that was killed before it had read all clouds, their times alone are known.
    """
    told = run.clouds or run.part("bag").get("stamps", {})
    sensors = [sensor for sensor in inputs.used(False) if sensor.lidar.topic in told]
    if told != (digest_clouds(inputs.bag_path, sensors) if run.clouds else digest_stamps(sensors)):
        raise InputError(f"{inputs.bag_path}: is not the bag that {run.path} was made from; give that one with --bag")


def label_again(run: FinishedRun, number: int, bag: Path | None = None) -> InspectedScan:
    """Label one scan of a run as the run did: same bag, poses, settings and random numbers.

    bag: where the run's bag lies now; None for where it was.
    Raises InputError where the bag has gone or is another, the scan is out of range, or it was skipped.
    """
    bag_path = bag or run.bag_path
    if bag_path is None or not bag_path.exists():
        raise InputError(
            f"{bag_path or run.path}: the run's bag is not there, and a scan is labelled again from it; say with --bag "
            "where it is"
        )
    settings = run.settings()
    inputs = find_inputs(bag_path, run.input_options)
    _check_same_clouds(run, inputs)
    vertical = inputs.vertical
    if vertical is None:
        raise InputError(f"{run.path}: its bag has no lidar that sweeps the walls, so no scan was labelled")
    if not 0 <= number < len(vertical.index):
        raise InputError(f"--scan {number}: {run.name} has scans 0 to {len(vertical.index) - 1}")
    with open_bag(bag_path) as opened:
        _, scan = next(read_scans(opened, vertical.index, number, 1, vertical.lidar.decoding))
    if isinstance(scan, SkippedScan):
        raise InputError(f"--scan {number}: was skipped ({scan.reason}); give another scan")
    scan = within_range(scan, settings.scan.range_max_m)
    trajectory = run.part("options").get("trajectory")
    poses = poses_of(inputs, given_poses(trajectory, inputs, settings), settings)
    margin_ns = int(settings.trajectory.extrapolate_s * 1e9)
    if not poses.trajectory.covers(np.array([scan.start_ns, scan.end_ns]), margin_ns).all():
        raise InputError(f"--scan {number}: was skipped (no pose at its time); give another scan")
    level = place_and_level(
        scan,
        smooth_ranges(scan, settings.smoothing),
        poses.trajectory,
        vertical.lidar.T_base_sensor,
        poses.base_height_m,
        poses.floor_slope,
        settings.rearrangement,
        settings.trajectory.level_scan_max_deg,
    )
    labelling = label_scan(scan, level.placed, settings.method, seed_of(settings.seed, number))
    recorded, file = recorded_labels(run, number, scan.stamp_ns)
    differing = None if recorded is None else _differing(recorded, scan, labelling.label)
    faults = find_faults(run, number, scan, labelling, recorded)
    return InspectedScan(number, scan, level, labelling, differing, file, faults)


def recorded_labels(run: FinishedRun, number: int, stamp_ns: int) -> tuple[CloudLabels | None, str | None]:
    """What the run's files say of one cloud, and which file did; None where none does."""
    if run.labelled is not None:
        source = LabelSource(run, None)
        return next((c for c in source.read(first=number) if c.stamp_ns == stamp_ns), None), source.file
    if run.recording is None:
        return None, None
    with readable(run.recording) as recording:
        source = LabelSource(run, recording)
        return next((c for c in source.read() if c.stamp_ns == stamp_ns), None), source.file


def find_worst(run: FinishedRun) -> tuple[int, str]:
    """The scan with the largest error where the run was evaluated, else with the most final labels unlike its own.

    Returns its number and why. Raises InputError where the run's files tell neither.
    """
    errors = run.file(EVALUATION)
    if errors is not None:
        percent: dict[int, float] = {}
        with readable(errors) as recording:
            for row in rows(recording.path, f"{entities.SCAN_ERRORS}/**", "scalars"):
                percent[row.scan] = percent.get(row.scan, 0.0) + float(row.values["scalars"][0])
        if percent:
            worst = max(percent, key=lambda scan: (percent[scan], -scan))
            return worst, f"{percent[worst]:.1f} % of its points have a wrong final label (`label`), by the truth"
    if run.labelled is not None or run.recording is None:
        found = _most_relabelled(LabelSource(run, None))
    else:
        with readable(run.recording) as recording:
            found = _most_relabelled(LabelSource(run, recording))
    if found is None:
        raise InputError(f"{run.path}: holds no labels of single scans to find the worst by; name one, as in --scan 17")
    return found


def _most_relabelled(source: LabelSource) -> tuple[int, str] | None:
    share = {
        cloud.scan: float(np.mean(cloud.label != cloud.label_scan))
        for cloud in (c.of_returns() for c in source.read())
        if cloud.label is not None and len(cloud.label)
    }
    if not share:
        return None
    worst = max(share, key=lambda scan: (share[scan], -scan))
    return (
        worst,
        f"{100 * share[worst]:.1f} % of its final labels (`label`) are not those of the scan alone (`label_scan`)",
    )


def _differing(recorded: CloudLabels, scan: Scan, label: UInt8Array) -> int:
    """How many returns the run had labelled otherwise."""
    own = full_labels(scan, label) if recorded.every_place else label
    if len(own) != len(recorded.label_scan):
        return max(len(own), len(recorded.label_scan))
    return int(np.count_nonzero(own != recorded.label_scan))


def agreement(run: FinishedRun, inspected: InspectedScan) -> str:
    """Whether the labels are the run's own, in a sentence."""
    total = len(inspected.labelling.label)
    if inspected.differing is None:
        return f"Labelled again; {run.name} holds no labels of this scan to compare with."
    if not inspected.differing:
        return f"Labelled again: all {total:,} labels equal label_scan in {inspected.compared_with}."
    from ffmap.app.setup.versions import git_revision

    made, now = run.part("versions").get("git_revision") or "unknown", git_revision() or "unknown"
    return (
        f"**Labelled again, {inspected.differing:,} of {total:,} labels are not those of {inspected.compared_with}:** what "
        f"follows tells of this program (revision {now}), not of the run's (revision {made})."
    )


def _number(wanted: str) -> int:
    try:
        return int(wanted)
    except ValueError:
        raise InputError(f"--scan {wanted}: give a scan's number, or {WORST}") from None


def _target(run: FinishedRun, out: Path | None, number: int) -> Path:
    """Where the recording is written; never over what a run made."""
    path = run.path / f"inspect-{number}.rrd" if out is None else out
    if path.is_dir():
        path = path / f"inspect-{number}.rrd"
    if path.suffix != ".rrd":
        raise InputError(f"{path}: a recording's name ends in .rrd; give another to --out")
    check_no_run_loses(path)
    try:
        make_writable(path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another file to --out") from error
    return path


def _print_outcomes(reasons: Sequence[LineReason]) -> None:
    table = Table(title="What became of its lines", title_justify="left")
    table.add_column("lines", justify="right")
    table.add_column("outcome")
    for outcome, (name, _) in entities.LINE_OUTCOMES.items():
        table.add_row(str(sum(reason.outcome == outcome for reason in reasons)), name)
    Console(highlight=False).print(table)


def _print_reason(reason: LineReason) -> None:
    console = Console(highlight=False)
    table = Table(title=f"{name_of(reason.line)}: {entities.LINE_OUTCOMES[reason.outcome][0]}", title_justify="left")
    for heading in ("held", "condition", "measured", "needed"):
        table.add_column(heading)
    for check in reason.checks:
        held = {True: "yes", False: "no", None: "–"}[check.held]
        table.add_row(held, check.condition, check.measured, check.needed)
    console.print(table)
    console.print(_PLAIN.sub("", reason.verdict), markup=False)
