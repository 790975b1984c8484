"""What is logged can be read back: values, frames, timelines, details, and a size that stays within bounds."""

import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.building.face_alignment import AlignedFaces
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.face_verdicts import NO_JUDGED_FACES, FaceVerdict, JudgedFaces
from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.levels import HeightMap, Surface
from ffmap.algorithms.building.model import Doors, Walls, Windows
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.app.record.building import log_building, log_fused_walls, log_grid, log_map_block
from ffmap.app.record.building_reasons import explain_building
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_odometry_frame, log_pose_graph, log_registrations, log_trajectory
from ffmap.app.record.scans import log_final, log_scan, log_scan_metrics, log_skipped
from ffmap.app.record.stream import Recording, open_part, send_properties
from ffmap.app.record.whole_run import log_static, log_warnings
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from tests import synthetic

SCANS = 4
CLOUD_BYTES = 2 * 69_440 * 22
"""A horizontal and a vertical cloud, 22 bytes a point."""
Labelled = tuple[Scan, LevelledScan, ScanLabelling]


@pytest.fixture(scope="module")
def labelled() -> list[Labelled]:
    trajectory = synthetic.trajectory(SCANS)
    scans = [synthetic.scan(index) for index in range(SCANS)]
    levels = [synthetic.level(scan, trajectory) for scan in scans]
    return [
        (scan, level, label_scan(scan, level.placed, synthetic.settings(), index))
        for index, (scan, level) in enumerate(zip(scans, levels, strict=True))
    ]


def write_block(path: Path, labelled: list[Labelled], first: int, count: int, detail: Detail = Detail.LINES) -> None:
    with open_part(path, "run-1") as stream:
        log = Log(stream, detail)
        metrics = [
            log_scan(log, index, *labelled[index][1:], synthetic.stamp_ns(index), {"labelling": 8.0 + index})
            for index in range(first, first + count)
        ]
        log_scan_metrics(log, metrics)


def write_run(folder: Path, labelled: list[Labelled], detail: Detail = Detail.LINES) -> Path:
    """Two blocks, joined into one recording with its statics."""
    recording = start(folder, "run-1")
    log = Log(recording.stream, detail)
    log_static(log, {"vertical": synthetic.T_BASE_SENSOR}, entities.explain({}), synthetic.RINGS, 1.0)
    send_properties(log.stream, "settings", {"wall_planes": {"similarity_m": 0.05}, "name": None})
    for first in (0, 2):
        block = folder / f"{first:04d}.rrd"
        write_block(block, labelled, first, 2, detail)
        recording.add(block)
    recording.finish()
    return folder / "recording.rrd"


def start(folder: Path, recording_id: str) -> Recording:
    return Recording(folder / "recording.rrd", folder, recording_id, run_blueprint.build())


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, labelled: list[Labelled]) -> Path:
    return write_run(tmp_path_factory.mktemp("run"), labelled)


def rows(path: Path, entity: str, index: str = entities.SCAN_TIMELINE) -> Iterator[dict[str, Any]]:
    """The rows of one entity on a timeline, components by their short names."""
    chunks = RrdReader(path).stream().filter(content=entity).collect()
    table = chunks.reader(index=index).to_pandas()
    for row in table.to_dict("records"):
        yield {str(key).split(":")[-1]: value for key, value in row.items()}


def temporal_paths(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream() if not chunk.is_static}


def vectors(values: Any) -> np.ndarray:
    return np.stack([np.asarray(value) for value in values])


def test_points_have_positions_and_both_labels_in_the_order_of_the_scan(recording, labelled):
    found = {row["scan"]: row for row in rows(recording, entities.POINTS)}
    assert sorted(found) == list(range(SCANS))
    for index, (scan, level, labelling) in enumerate(labelled):
        row = found[index]
        assert len(row["positions"]) == len(scan)
        assert np.abs(vectors(row["positions"]) - level.placed.points_level).max() <= 0.5 / 512 + 1e-6
        np.testing.assert_array_equal(row["class_ids"], labelling.label)
        np.testing.assert_array_equal(row["label_scan"], labelling.label)
        correction_mm = 1e3 * level.ranges.correction_m
        assert np.abs(correction_mm).max() > 5
        np.testing.assert_allclose(row["range_correction_mm"], correction_mm, atol=0.51)


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


