"""Labels of two runs of one bag, point by point, and by the ground truth if the bag has it."""

from collections.abc import Callable

import numpy as np

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.votes import VoxelTable
from ffmap.algorithms.truth.changes import (
    CLASSES,
    TRANSITIONS,
    Became,
    LabelChange,
    SpotFinder,
    count_judged,
    count_transitions,
    judge,
    transitions,
)
from ffmap.app.analysis.ground_truth import open_classes
from ffmap.app.analysis.run_labels import read_run_labels, side_by_side
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.labels_file import ScanLabels

VOXEL_M = 0.1
"""Edge of the voxels that changed points are shown by in the map."""
ChangedPoints = Callable[[ScanLabels, FloatArray, UInt8Array, UInt8Array], None]
"""Receives each compared cloud, and positions (c, 3), classes before (c,) and classes after (c,) of
its changed points."""


def compare_labels(
    a: FinishedRun, b: FinishedRun, changed_points: ChangedPoints
) -> tuple[LabelChange | None, dict[str, int]]:
    """Compare all labels; also count the scans that cannot be compared.

    Returns None without a common cloud.
    """
    # Points are placed for one of the runs alone, which takes longer than reading their labels.
    bag_a, bag_b = (run.bag_path is not None and run.bag_path.missing is None for run in (a, b))
    pairs = side_by_side(read_run_labels(a, bag_a), read_run_labels(b, bag_b and not bag_a))
    voxels, judged_voxels = VoxelTable(VOXEL_M, TRANSITIONS), VoxelTable(VOXEL_M, 2)
    spots = [SpotFinder() for _ in Became]
    rows: list[tuple[int, int, IntArray, int, IntArray]] = []
    only_a = only_b = unlike = 0
    judge_run = a if bag_a else b
    with open_classes(judge_run, judge_run.bag_path) as classes_at:
        for in_a, in_b in pairs:
            if in_a is None or in_b is None:
                only_a, only_b = only_a + (in_b is None), only_b + (in_a is None)
                continue
            (one, points), (other, other_points) = in_a, in_b
            if len(one.label) != len(other.label):
                unlike += 1
                continue
            counts = count_transitions(one.label, other.label)
            changed_scan = int(np.count_nonzero(one.label_scan != other.label_scan))
            changed = np.flatnonzero(one.label != other.label)
            labels = one.label[changed], other.label[changed]
            became, judged = np.full(len(changed), Became.NEITHER, np.uint8), _NONE_JUDGED
            truth = None
            if classes_at is not None and len(changed):
                truth = classes_at(one.topic, one.stamp_ns, len(one.label))
            if truth is not None:
                became = judge(truth[changed], *labels)
                judged = count_judged(truth[changed], became)
            rows.append((one.scan, one.stamp_ns, counts, changed_scan, judged))
            points = points if points is not None else other_points
            if points is None:
                points = np.full((len(one.label), 3), np.nan, np.float32)
            placed = np.isfinite(points[changed]).all(axis=1)
            points, became = points[changed][placed], became[placed]
            before, after = transitions(labels[0][placed], labels[1][placed])
            voxels.add(points, CLASSES * before + after)
            judged_voxels.add(points[became != Became.NEITHER], became[became != Became.NEITHER])
            for kind, spot in zip(Became, spots, strict=True):
                # Without a verdict, all changed points.
                of_kind = became == kind if kind != Became.NEITHER else slice(None)
                spot.add(one.scan, points[of_kind])
            changed_points(one, points, before, after)
        with_truth = classes_at is not None
    skipped = {"scans_only_a": only_a, "scans_only_b": only_b, "scans_unlike": unlike}
    if not rows:
        return None, skipped
    scan, stamp_ns, all_counts, all_changed, all_judged = map(np.array, zip(*rows, strict=True))
    right, wrong, changed_spot = (spot.find() for spot in spots)
    found = LabelChange(
        scan=scan,
        stamp_ns=stamp_ns,
        counts=all_counts,
        changed_scan=all_changed,
        voxels=voxels.votes(),
        judged=all_judged if with_truth else None,
        judged_voxels=judged_voxels.votes(),
        spots=(right, wrong, changed_spot),
    )
    return found, skipped


_NONE_JUDGED: IntArray = np.zeros((len(Truth), 2), np.int64)
