"""A run's folder against a bag's truth, from end to end, in a room whose figures are known."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label, Truth
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.truth.tally import CUBE_M
from ffmap.app.analysis import counting
from ffmap.app.analysis.evaluation import evaluate_run, has_truth, read_building, read_doors
from ffmap.app.analysis.metrics_tables import PAPER_STATISTICS, format_metrics, in_one_line, print_metrics
from ffmap.app.folder.atomic import write_geojson, write_json
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.labels_file import LabelsWriter, stream_labels
from ffmap.app.folder.map_files import write_grid
from ffmap.app.folder.pictures import MAP_TITLES
from ffmap.loaders.bag import make_typestore
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import read_tum, write_tum
from tests.loaders.bag_builder import PERIOD_NS, START_NS, cloud, odometry, point_dtype, tf_message, write_bag

HEIGHT_M = 1.0
T_BASE_LIDAR = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, HEIGHT_M], [0, 0, 0, 1]])
MOUNT = ("base", "lidar", T_BASE_LIDAR[:3, 3], transforms.quaternion_xyzw(T_BASE_LIDAR))
SCANS = 6
SPEED_MPS = 0.5
DOOR = ((1.0, 2.0), (1.9, 2.0))


def room(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points in the map and their classes: a wall and a closed door at y = 2, the floor, someone, glass."""
    rng = np.random.default_rng(seed)

    def patch(count: int, low: Any, high: Any, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
        return rng.uniform(low, high, (count, 3)), np.full(count, truth, np.uint8)

    parts = [
        patch(600, (-1, 2.01, 0.1), (1, 2.02, 2), Truth.WALL),
        patch(300, (1, 2.01, 0.1), (1.9, 2.02, 2), Truth.DOOR),
        patch(600, (-1, -1, 0.01), (2, 2, 0.02), Truth.FLOOR),
        patch(60, (0, 0, 0.3), (0.2, 0.2, 1.7), Truth.PERSON),
        patch(60, (-1, -1.2, 0.3), (1, -1.1, 1.7), Truth.GLASS),
    ]
    return np.concatenate([p for p, _ in parts]), np.concatenate([t for _, t in parts])


def make_truth_bag(path: Path, with_truth: bool = True) -> tuple[Path, list[np.ndarray]]:
    """Clouds whose firings all have their own time while the base drives along x; also each cloud's classes."""
    version = 1 if path.suffix == ".bag" else 2
    entries: list[Any] = [("/tf_static", START_NS, tf_message([MOUNT], version))]
    classes = []
    for i in range(SCANS):
        stamp_ns = START_NS + i * PERIOD_NS
        points_map, truth = room(i)
        order = np.argsort(np.arctan2(points_map[:, 2] - HEIGHT_M, points_map[:, 1]))
        points_map, truth = points_map[order], truth[order]
        time_s = np.linspace(0, 0.099, len(points_map)).astype(np.float32)
        x_m = SPEED_MPS * (i * PERIOD_NS * 1e-9 + time_s.astype(float))
        points_sensor = transforms.apply(transforms.invert(T_BASE_LIDAR), points_map - np.c_[x_m, 0 * x_m, 0 * x_m])
        fields = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("time", "f4")]
        record = np.zeros(len(points_map) + 5, point_dtype(fields))
        for axis, name in enumerate("xyz"):
            record[name][5:] = points_sensor[:, axis]
            record[name][:5] = np.nan
        record["ring"] = np.arange(len(record)) % 32
        record["time"][5:] = time_s
        full = np.concatenate([np.full(5, 255, np.uint8), truth])
        classes.append(full)
        entries.append(("/vertical", stamp_ns + 1, cloud(record, stamp_ns, ros_version=version)))
        if with_truth:
            true = np.zeros(len(full), point_dtype([("truth", "u1")]))
            true["truth"] = full
            entries.append(("/truth/classes", stamp_ns + 2, cloud(true, stamp_ns, ros_version=version)))
    if with_truth:
        for k in range(-2, 10 * SCANS + 20):
            stamp_ns = START_NS + k * PERIOD_NS // 10
            position = (SPEED_MPS * k * PERIOD_NS * 1e-10, 0.0, 0.0)
            entries.append(("/truth/pose", stamp_ns, odometry(stamp_ns, position, ros_version=version)))
        text = make_typestore(version).types["std_msgs/msg/String"](json.dumps(BUILDING))
        entries.append(("/truth/building", START_NS, text))
    return write_bag(path, sorted(entries, key=lambda entry: entry[1])), classes


def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": {"kind": kind, **properties},
        "geometry": {"type": "LineString", "coordinates": coordinates},
    }