def test_metrics_lie_on_the_scan(recording, labelled):
    milliseconds = [row["scalars"][0] for row in rows(recording, f"{entities.MILLISECONDS}/labelling")]
    assert milliseconds == [8.0, 9.0, 10.0, 11.0]
    walls = [row["scalars"][0] for row in rows(recording, f"{entities.LABEL_COUNTS}/wall")]
    assert walls == [np.count_nonzero(labelling.label == Label.WALL) for _, _, labelling in labelled]
    scatter_mm = [row["scalars"][0] for row in rows(recording, f"{entities.RANGES}/scatter_mm")]
    np.testing.assert_allclose(scatter_mm, 5.0, rtol=0.1)


def test_forwarding_keeps_every_chunk(recording):
    kept = {chunk.id for chunk in RrdReader(recording).stream()}
    for block in recording.parent.glob("????.rrd"):
        assert {chunk.id for chunk in RrdReader(block).stream()} <= kept


def test_the_file_holds_properties_classes_blueprint_and_footer(recording):
    assert [entry.recording_id for entry in RrdReader(recording).recordings()] == ["run-1"]
    assert len(RrdReader(recording).blueprints()) == 1
    RrdReader(recording).store()  # fails without a footer
    static = RrdReader(recording).stream().filter(is_static=True).collect()
    columns = {field.name: chunk for chunk in static.stream() for field in chunk.to_record_batch().schema}
    assert columns["wall_planes_similarity_m"].to_record_batch()["wall_planes_similarity_m"].to_pylist() == [[0.05]]
    assert any(name.startswith("AnnotationContext") for name in columns)
    assert any("TextDocument" in name for name in columns)


def test_details_log_less_and_less(tmp_path, labelled, recording):
    logged = {Detail.LINES: temporal_paths(recording)}
    for detail in (Detail.SCANS, Detail.MAP):
        folder = tmp_path / detail
        folder.mkdir()
        logged[detail] = temporal_paths(write_run(folder, labelled, detail))
    assert {entities.POINTS, entities.PLANES, entities.OPENINGS} <= logged[Detail.SCANS]
    assert not {entities.STRUCTURES, entities.CURVE_DIFFERENCES, entities.UPMOST} & logged[Detail.SCANS]
    assert f"{entities.LABEL_COUNTS}/wall" in logged[Detail.MAP]
    assert entities.SCAN in logged[Detail.MAP]
    assert not [path for path in logged[Detail.MAP] if path.startswith(f"{entities.SCAN}/")]


def test_a_scan_with_everything_stays_small(recording):
    blocks = sum(block.stat().st_size for block in recording.parent.glob("????.rrd"))
    assert blocks / SCANS < 0.26 * CLOUD_BYTES
    assert recording.stat().st_size < blocks + 1_000_000  # what is logged once, and the layout


def test_final_labels_win_at_the_same_scan(tmp_path, labelled):
    _, level, labelling = labelled[0]
    final = labelling.label.copy()
    final[:100] = Label.OUTSIDE
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-2")
    log = Log(recording.stream)
    log_scan(log, 0, level, labelling, synthetic.stamp_ns(0), {})
    log_final(log, 0, synthetic.stamp_ns(0), level.placed, labelling.label, final)
    recording.finish()
    last = list(rows(path, entities.POINTS))[-1]
    np.testing.assert_array_equal(last["class_ids"], final)
    relabelled = next(iter(rows(path, entities.RELABELLED)))
    changed = labelling.label != final
    assert np.count_nonzero(changed) == len(relabelled["class_ids"]) > 0
    np.testing.assert_array_equal(relabelled["label_scan"], labelling.label[changed])


def registrations() -> list[Registration]:
    return [
        Registration(
            index=number,
            stamp_ns=synthetic.stamp_ns(number),
            T_odom_sensor=transforms.make_transform(translation=[number, 0.0, 0.0]),
            keypoints_sensor=np.full((5, 3), float(number)),
            local_map_odom=np.zeros((0, 3)),
            threshold_m=0.4,
            correction_m=0.01,
            residual_m=0.02 if number else float("nan"),
            refined_m=0.02,
            refined_inlier_share=0.9,
            weakest_share=0.1,
            refused=False,
            inlier_share=0.9,
            milliseconds=12.0,
        )
        for number in range(3)
    ]


def timelines_of(path: Path) -> set[str]:
    """Of what is logged of horizontal scans."""
    return {
        name
        for chunk in RrdReader(path).stream()
        if chunk.entity_path.startswith((entities.ODOMETRY, entities.REGISTRATION)) and not chunk.is_static
        for name in chunk.timeline_names
    }


