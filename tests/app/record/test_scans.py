"""What is logged of scans can be read back: values, frames, timelines, details, and a size that stays within bounds."""

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.building.final_labels import Relabelled
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.scans import log_final, log_metrics, log_scan, scan_metrics
from ffmap.app.record.shapes import GRID_M
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities
from tests import synthetic
from tests.app.record.recordings import SCANS, rows, start, temporal_paths, vectors, write_run

CLOUD_BYTES = 2 * 69_440 * 22
"""A horizontal and a vertical cloud, 22 bytes a point."""


def test_points_have_positions_and_both_labels_in_the_order_of_the_scan(recording, labelled):
    found = {row["scan"]: row for row in rows(recording, entities.POINTS)}
    assert sorted(found) == list(range(SCANS))
    for index, (scan, level, labelling) in enumerate(labelled):
        row = found[index]
        assert len(row["positions"]) == len(scan)
        assert np.abs(vectors(row["positions"]) - level.placed.points_level).max() <= 0.5 * GRID_M + 1e-6
        np.testing.assert_array_equal(row["class_ids"], labelling.label)
        np.testing.assert_array_equal(row["label_scan"], labelling.label)
        alone = level.ranges.correction_m == 0
        assert 0 < np.count_nonzero(alone) < len(scan)
        np.testing.assert_array_equal(row["measured_alone"], alone)


def test_intensities_are_kept_to_three_digits(tmp_path, labelled):
    scan, level, labelling = labelled[0]
    given = np.random.default_rng(0).uniform(0.0, 300.0, len(scan)).astype(np.float32)
    given[:4] = 0.0, 255.0, np.nan, 80_000.0  # the last is beyond what half a float holds
    with open_log(tmp_path / "block.rrd", "run-6") as log:
        log_scan(log, 0, level, labelling, scan.stamp_ns, intensity=given)
    (row,) = rows(tmp_path / "block.rrd", entities.POINTS)
    np.testing.assert_allclose(row["intensity"], np.minimum(given, 65_504.0), rtol=5e-4)


def test_both_timelines_are_exact(recording):
    stamps = [row["stamp"].value for row in rows(recording, entities.POINTS)]
    assert stamps == [synthetic.stamp_ns(index) for index in range(SCANS)]


def test_the_scan_is_placed_by_its_transform(recording, labelled):
    for row, (_, level, _) in zip(rows(recording, entities.SCAN), labelled, strict=True):
        T_map_level = transforms.from_quaternion(vectors(row["translation"])[0], vectors(row["quaternion"])[0])
        np.testing.assert_allclose(T_map_level, level.placed.T_map_level, atol=1e-6)


def test_the_differences_of_all_lines_can_be_read_back(recording, labelled):
    for row, (_, _, labelling) in zip(rows(recording, entities.STRUCTURES), labelled, strict=True):
        for name in ("difference", "slope"):
            values = vectors(row[name])
            assert values.shape == (2 * synthetic.RINGS, 200)
            expected = np.clip(getattr(labelling.structures, name), -65504.0, 65504.0)  # kept as float16
            np.testing.assert_allclose(values, expected, rtol=1e-3, atol=1e-6)
        for name in ("line", "first", "last", "upmost", "bottommost"):
            np.testing.assert_array_equal(row[name], getattr(labelling.structures, name))


def test_evidence_stands_beside_what_is_drawn(recording, labelled):
    for upmost, doors, planes, (_, _, labelling) in zip(
        rows(recording, entities.UPMOST),
        rows(recording, entities.DOOR_CONDITIONS),
        rows(recording, entities.PLANES),
        labelled,
        strict=True,
    ):
        np.testing.assert_array_equal(upmost["line"], labelling.planes.candidate_line)
        np.testing.assert_array_equal(upmost["plane"], labelling.planes.candidate_plane)
        np.testing.assert_array_equal(doors["line"], labelling.door_lines.line)
        np.testing.assert_array_equal(np.asarray(doors["conditions_held"]) == 3, labelling.door_lines.above_door)
        np.testing.assert_allclose(vectors(planes["normal"]), labelling.planes.normal, atol=1e-6)
        np.testing.assert_allclose(planes["offset_m"], labelling.planes.offset_m, atol=1e-5)
        # Of a mesh's colours the viewer takes the factor's opacity alone.
        assert planes["albedo_factor"][0] & 0xFF < 128