BUILDING = {
    "type": "FeatureCollection",
    "features": [
        feature("wall", [[-1.0, 2.015], [1.0, 2.015]]),
        feature("door", DOOR, state="closed", height=2.0, leaves=[DOOR]),
        feature("door", [[8.0, 8.0], [8.9, 8.0]], state="open", height=2.0, leaves=[]),
    ],
}


def make_run(folder: Path, bag_path: Path, classes: list[np.ndarray]) -> Path:
    """A run that labels all as it is, but the floor of scan 2 as wall in `label_scan`."""
    folder.mkdir()
    right = np.array([*range(6), 0, 0, 0, 0, 0, *[255] * 245], np.uint8)
    right[Truth.GLASS] = Label.WALL
    labels = []
    for i, truth in enumerate(classes):
        label = right[truth]
        label_scan = label.copy()
        if i == 2:
            label_scan[label == Label.FLOOR] = Label.WALL
        labels.append((i, label, label_scan))
    poses = Trajectory(
        START_NS + PERIOD_NS * np.arange(SCANS),
        np.array([transforms.from_yaw(0.0, [SPEED_MPS * 0.1 * i, 0.02, 0.0]) for i in range(SCANS)]),
    )
    list(LabelsWriter(folder / "labels.parquet").passing(labels))
    write_tum(folder / "trajectory.tum", poses)
    found = {"state": "open", "width": 0.95, "height": 2.0, "confidence": 1.0, "rooms": None}
    lines = [[[1.05, 2.0], [1.95, 2.0]], [[-5.0, 0.0], [-5.0, 1.0]]]
    write_geojson(
        folder / "doors.geojson",
        [{"properties": found, "geometry": {"type": "LineString", "coordinates": line}} for line in lines],
    )
    cells = np.full((80, 80), Cell.FREE, np.uint8)
    cells[60, 20:60] = Cell.OCCUPIED  # y = 2.025, x from -1 to 1
    cells[10, :10] = Cell.OCCUPIED
    write_grid(folder / "map.yaml", GridMap(cells, np.array([-2.0, -1.0]), 0.05))
    write_json(folder / "run.json", {"bag": {"path": str(bag_path)}, "options": {"vertical": "/vertical"}})
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("evaluate")
    bag_path, classes = make_truth_bag(folder / "in.bag")
    made = make_run(folder / "run", bag_path, classes)
    return made, evaluate_run(open_run(made), workers=1)


def test_labels(run: tuple[Path, dict[str, Any]]):
    _, metrics = run
    assert metrics["scans"] == {"counted": SCANS, "skipped": 0, "without_truth": 0}
    for name in ("wall", "floor", "door"):
        for section in ("area", "points"):
            figures = metrics[section][name]
            assert (figures["precision"], figures["recall"], figures["f1"]) == (1, 1, 1), (section, name)
    assert metrics["points"]["wall"]["right"] == 600 * SCANS
    assert metrics["area"]["clutter"]["precision"] is None or np.isnan(metrics["area"]["clutter"]["precision"])
    confusion = np.array(metrics["points"]["confusion"]["counts"])
    assert confusion[Truth.GLASS, Label.WALL] == 60 * SCANS
    assert confusion.sum() == (600 + 300 + 600 + 60 + 60) * SCANS
    points_scan = metrics["points_scan"]
    assert points_scan["wall"]["precision"] == pytest.approx(600 * SCANS / (600 * SCANS + 600))
    assert points_scan["floor"]["recall"] == pytest.approx((SCANS - 1) / SCANS)


def test_every_firing_is_placed_with_the_true_pose_of_its_own_time(run: tuple[Path, dict[str, Any]]):
    """The wall is 2 m x 1.9 m and one cube thick: placed wrongly it would have more cubes than that."""
    _, metrics = run
    cubes = round(metrics["area"]["wall"]["right_m2"] / CUBE_M**2)
    index = np.concatenate([np.floor(p[t == Truth.WALL] / CUBE_M).astype(int) for p, t in map(room, range(SCANS))])
    true = {tuple(row) for row in index.tolist()}
    assert abs(cubes - len(true)) <= 0.02 * len(true)


def test_doors(run: tuple[Path, dict[str, Any]]):
    doors = run[1]["doors"]
    assert (doors["true"], doors["passed"], doors["found_count"]) == (2, 1, 1)
    assert (doors["detections"], doors["invented_count"], doors["found"], doors["invented"]) == (2, 1, 1.0, 0.5)
    assert doors["width_error_m"] == pytest.approx(0.05)
    assert doors["state_right"] == 0


def test_wall_map(run: tuple[Path, dict[str, Any]]):
    wall_map = run[1]["wall_map"]
    assert (wall_map["true_cells"], wall_map["occupied_cells"]) == (40, 50)
    assert (wall_map["precision"], wall_map["recall"]) == (0.8, 1.0)
    assert wall_map["error_m"] == pytest.approx(0.01)
    assert run[1]["maps"] == {"furniture_free": wall_map}
    assert (wall_map["doors_passed"], wall_map["doors_blocked"]) == (1, 0)
    assert (run[0] / "overlay.png").exists()