def test_registrations_lie_on_stamp_alone_where_there_are_no_vertical_scans(tmp_path):
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-3")
    log = Log(recording.stream)
    log_registrations(log, registrations(), [None, "nothing holds it", None])
    recording.finish()
    assert timelines_of(path) == {entities.STAMP_TIMELINE}
    poses = [vectors(row["translation"])[0][0] for row in rows(path, entities.ODOMETRY_SENSOR, entities.STAMP_TIMELINE)]
    assert poses == [0.0, 1.0, 2.0]
    alarms = [row["scalars"][0] for row in rows(path, f"{entities.REGISTRATION}/weak", entities.STAMP_TIMELINE)]
    assert alarms == [0.0, 1.0, 0.0]
    (weak,) = rows(path, entities.WEAK_REGISTRATION, entities.STAMP_TIMELINE)
    assert vectors(weak["positions"])[0][0] == 1.0
    (message,) = rows(path, entities.MESSAGES, entities.STAMP_TIMELINE)
    assert "registration 1 is weak: nothing holds it" in str(message)
    residuals = list(rows(path, f"{entities.REGISTRATION}/residual_m", entities.STAMP_TIMELINE))
    assert len(residuals) == 2  # what was not measured is not drawn


def test_registrations_have_the_scan_of_the_first_vertical_cloud_that_is_not_older(tmp_path):
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-3")
    # Two clouds after the first sweep and before the second; a clock that steps back; none after the last sweep.
    first, second, third = (synthetic.stamp_ns(number) for number in range(3))
    scan_stamps_ns = np.array([first, first + 1, first + 2, second, first + 3, third - 1])
    log = Log(recording.stream, scan_stamps_ns=scan_stamps_ns)
    log_registrations(log, registrations(), [None, "nothing holds it", None])
    log_odometry_frame(log, np.array([second]), np.eye(4)[None])
    recording.finish()
    assert timelines_of(path) == {entities.STAMP_TIMELINE, entities.SCAN_TIMELINE}
    alarms = [(row["scan"], row["scalars"][0]) for row in rows(path, f"{entities.REGISTRATION}/weak")]
    assert alarms == [(0, 0.0), (3, 1.0), (5, 0.0)]
    assert [row["scan"] for row in rows(path, entities.KEYPOINTS)] == [0, 3, 5]
    assert [row["scan"] for row in rows(path, entities.ODOMETRY)] == [3]
    assert [row["scan"] for row in rows(path, entities.MESSAGES)] == [3]


def test_curves_and_legends_have_names_in_words_with_their_units(recording):
    static = {c.entity_path: c.to_record_batch() for c in RrdReader(recording).stream() if c.is_static}
    for path, (name, _) in entities.SERIES.items():
        assert static[path].column("SeriesLines:names").to_pylist() == [[name]]
        assert "_" not in name
    for unit, series in (
        ("mm", "ranges/scatter_mm"),
        ("%", "ranges/measured_alone_percent"),
        ("ms", "milliseconds/reading"),
    ):
        assert entities.SERIES[f"/metrics/{series}"][0].endswith(f", {unit}")
    dots, names = (static[f"{entities.LABEL_LEGEND}/{part}"] for part in ("dots", "names"))
    assert names.column("Points2D:labels").to_pylist()[0] == [name for name, _ in entities.LABEL_LEGEND_ENTRIES]
    for part in (dots, names):
        places = vectors(part.column("Points2D:positions").to_pylist()[0])
        assert np.all(np.diff(places[:, 0]) > 0)
    colors = dots.column("Points2D:colors").to_pylist()[0]
    assert colors == [(r << 24) | (g << 16) | (b << 8) | 255 for _, (r, g, b) in entities.LABEL_LEGEND_ENTRIES]
    # Each label's own colour is explained.
    shown = {color for _, color in entities.LABEL_LEGEND_ENTRIES}
    assert shown == {entities.CLASSES[label][1] for label in Label}


@pytest.mark.parametrize(("warnings", "text"), [([], "None."), (["no floor", "no clock"], "- no floor\n- no clock")])
def test_warnings_of_the_whole_run_are_a_text(tmp_path, warnings, text):
    recording = start(tmp_path, "run-12")
    log_warnings(Log(recording.stream), warnings)
    recording.finish()
    (found,) = (
        c.to_record_batch()
        for c in RrdReader(tmp_path / "recording.rrd").stream()
        if c.entity_path == entities.WARNINGS
    )
    assert found.column("TextDocument:text").to_pylist() == [[text]]