def test_metrics_lie_on_their_scans(tmp_path, labelled):
    recording, stamps_ns = start(tmp_path, "run-1"), [synthetic.stamp_ns(index) for index in range(SCANS)]
    timings_ms = {"reading": 1.0, "smoothing": 2.0, "placing": 3.0}
    metrics = [
        scan_metrics(level.ranges, labelling, {**timings_ms, "labelling": 8.0 + index})
        for index, (_, level, labelling) in enumerate(labelled)
    ]
    log_metrics(Log(recording.stream), np.array(stamps_ns), np.arange(SCANS), np.array(metrics))
    recording.finish()

    def found(path: str) -> list[float]:
        return [row["scalars"][0] for row in rows(tmp_path / "recording.rrd", path)]

    assert found(f"{entities.MILLISECONDS}/labelling") == [8.0, 9.0, 10.0, 11.0]
    assert found(f"{entities.MILLISECONDS}/placing") == [3.0] * SCANS
    walls = [np.count_nonzero(labelling.label == Label.WALL) for _, _, labelling in labelled]
    assert found(f"{entities.LABEL_COUNTS}/wall") == walls
    assert found(f"{entities.COUNTS}/planes") == [len(labelling.planes) for _, _, labelling in labelled]
    np.testing.assert_allclose(found(f"{entities.RANGES}/scatter_mm"), 5.0, rtol=0.1)


def test_details_log_less_and_less(tmp_path, labelled, recording):
    logged = {Detail.LINES: temporal_paths(recording)}
    for detail in (Detail.SCANS, Detail.MAP):
        folder = tmp_path / detail
        folder.mkdir()
        logged[detail] = temporal_paths(write_run(folder, labelled, detail))
    assert {entities.POINTS, entities.PLANES, entities.OPENINGS} <= logged[Detail.SCANS]
    assert not {entities.STRUCTURES, entities.CURVE_DIFFERENCES, entities.UPMOST} & logged[Detail.SCANS]
    assert entities.SCAN in logged[Detail.MAP]
    assert not [path for path in logged[Detail.MAP] if path.startswith(f"{entities.SCAN}/")]


def test_a_scan_with_everything_stays_small(recording):
    blocks = sum(block.stat().st_size for block in recording.parent.glob("????.rrd"))
    assert blocks / SCANS < 0.2 * CLOUD_BYTES
    assert recording.stat().st_size < blocks + 1_000_000  # what is logged once, and the layout


def test_final_labels_win_at_the_same_scan(tmp_path, labelled):
    _, level, labelling = labelled[0]
    final = labelling.label.copy()
    final[:100] = Label.OUTSIDE
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-2")
    log = Log(recording.stream)
    log_scan(log, 0, level, labelling, synthetic.stamp_ns(0))
    log.write_rows()
    reason, off_face_m = np.where(labelling.label == final, 0, 9).astype(np.uint8), np.full(len(final), 0.25)
    relabelled = Relabelled(final, reason, off_face_m)
    log_final(log, 0, synthetic.stamp_ns(0), level.placed.points_level, labelling.label, relabelled)
    log.write_rows()
    recording.finish()
    last = list(rows(path, entities.POINTS))[-1]
    np.testing.assert_array_equal(last["class_ids"], final)
    recorded = next(iter(rows(path, entities.RELABELLED)))
    changed = labelling.label != final
    assert np.count_nonzero(changed) == len(recorded["class_ids"]) > 0
    np.testing.assert_array_equal(recorded["label_scan"], labelling.label[changed])
    assert set(recorded[entities.POINT_REASON].tolist()) == {9}
    assert set(recorded[entities.POINT_OFF_FACE].tolist()) == {0.25}


def test_a_scan_without_returns_is_recorded_like_any_other(tmp_path, labelled):
    scan = synthetic.scan(0)
    empty = Scan(
        points_sensor=scan.points_sensor[:0],
        ring=scan.ring[:0],
        ring_count=scan.ring_count,
        time_ns=None,
        start_ns=scan.start_ns,
        stamp_ns=scan.stamp_ns,
        cloud_index=scan.cloud_index[:0],
        cloud_size=scan.cloud_size,
    )
    level = synthetic.level(empty, synthetic.trajectory(2))
    labelling = label_scan(empty, level.placed, synthetic.settings(), 0)
    with open_log(tmp_path / "block.rrd", "run-5") as log:
        log_scan(log, 0, *labelled[0][1:], synthetic.stamp_ns(0))
        log_scan(log, 1, level, labelling, synthetic.stamp_ns(1))
    # Nothing of the scan before stays in view.
    for entity in (entities.POINTS, entities.LINES, entities.UPMOST, entities.OPENINGS):
        last = list(rows(tmp_path / "block.rrd", entity))[-1]
        assert all(len(value) == 0 for value in last.values() if isinstance(value, list | np.ndarray))