def test_trajectory(run: tuple[Path, dict[str, Any]]):
    trajectory = run[1]["trajectory"]
    assert trajectory["poses"] == SCANS
    assert trajectory["ate_rmse_m"] == pytest.approx(0, abs=1e-6)
    assert trajectory["unaligned_rmse_m"] == pytest.approx(0.02, abs=1e-6)


def moved_run(run: tuple[Path, dict[str, Any]], tmp_path: Path, origin_m: list[float]) -> Path:
    folder = Path(shutil.copytree(run[0], tmp_path / "moved"))
    record = json.loads((folder / "run.json").read_text())
    write_json(folder / "run.json", {**record, "map_origin": origin_m})
    return folder


def test_the_truth_in_the_frame_of_poses_that_were_given_far_from_its_origin(
    run: tuple[Path, dict[str, Any]], tmp_path: Path
):
    origin_m = [432_123.0, 5_412_346.0, 450.25]
    folder = moved_run(run, tmp_path, origin_m)
    poses = read_tum(folder / "trajectory.tum")
    write_tum(tmp_path / "true.tum", poses.moved(transforms.make_transform(translation=origin_m)))
    trajectory = evaluate_run(open_run(folder), BagPath((tmp_path / "true.tum",)), workers=1)["trajectory"]
    assert trajectory["unaligned_max_m"] < 1e-3
    assert trajectory["ate_rmse_m"] < 1e-3


def test_what_lies_in_another_frame_than_the_truth_is_not_compared_with_it(
    run: tuple[Path, dict[str, Any]], tmp_path: Path
):
    folder = moved_run(run, tmp_path, [432_123.0, 5_412_346.0, 450.25])
    metrics = evaluate_run(open_run(folder), workers=1)
    assert {"doors", "maps", "wall_map", "rooms"}.isdisjoint(metrics)
    assert np.isnan(metrics["trajectory"]["unaligned_rmse_m"])
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0, abs=1e-6)
    assert metrics["area"]["wall"] == run[1]["area"]["wall"]
    told = in_one_line(metrics)
    assert "not compared: unaligned poses: the run's are 5429.6 km from the true ones" in told
    assert "not compared: doors, maps and rooms: the map's origin lies elsewhere" in told
    assert json.loads((folder / "metrics.json").read_text())["trajectory"]["unaligned_rmse_m"] is None


def test_the_closing_line_counts_what_the_robot_entered_and_saw():
    metrics = {
        "doors": {"true": 12, "passed": 5, "found_count": 4, "invented_count": 0},
        "rooms": {"true": 10, "entered": 1, "recall": 0.99349},
    }
    line = in_one_line(metrics)
    assert line == "4 of 5 doors found (7 more not passed), 0 invented, 1 of 10 rooms entered, recalled to 99.35 %"
    nowhere = in_one_line({"rooms": {"true": 10, "entered": 0, "recall": float("nan")}})
    assert nowhere == "0 of 10 rooms entered"


def test_a_map_whose_floor_alone_was_moved_is_compared(run: tuple[Path, dict[str, Any]], tmp_path: Path):
    metrics = evaluate_run(open_run(moved_run(run, tmp_path, [0.0, 0.0, -0.8])), workers=1)
    assert metrics["doors"] == run[1]["doors"]
    assert metrics["trajectory"]["unaligned_rmse_m"] == pytest.approx(np.hypot(0.02, 0.8), abs=1e-6)


@pytest.mark.parametrize("origin", [["x", 0, 0], [1.0], {}])
def test_a_damaged_map_origin_is_told(run: tuple[Path, dict[str, Any]], tmp_path: Path, origin: Any):
    with pytest.raises(InputError, match="map_origin"):
        evaluate_run(open_run(moved_run(run, tmp_path, origin)), workers=1)


def test_metrics_json_holds_the_same(run: tuple[Path, dict[str, Any]]):
    folder, metrics = run
    stored = json.loads((folder / "metrics.json").read_text())
    assert stored["doors"] == metrics["doors"]
    assert stored["area"]["wall"] == metrics["area"]["wall"]
    assert stored["area"]["clutter"]["precision"] is None
    assert stored["trajectory"]["relative_translation_rmse_m"] is None


def test_the_tables_print(run: tuple[Path, dict[str, Any]], capsys: pytest.CaptureFixture[str]):
    folder, metrics = run
    print_metrics(metrics)
    printed = capsys.readouterr().out
    assert "99.60" in printed
    assert "1 of 1 passed" in printed
    assert len(format_metrics(json.loads((folder / "metrics.json").read_text()))) == 3