def test_loops_are_drawn_where_the_solved_poses_are(tmp_path):
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-4")
    T = np.array([transforms.make_transform(translation=[float(i), 0.0, 1.0]) for i in range(4)])
    shift = np.array([transforms.make_transform(translation=[0.0, 0.1 * i, 0.0]) for i in range(4)])
    graph = PoseGraph(
        T_odom_first=T[0],
        scan=np.arange(4) * 10,
        T_odom_sensor=shift @ T,
        T_correction=shift,
        first=np.array([0, 0, 0]),
        second=np.array([1, 3, 3]),
        offset=np.array([0.5, 1.0, 8.0]),
        inlier_share=np.array([0.9, 0.8, 0.7]),
        weight=np.array([1.0, 0.9, 0.12]),
    )
    stamps = np.array([synthetic.stamp_ns(number) for number in range(4)])
    T_map_odom = transforms.make_transform(translation=[0.0, 0.0, 2.0])
    log = Log(recording.stream)
    log_odometry_frame(log, stamps, T_map_odom @ shift)
    log_pose_graph(log, graph, T_map_odom, stamps, 0.1 * np.arange(4))
    recording.finish()
    frames = [vectors(r["translation"])[0] for r in rows(path, entities.ODOMETRY, entities.STAMP_TIMELINE)]
    np.testing.assert_allclose(frames, [[0.0, 0.1 * i, 2.0] for i in range(4)], atol=1e-6)
    moved = [r["scalars"][0] for r in rows(path, f"{entities.REGISTRATION}/loops_moved_m", entities.STAMP_TIMELINE)]
    np.testing.assert_allclose(moved, 0.1 * np.arange(4))
    static = {
        chunk.entity_path: chunk.to_record_batch().to_pydict()
        for chunk in RrdReader(path).stream()
        if chunk.is_static and chunk.entity_path.startswith(entities.POSE_GRAPH)
    }
    loops = static[entities.LOOPS]
    np.testing.assert_allclose(loops["LineStrips3D:strips"][0], [[[0, 0, 3], [3, 0.3, 3]]] * 2, atol=1e-6)
    believed, doubted = loops["LineStrips3D:colors"][0]
    assert believed != doubted  # one of them contradicts the others
    assert loops["LineStrips3D:labels"][0][1] == "70% fits, 8.0 standard deviations off, weight 0.12"
    before = static[entities.WAY_OF_ODOMETRY]["LineStrips3D:strips"][0]
    np.testing.assert_allclose(before, [[[i, 0, 3] for i in range(4)]], atol=1e-6)


