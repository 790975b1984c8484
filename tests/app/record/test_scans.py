"""What is logged of scans can be read back: values, frames, timelines, details, size."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.building.final_labels import Relabelled
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.scans import log_final, log_metrics, log_scan, scan_metrics
from ffmap.app.record.shapes import GRID_M
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints.entities import OPENINGS, PLANES, POINTS, RELABELLED
from tests import synthetic
from tests.app.record.recordings import (
    SCANS,
    rows,
    start,
    static,
    temporal_paths,
    vectors,
    write_run,
)

CLOUD_BYTES = 2 * 69_440 * 22
"""A horizontal and a vertical cloud, 22 bytes a point."""
UPMOST = "/scan/candidates/upmost"


def test_points_frames_and_times(recording, labelled):
    points, frames = (list(rows(recording, path)) for path in (POINTS, "/scan"))
    assert [row["scan"] for row in points] == list(range(SCANS))
    assert [row["stamp"].value for row in points] == [synthetic.stamp_ns(k) for k in range(SCANS)]
    for row, frame, (scan, level, labelling) in zip(points, frames, labelled, strict=True):
        placed = level.placed
        assert len(row["positions"]) == len(scan)
        offset_m = np.abs(vectors(row["positions"]) - placed.points_level).max()
        assert offset_m <= 0.5 * GRID_M + 1e-6
        np.testing.assert_array_equal(row["class_ids"], labelling.label)
        np.testing.assert_array_equal(row["label_scan"], labelling.label)
        np.testing.assert_array_equal(row["measured_alone"], level.ranges.correction_m == 0)
        rotation, translation = vectors(frame["quaternion"])[0], vectors(frame["translation"])[0]
        T_map_level = transforms.from_quaternion(translation, rotation)
        np.testing.assert_allclose(T_map_level, placed.T_map_level, atol=1e-6)


def test_intensities_have_three_digits(tmp_path, labelled):
    scan, level, labelling = labelled[0]
    given = np.random.default_rng(0).uniform(0.0, 300.0, len(scan)).astype(np.float32)
    given[:4] = 0.0, 255.0, np.nan, 80_000.0  # the last is beyond half precision
    with open_log(tmp_path / "block.rrd", "run-6") as log:
        log_scan(log, 0, level, labelling, scan.stamp_ns, given)
    (row,) = rows(tmp_path / "block.rrd", POINTS)
    np.testing.assert_allclose(row["intensity"], np.minimum(given, 65_504.0), rtol=5e-4)


def test_differences_are_logged_as_values_and_as_images(recording, labelled):
    of_lines = "/scan/differences/of_lines"
    for row, image, roles, (_, _, labelling) in zip(
        rows(recording, "/scan/structures"),
        rows(recording, of_lines),
        rows(recording, "/scan/differences/structures"),
        labelled,
        strict=True,
    ):
        structures, count = labelling.structures, 2 * synthetic.RINGS
        for name in ("difference", "slope"):
            expected = np.clip(getattr(structures, name), -65504.0, 65504.0)  # half precision
            np.testing.assert_allclose(vectors(row[name]), expected, rtol=1e-3, atol=1e-6)
        for name in ("line", "first", "last", "upmost", "bottommost"):
            np.testing.assert_array_equal(row[name], getattr(structures, name))
        # A column for each line, side 0 first; a row for each sample, upwards.
        order = np.r_[0:count:2, 1:count:2]
        shades = np.asarray(image["buffer"][0]).reshape(200, count)[::-1].T
        steep = np.nan_to_num(structures.difference[order], nan=np.inf)
        present = labelling.lines.samples[order, 0] >= 0
        assert np.array_equal(shades[present] >= 9, steep[present] >= 1.0)
        within = np.abs(steep[present]) < 1.0
        assert np.isin(shades[present][within], (5, 6, 7, 8)).all()
        assert not shades[~present].any()
        upmost = np.asarray(roles["buffer"][0]).reshape(200, count)[::-1].T == 3
        own = structures.upmost[order]
        lengths = np.where(own >= 0, (structures.last - structures.first + 1)[own], 0)
        np.testing.assert_array_equal(upmost.sum(axis=1), lengths)
    classes = str(static(recording)[of_lines]["context"])
    assert all(f"'{name}'" in classes for name in ("-1 to -0.5", "0.5 to 1", "no sample"))


def test_planes_candidates_and_doors_have_their_evidence(recording, labelled):
    for upmost, doors, planes, openings, (_, _, labelling) in zip(
        rows(recording, UPMOST),
        rows(recording, "/scan/doors/conditions"),
        rows(recording, PLANES),
        rows(recording, OPENINGS),
        labelled,
        strict=True,
    ):
        found, door_lines = labelling.planes, labelling.door_lines
        np.testing.assert_array_equal(upmost["line"], found.candidates.line)
        np.testing.assert_array_equal(upmost["plane"], found.candidate_plane)
        np.testing.assert_array_equal(doors["line"], door_lines.line)
        held = np.asarray(doors["conditions_held"])
        np.testing.assert_array_equal(held == 3, door_lines.above_door)
        np.testing.assert_allclose(vectors(planes["normal"]), found.normal, atol=1e-6)
        np.testing.assert_allclose(planes["offset_m"], found.offset_m, atol=1e-5)
        np.testing.assert_array_equal(openings["line_count"], labelling.openings.line_count)
    # The viewer takes only the opacity of the factor.
    assert static(recording)[PLANES]["albedo_factor"][0][0] & 0xFF < 128


def test_metrics_are_on_their_scans(tmp_path, labelled):
    recording = start(tmp_path, "run-1")
    stamps_ns = np.array([synthetic.stamp_ns(index) for index in range(SCANS)])
    timings_ms = {"reading": 1.0, "smoothing": 2.0, "placing": 3.0}
    metrics = [
        scan_metrics(level.ranges, labelling, {**timings_ms, "labelling": 8.0 + index})
        for index, (_, level, labelling) in enumerate(labelled)
    ]
    log_metrics(Log(recording.stream), stamps_ns, np.arange(SCANS), np.array(metrics))
    recording.finish()

    def found(path: str) -> list[float]:
        return [row["scalars"][0] for row in rows(tmp_path / "recording.rrd", f"/metrics/{path}")]

    assert found("milliseconds/labelling") == [8.0, 9.0, 10.0, 11.0]
    assert found("milliseconds/placing") == [3.0] * SCANS
    labellings = [labelling for *_, labelling in labelled]
    assert found("labels/wall") == [np.count_nonzero(k.label == Label.WALL) for k in labellings]
    assert found("counts/planes") == [len(k.planes) for k in labellings]
    np.testing.assert_allclose(found("ranges/scatter_mm"), 5.0, rtol=0.1)


def test_less_detail_logs_less(tmp_path, labelled):
    logged = {}
    for detail in Detail:
        (folder := tmp_path / detail).mkdir()
        logged[detail] = temporal_paths(write_run(folder, labelled, detail))
    assert logged[Detail.MAP] < logged[Detail.SCANS] < logged[Detail.LINES]
    assert {POINTS, PLANES} <= logged[Detail.SCANS]
    assert not [path for path in logged[Detail.MAP] if path.startswith("/scan/")]


def test_a_scan_with_everything_is_small(recording):
    blocks = sum(block.stat().st_size for block in recording.parent.glob("????.rrd"))
    assert blocks / SCANS < 0.2 * CLOUD_BYTES
    assert recording.stat().st_size < blocks + 1_000_000


def test_final_labels_replace_those_of_the_scan(tmp_path, labelled):
    _, level, labelling = labelled[0]
    final = labelling.label.copy()
    final[:100] = Label.OUTSIDE
    recording = start(tmp_path, "run-2")
    log, stamp_ns = Log(recording.stream), synthetic.stamp_ns(0)
    log_scan(log, 0, level, labelling, stamp_ns)
    changed = labelling.label != final
    kind, odds = np.where(changed, 9, 0).astype(np.uint8), np.full(len(final), 12.5, np.float32)
    wall = np.full(len(final), 7, np.int32)
    relabelled = Relabelled(final, kind, odds, wall)
    log_final(log, 0, stamp_ns, level.placed.points_level, labelling.label, relabelled)
    log.send_rows()
    recording.finish()
    path = tmp_path / "recording.rrd"
    np.testing.assert_array_equal(list(rows(path, POINTS))[-1]["class_ids"], final)
    (recorded,) = rows(path, RELABELLED)
    assert np.count_nonzero(changed) == len(recorded["class_ids"]) > 0
    np.testing.assert_array_equal(recorded["label_scan"], labelling.label[changed])
    assert set(recorded["reason"].tolist()) == {9}
    assert set(recorded["odds"].tolist()) == {12.5}
    assert set(recorded["wall"].tolist()) == {7}


@pytest.mark.parametrize("path", [POINTS, "/scan/lines", UPMOST, OPENINGS])
def test_nothing_of_the_scan_before_an_empty_one_is_shown(tmp_path, labelled, path):
    scan = synthetic.scan(0)
    arrays = {name: getattr(scan, name)[:0] for name in ("points_sensor", "ring", "cloud_index")}
    empty = replace(scan, **arrays, time_ns=None)
    level = synthetic.level(empty, synthetic.trajectory(2))
    labelling = label_scan(empty, level.placed, synthetic.settings(), 0)
    with open_log(tmp_path / "block.rrd", "run-5") as log:
        log_scan(log, 0, *labelled[0][1:], synthetic.stamp_ns(0))
        log_scan(log, 1, level, labelling, synthetic.stamp_ns(1))
    last = list(rows(tmp_path / "block.rrd", path))[-1]
    drawn = "positions" if path == POINTS else "strips"
    assert len(last[drawn]) == 0