def test_tables_cut_no_word_on_a_narrow_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "80")
    figures = dict.fromkeys(("mean", "standard_deviation", "min", "max"), 123_456.0)
    one = {"precision": 0.99, "recall": 0.98, "error_m": 0.01, "doors_blocked": 150, "doors_passed": 181}
    maps = {name: one | {"precision_without_cabinets": 1.0} for name in MAP_TITLES}
    print_metrics({"statistics": dict.fromkeys(PAPER_STATISTICS, figures), "maps": maps})
    printed = capsys.readouterr().out
    assert "…" not in printed
    assert max(map(len, printed.splitlines())) <= 80
    for word in (
        "milliseconds per cloud",
        "123,456.0",
        "100,538",
        "furniture-free",
        "bottom-most",
        "150 of 181",
        "no cabinets %",
    ):
        assert word in printed


@pytest.mark.parametrize("name", ["in.bag", "in_mcap", "in_sqlite3"])
def test_other_containers_and_two_processes_count_the_same(
    tmp_path: Path, name: str, run: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(counting, "CLOUDS_A_SHARE", 2)
    bag_path, classes = make_truth_bag(tmp_path / name)
    made = make_run(tmp_path / "run", bag_path, classes)
    metrics = evaluate_run(open_run(made), workers=2 if name == "in_mcap" else 1)
    for section in ("area", "area_scan", "points", "points_scan", "doors", "wall_map"):
        assert json.dumps(metrics[section]) == json.dumps(run[1][section])


def test_truth_from_another_bag(tmp_path: Path):
    bare, classes = make_truth_bag(tmp_path / "bare.bag", with_truth=False)
    made = make_run(tmp_path / "run", bare, classes)
    assert not has_truth(open_run(made))
    with pytest.raises(InputError, match="--truth"):
        evaluate_run(open_run(made), workers=1)
    with_truth, _ = make_truth_bag(tmp_path / "in.bag")
    assert evaluate_run(open_run(made), BagPath((with_truth,)), workers=1)["scans"]["counted"] == SCANS


def test_has_truth(run: tuple[Path, dict[str, Any]]):
    assert has_truth(open_run(run[0]))


def test_a_folder_that_is_no_run(tmp_path: Path):
    with pytest.raises(InputError, match=r"run\.json"):
        evaluate_run(open_run(tmp_path))


def test_a_run_without_labels_has_its_trajectory_compared(tmp_path: Path):
    bag_path, classes = make_truth_bag(tmp_path / "in.bag")
    made = make_run(tmp_path / "run", bag_path, classes)
    (made / "labels.parquet").unlink()
    metrics = evaluate_run(open_run(made), workers=1)
    assert sorted(metrics) == ["missing", "trajectory", "truth"]
    assert metrics["missing"][0].startswith("labels, doors and maps: the run has no labels.parquet")
    assert len(format_metrics(metrics)) == 1


def test_building_and_doors_from_geojson(tmp_path: Path):
    outline = [[0, 0], [0.9, 0], [0.9, 0.04], [0, 0.04], [0, 0]]
    content = {
        "features": [
            feature("wall", [[0, 0], [1, 0], [1, 1]]),
            {
                "properties": {"kind": "wall"},
                "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [0, 1], [0, 0]]]},
            },
            feature("door", [[0, 0], [0.9, 0]], state="open", height=2.1, leaves=[outline, outline]),
            feature("door", [[3, 0], [3.9, 0]], state="closed", height=2.1),
            feature("door", [[6, 0], [6.9, 0]], state="open", height=2.1),
            feature("room", [[0, 0], [1, 0]]),
        ]
    }
    doors, faces = read_building(content)
    assert faces.shape == (5, 2, 2)
    assert [len(leaves) for leaves in doors.leaves] == [8, 1, 0]
    assert doors.state.tolist() == [DoorState.OPEN, DoorState.CLOSED, DoorState.OPEN]
    doors, faces = read_building(None)
    assert (len(doors), faces.shape) == (0, (0, 2, 2))
    write_geojson(tmp_path / "doors.geojson", [])
    assert len(read_doors(tmp_path / "doors.geojson")) == 0


def test_what_has_no_row_was_skipped_by_the_run(tmp_path: Path):
    bag_path, classes = make_truth_bag(tmp_path / "in.bag")
    made = make_run(tmp_path / "run", bag_path, classes)
    rows = [labels for labels, _ in stream_labels(made / "labels.parquet")]
    list(LabelsWriter(made / "labels.parquet").passing(rows[1:]))
    assert evaluate_run(open_run(made), workers=1)["scans"] == {"counted": 5, "skipped": 1, "without_truth": 0}