def test_building_grid_map_and_messages(tmp_path):
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-4")
    log = Log(recording.stream)
    walls = Walls(
        ends=np.array([[[0.0, 0.0], [4.0, 0.0]]]),
        normal=np.array([[0.0, 1.0]]),
        bottom_m=np.zeros(1),
        top_m=np.full(1, 2.8),
        scan_count=np.array([7]),
        rms_m=np.array([0.01]),
        sample_count=np.array([900]),
    )
    doors = Doors(
        ends=np.array([[[1.0, 0.0], [1.9, 0.0]]]),
        normal=np.array([[0.0, 1.0]]),
        head_m=np.array([2.1]),
        depth_m=np.array([0.05]),
        state=np.zeros(1, np.uint8),
        confidence=np.array([0.9]),
        agreement=np.array([1.0]),
        coverage=np.array([0.9]),
        lintel=np.array([0.75]),
        ajar=np.zeros(1, bool),
        ray_count=np.array([50]),
        scan_count=np.array([3]),
        first_scan=np.array([5]),
        last_scan=np.array([9]),
        crossed=np.array([False]),
        wall=np.zeros(1, np.int64),
        reveal_m=np.array([0.05]),
    )
    windows = Windows(
        np.array([[[2.5, 0.0], [3.5, 0.0]]]), np.array([[0.0, 1.0]]), np.array([0.9]), np.array([2.2]), np.array([0.1])
    )
    leaf = replace(walls, ends=np.array([[[1.0, 0.0], [1.0, 0.9]]]))
    columns = round(float(np.linalg.norm(walls.ends[0, 1] - walls.ends[0, 0])) / 0.05)
    covered = np.zeros((columns, 60), bool)
    covered[2:4, 1] = True
    before = Foreground(np.array([0, columns]), np.full(columns, 2.8), np.zeros(columns), covered)
    log_fused_walls(log, AlignedFaces(walls, replace(walls, ends=walls.ends + 0.02), np.array([[-0.02, 0.013]])))
    attic = np.full((2, 3), np.nan)
    attic[1, 2] = 2.0
    levels = (
        HeightMap(Surface.FALSE_FLOOR, np.zeros(2), 0.1, attic - 1.8, attic + np.inf),
        HeightMap(Surface.SLOPING_CEILING, np.array([1.0, 3.0]), 0.1, attic - 0.04, attic + 0.04),
    )
    judged = JudgedFaces(walls, leaf, np.array([FaceVerdict.ENDS_LOW]))
    log_building(log, BuildingModel(walls, before, judged, doors, windows, levels))
    cells = np.full((2, 3), Cell.FREE, np.uint8)
    cells[0, 0], cells[1, 2] = Cell.OCCUPIED, Cell.UNKNOWN
    grid = GridMap(cells, np.array([-1.0, 2.0]), 0.05)
    log_grid(log, entities.FURNITURE_FREE, grid)
    stamps = np.array([synthetic.stamp_ns(index) for index in range(3)])
    log_trajectory(log, stamps, synthetic.trajectory(3).T_map_base, np.arange(3))
    log_map_block(log, 2, int(stamps[2]), np.ones((4, 3)), np.array([1, 2, 2, 3], np.uint8))
    log_skipped(log, 1, int(stamps[1]), "all returns invalid")
    recording.set_layout(run_blueprint.build(32, (0.0, 0.0), 5.0))
    recording.finish()

    static = {chunk.entity_path: chunk.to_record_batch() for chunk in RrdReader(path).stream() if chunk.is_static}
    image = static[f"{entities.GRID}/{entities.FURNITURE_FREE}"].column("GridMap:data").to_pylist()[0][0]
    assert list(bytes(image)) == [0, 0, 255, 100, 0, 0]  # the uppermost row first
    assert "closed door, 0.90 m, 90%" in str(static[entities.DOORS].column("LineStrips3D:labels").to_pylist())
    assert "no wall: rays pass above it" in str(
        static[entities.REFUSED_WALLS].column("LineStrips3D:labels").to_pylist()
    )
    reasons = static[entities.BUILDING_REASONS].column("TextDocument:text").to_pylist()[0][0]
    assert "100% of 50 rays in 90% of its columns; leaf 5.0 cm behind the wall" in reasons
    assert "head at 2.10 m, wall seen above 75% of it" in reasons
    assert "3 from 5 to 9" in reasons
    assert "rays pass above it" in reasons
    assert "10 cm behind the face" in reasons
    ajar = replace(doors, ajar=np.array([True]))
    assert "its leaf stands aslant" in explain_building(
        BuildingModel(walls, before, NO_JUDGED_FACES, ajar, windows, ())
    )
    assert "| sloping ceiling | 0.0 m² | 1.96 – 2.04 m |" in reasons
    assert "| false floor, if scans saw any | | from 0.20 m up |" in reasons
    sloping = static[f"{entities.LEVELS}/{Surface.SLOPING_CEILING}"]
    places = vectors(sloping.column("Boxes3D:centers").to_pylist()[0])
    np.testing.assert_allclose(places, [[1.25, 3.15, 2.0]], rtol=1e-6)
    np.testing.assert_allclose(sloping.column("high_m").to_pylist()[0], [2.04], rtol=1e-6)
    assert f"{entities.LEVELS}/{Surface.FALSE_FLOOR}" not in static
    assert "aslant" not in reasons
    fused = static[entities.FUSED_WALLS]
    assert "its ends then moved -2.0 and +1.3 cm" in str(fused.column("LineStrips3D:labels").to_pylist())
    np.testing.assert_allclose(fused.column("moved_m").to_pylist()[0], [[-0.02, 0.013]], rtol=1e-6)
    against = vectors(static[entities.AGAINST_WALLS].column("Points3D:positions").to_pylist()[0])
    np.testing.assert_allclose(against, [[0.125, 0, 0.075], [0.175, 0, 0.075]], atol=1e-6)
    outline = vectors(static[entities.WINDOWS].column("LineStrips3D:strips").to_pylist()[0][0])
    np.testing.assert_allclose(outline[:3], [[2.5, 0, 0.9], [3.5, 0, 0.9], [3.5, 0, 2.2]], rtol=1e-6)
    panels = vectors(static[entities.WALLS].column("Mesh3D:vertex_positions").to_pylist()[0]).reshape(-1, 4, 3)
    in_door = (panels.mean(axis=1)[:, 0] > 1.0) & (panels.mean(axis=1)[:, 0] < 1.9)
    assert panels[in_door, :, 2].min() >= 2.0999  # only what is above its head
    leaf = vectors(static[entities.DOOR_LEAVES].column("Mesh3D:vertex_positions").to_pylist()[0])
    np.testing.assert_allclose(leaf, [[1.0, 0, 0], [1.9, 0, 0], [1.9, 0, 2.1], [1.0, 0, 2.1]], rtol=1e-6)
    opened = BuildingModel(walls, before, judged, replace(doors, state=np.ones(1, np.uint8)), windows, levels)
    with open_part(tmp_path / "open.rrd", "run-4b") as stream:
        log_building(Log(stream), opened)
    drawn = {chunk.entity_path for chunk in RrdReader(tmp_path / "open.rrd").stream()}
    assert entities.DOORS in drawn
    assert entities.DOOR_LEAVES not in drawn  # an open door is its frame alone
    steps = [vectors(row["strips"][0]) for row in rows(path, entities.TRAJECTORY)]
    np.testing.assert_allclose(steps[2], [[0.05, 0.0, 0.0], [0.1, 0.0, 0.0]], atol=1e-6)
    assert [len(row["class_ids"]) for row in rows(path, entities.MAP_CEILING)] == [2]
    assert "scan 1 skipped: all returns invalid" in str(list(rows(path, entities.MESSAGES)))


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
    with open_part(tmp_path / "block.rrd", "run-5") as stream:
        log = Log(stream)
        log_scan(log, 0, *labelled[0][1:], synthetic.stamp_ns(0), {})
        log_scan(log, 1, level, labelling, synthetic.stamp_ns(1), {})
    # Nothing of the scan before stays in view.
    for entity in (entities.POINTS, entities.LINES, entities.UPMOST, entities.OPENINGS):
        last = list(rows(tmp_path / "block.rrd", entity))[-1]
        assert all(len(value) == 0 for value in last.values() if isinstance(value, list | np.ndarray))


def test_a_block_that_fails_leaves_nothing(tmp_path):
    with pytest.raises(KeyError), open_part(tmp_path / "block.rrd", "run-6"):
        raise KeyError("a worker's error")
    assert list(tmp_path.iterdir()) == []


def test_what_a_kill_leaves_can_be_read_and_what_is_finished_has_its_footer(tmp_path, labelled):
    recording = start(tmp_path, "run-1")
    Log(recording.stream).message("before the block", synthetic.stamp_ns(0))
    write_block(tmp_path / "block.rrd", labelled, 0, 2)
    recording.add(tmp_path / "block.rrd")
    Log(recording.stream).message("after it", synthetic.stamp_ns(1))
    killed = tmp_path / "killed.rrd"
    killed.write_bytes((tmp_path / "recording.rrd").read_bytes())
    recording.finish()

    with pytest.warns(rr.error_utils.RerunWarning, match="no footer"):
        left = {chunk.entity_path for chunk in RrdReader(killed).stream()}
    assert {entities.POINTS, entities.MESSAGES} <= left
    finished = RrdReader(tmp_path / "recording.rrd")
    assert [entry.recording_id for entry in finished.recordings()] == ["run-1"]
    assert len(finished.blueprints()) == 1
    messages = [row["text"] for row in rows(tmp_path / "recording.rrd", entities.MESSAGES, entities.STAMP_TIMELINE)]
    assert [str(text[0]) for text in messages] == ["before the block", "after it"]
    assert sum(chunk.entity_path == entities.POINTS for chunk in finished.store().stream()) == 1


def test_a_file_that_is_no_recording_is_not_appended(tmp_path):
    recording = start(tmp_path, "run-10")
    (tmp_path / "block.rrd").write_bytes(b"not a recording at all")
    with pytest.raises(RuntimeError, match="is not framed"):
        recording.add(tmp_path / "block.rrd")


def test_a_wrong_shape_is_an_error(tmp_path):
    with (
        pytest.raises(ValueError, match=r"(?i)expected|shape|length|size"),
        open_part(tmp_path / "block.rrd", "run-7") as stream,
    ):
        stream.log("/points", rr.Points3D(np.zeros((3, 4))))


def test_a_viewer_that_is_not_there_is_an_error_and_not_a_wait(tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        url = f"rerun+http://127.0.0.1:{probe.getsockname()[1]}/proxy"
    with pytest.raises(ConnectionError, match="no Rerun viewer"):
        Recording(tmp_path / "run.rrd", tmp_path, "run-8", run_blueprint.build(), url)
