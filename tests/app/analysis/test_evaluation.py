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
from ffmap.algorithms.truth.tally import VOXEL_M
from ffmap.app.analysis import counting
from ffmap.app.analysis.evaluation import (
    evaluate_run,
    has_truth,
    read_doors,
)
from ffmap.app.analysis.figures import FIGURES
from ffmap.app.analysis.ground_truth import parse_building
from ffmap.app.analysis.metrics_tables import format_metrics, in_one_line
from ffmap.app.folder.atomic import write_geojson, write_json
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.labels_file import ScanLabels, stream_labels, write_labels
from ffmap.app.folder.map_files import write_grid
from ffmap.loaders.bag import make_typestore
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import read_tum, write_tum
from tests.loaders.bag_builder import (
    PERIOD_NS,
    START_NS,
    cloud,
    odometry,
    point_dtype,
    tf_message,
    write_bag,
)

HEIGHT_M = 1.0
T_BASE_LIDAR = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, HEIGHT_M], [0, 0, 0, 1]])
MOUNT = ("base", "lidar", T_BASE_LIDAR[:3, 3], transforms.quaternion_xyzw(T_BASE_LIDAR))
SCANS = 6
SPEED_MPS = 0.5
DOOR = ((1.0, 2.0), (1.9, 2.0))


def room(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points in the map and their classes: wall and closed door at y = 2, floor, someone, glass."""
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


def make_truth_bag(
    path: Path, with_truth: bool = True, building: str | None = None
) -> tuple[Path, list[np.ndarray]]:
    """Clouds whose firings have their own time while the base drives along x, and their classes."""
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
        points_base = points_map - np.c_[x_m, 0 * x_m, 0 * x_m]
        points_sensor = transforms.apply(transforms.invert(T_BASE_LIDAR), points_base)
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
            message = cloud(true, stamp_ns, ros_version=version)
            entries.append(("/truth/classes", stamp_ns + 2, message))
    if with_truth:
        for k in range(-2, 10 * SCANS + 20):
            stamp_ns = START_NS + k * PERIOD_NS // 10
            position = (SPEED_MPS * k * PERIOD_NS * 1e-10, 0.0, 0.0)
            message = odometry(stamp_ns, position, ros_version=version)
            entries.append(("/truth/pose", stamp_ns, message))
        content = json.dumps(BUILDING) if building is None else building
        text = make_typestore(version).types["std_msgs/msg/String"](content)
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
        labels.append(ScanLabels(i, "/vertical", START_NS + PERIOD_NS * i, label, label_scan))
    places = [[SPEED_MPS * 0.1 * i, 0.02, 0.0] for i in range(SCANS)]
    T_map_base = np.array([transforms.from_yaw(0.0, place) for place in places])
    poses = Trajectory(START_NS + PERIOD_NS * np.arange(SCANS), T_map_base)
    write_labels(folder / "labels.parquet", labels)
    write_tum(folder / "trajectory.tum", poses)
    found = {"state": "open", "width": 0.95, "height": 2.0, "confidence": 1.0, "rooms": None}
    lines = [[[1.05, 2.0], [1.95, 2.0]], [[-5.0, 0.0], [-5.0, 1.0]]]
    sills = [{"type": "LineString", "coordinates": line} for line in lines]
    doors = [{"properties": found, "geometry": sill} for sill in sills]
    write_geojson(folder / "doors.geojson", doors)
    cells = np.full((80, 80), Cell.FREE, np.uint8)
    cells[60, 20:60] = Cell.OCCUPIED  # y = 2.025, x from -1 to 1
    cells[10, :10] = Cell.OCCUPIED
    write_grid(folder / "map.yaml", GridMap(cells, np.array([-2.0, -1.0]), 0.05))
    record = {"bag": {"path": str(bag_path)}, "options": {"vertical": ["/vertical"]}}
    write_json(folder / "run.json", record)
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("evaluate")
    bag_path, classes = make_truth_bag(folder / "in.bag")
    made = make_run(folder / "run", bag_path, classes)
    return made, evaluate_run(open_run(made), workers=1)


def test_labels(run: tuple[Path, dict[str, Any]]) -> None:
    _, metrics = run
    assert [metrics[f"scans.{n}"] for n in ("counted", "skipped", "without_truth")] == [SCANS, 0, 0]
    for label in ("wall", "floor", "door"):
        for by in ("", "points."):
            assert [metrics[f"{by}{label}.{n}"] for n in ("precision", "recall", "f1")] == [1, 1, 1]
    assert metrics["points.wall.right"] == 600 * SCANS
    assert np.isnan(metrics["clutter.precision"])
    confusion = np.array(metrics["points.confusion"]["counts"])
    assert confusion[Truth.GLASS, Label.WALL] == 60 * SCANS
    assert confusion.sum() == (600 + 300 + 600 + 60 + 60) * SCANS
    precision = metrics["points.single_scan.wall.precision"]
    assert precision == pytest.approx(600 * SCANS / (600 * SCANS + 600))
    assert metrics["points.single_scan.floor.recall"] == pytest.approx((SCANS - 1) / SCANS)


def test_every_firing_is_placed_with_the_true_pose_of_its_own_time(
    run: tuple[Path, dict[str, Any]],
) -> None:
    """The wall is 2 m x 1.9 m and one voxel thick: placed wrongly it would have more voxels."""
    voxels = round(run[1]["wall.right_m2"] / VOXEL_M**2)
    walls = [points[truth == Truth.WALL] for points, truth in map(room, range(SCANS))]
    true = np.unique(np.floor(np.concatenate(walls) / VOXEL_M).astype(int), axis=0)
    assert abs(voxels - len(true)) <= 0.02 * len(true)


def test_doors_maps_and_trajectory(run: tuple[Path, dict[str, Any]]) -> None:
    folder, metrics = run
    expected = {
        "doors.true": 2,
        "doors.passed": 1,
        "doors.found_count": 1,
        "doors.recall": 1.0,
        "doors.detections": 2,
        "doors.invented_count": 1,
        "doors.invented": 0.5,
        "doors.width_error_m": pytest.approx(0.05),
        "doors.state_right": 0,
        "maps.furniture_free.true_cells": 40,
        "maps.furniture_free.occupied_cells": 50,
        "maps.furniture_free.precision": 0.8,
        "maps.furniture_free.recall": 1.0,
        "maps.furniture_free.error_m": pytest.approx(0.01),
        "maps.furniture_free.doors_passed": 1,
        "maps.furniture_free.doors_blocked": 0,
        "trajectory.poses": SCANS,
        "trajectory.ate_rmse_m": pytest.approx(0, abs=1e-6),
        "trajectory.unaligned_rmse_m": pytest.approx(0.02, abs=1e-6),
    }
    assert {name: metrics[name] for name in expected} == expected
    assert (folder / "overlay.png").exists()


def test_every_figure_is_described_and_in_the_file(run: tuple[Path, dict[str, Any]]) -> None:
    folder, metrics = run
    numbers = {name for name, value in metrics.items() if isinstance(value, int | float)}
    assert numbers <= FIGURES.keys()
    stored = json.loads((folder / "metrics.json").read_text())
    assert stored.keys() == metrics.keys()
    assert stored["doors.recall"] == metrics["doors.recall"]
    assert stored["clutter.precision"] is stored["trajectory.relative_translation_rmse_m"] is None
    assert len(format_metrics(stored)) == len(format_metrics(metrics)) == 4


def moved_run(run: tuple[Path, dict[str, Any]], tmp_path: Path, origin_m: list[float]) -> Path:
    folder = Path(shutil.copytree(run[0], tmp_path / "moved"))
    record = json.loads((folder / "run.json").read_text())
    write_json(folder / "run.json", {**record, "map_origin": origin_m})
    return folder


FAR_M = [432_123.0, 5_412_346.0, 450.25]


def test_poses_given_far_from_the_origin_are_compared_in_their_own_frame(
    run: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    folder = moved_run(run, tmp_path, FAR_M)
    poses = read_tum(folder / "trajectory.tum")
    true = tmp_path / "true.tum"
    write_tum(true, poses.moved(transforms.make_transform(translation=FAR_M)))
    metrics = evaluate_run(open_run(folder), BagPath((true,)), workers=1)
    assert metrics["trajectory.unaligned_max_m"] < 1e-3
    assert metrics["trajectory.ate_rmse_m"] < 1e-3


def test_what_is_in_another_frame_is_not_compared(
    run: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    folder = moved_run(run, tmp_path, FAR_M)
    metrics = evaluate_run(open_run(folder), workers=1)
    assert not [name for name in metrics if name.startswith(("doors", "maps", "rooms"))]
    assert np.isnan(metrics["trajectory.unaligned_rmse_m"])
    assert metrics["trajectory.ate_rmse_m"] == pytest.approx(0, abs=1e-6)
    assert metrics["wall.f1"] == run[1]["wall.f1"]
    line = in_one_line(metrics)
    assert "not compared: unaligned poses: the run's are 5429.6 km from the true ones" in line
    assert "not compared: doors, maps and rooms: the map's origin is not that of its poses" in line


def test_a_map_whose_floor_alone_was_moved_is_compared(
    run: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    metrics = evaluate_run(open_run(moved_run(run, tmp_path, [0.0, 0.0, -0.8])), workers=1)
    assert metrics["doors.recall"] == run[1]["doors.recall"]
    expected = pytest.approx(np.hypot(0.02, 0.8), abs=1e-6)
    assert metrics["trajectory.unaligned_rmse_m"] == expected


def test_the_closing_line_counts_what_the_robot_entered_and_saw() -> None:
    doors = {"true": 12, "passed": 5, "found_count": 4, "invented_count": 0}
    rooms = {"true": 10, "entered": 1, "recall": 0.99349}
    metrics = {f"doors.{name}": value for name, value in doors.items()}
    metrics |= {f"rooms.furniture_free.{name}": value for name, value in rooms.items()}
    assert in_one_line(metrics) == (
        "4 of 5 doors found (7 more not passed), 0 invented, "
        "1 of 10 rooms entered, recalled to 99.35 %"
    )
    metrics |= {"rooms.furniture_free.entered": 0, "rooms.furniture_free.recall": float("nan")}
    assert in_one_line(metrics).endswith("0 invented, 0 of 10 rooms entered")


def test_another_container_and_two_processes_count_the_same(
    tmp_path: Path, run: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(counting, "CLOUDS_PER_JOB", 2)
    bag_path, classes = make_truth_bag(tmp_path / "in_mcap")
    made = make_run(tmp_path / "run", bag_path, classes)
    metrics = evaluate_run(open_run(made), workers=2) | {"truth": run[1]["truth"]}
    assert json.dumps(metrics) == json.dumps(run[1])


def test_ground_truth_from_another_bag(run: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    assert has_truth(open_run(run[0]))
    bare, classes = make_truth_bag(tmp_path / "bare.bag", with_truth=False)
    made = open_run(make_run(tmp_path / "run", bare, classes))
    assert not has_truth(made)
    with pytest.raises(InputError, match="--truth"):
        evaluate_run(made, workers=1)
    with_truth, _ = make_truth_bag(tmp_path / "in.bag")
    assert evaluate_run(made, BagPath((with_truth,)), workers=1)["scans.counted"] == SCANS


def test_truth_of_another_drive_leaves_the_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag_path, classes = make_truth_bag(tmp_path / "in.bag")
    made = make_run(tmp_path / "run", bag_path, classes)
    evaluate_run(open_run(made), workers=1)
    figures = (made / "metrics.json").read_bytes()
    monkeypatch.setitem(globals(), "START_NS", START_NS + 7_000_000)
    other, _ = make_truth_bag(tmp_path / "other.bag")
    with pytest.raises(InputError, match="truth of the same drive"):
        evaluate_run(open_run(made), BagPath((other,)), workers=1)
    assert (made / "metrics.json").read_bytes() == figures


def test_a_run_without_labels_or_with_a_scan_skipped(tmp_path: Path) -> None:
    bag_path, classes = make_truth_bag(tmp_path / "in.bag")
    made = make_run(tmp_path / "run", bag_path, classes)
    rows = list(stream_labels(made / "labels.parquet"))
    write_labels(made / "labels.parquet", rows[1:])
    metrics = evaluate_run(open_run(made), workers=1)
    assert (metrics["scans.counted"], metrics["scans.skipped"]) == (SCANS - 1, 1)
    (made / "labels.parquet").unlink()
    metrics = evaluate_run(open_run(made), workers=1)
    assert all(name.startswith(("trajectory.", "missing", "truth")) for name in metrics)
    expected = "labels, doors and maps: the run has no labels.parquet, it is unknown"
    assert expected in metrics["missing"]


def test_building_and_doors_from_geojson(tmp_path: Path) -> None:
    outline = [[0, 0], [0.9, 0], [0.9, 0.04], [0, 0.04], [0, 0]]
    triangle = {"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [0, 1], [0, 0]]]}
    building = parse_building(
        {
            "features": [
                feature("wall", [[0, 0], [1, 0], [1, 1]]),
                {"properties": {"kind": "wall"}, "geometry": triangle},
                feature("door", [[0, 0], [0.9, 0]], state="open", leaves=[outline, outline]),
                feature("door", [[3, 0], [3.9, 0]], state="closed", height=2.1),
                feature("door", [[6, 0], [6.9, 0]], state="open", wall_thickness=0.1),
                {"properties": {"kind": "room", "name": "lab"}, "geometry": triangle},
            ]
        }
    )
    doors = building.doors
    assert building.faces.shape == (5, 2, 2)
    assert [len(leaves) for leaves in doors.leaves] == [8, 1, 0]
    assert doors.state.tolist() == [DoorState.OPEN, DoorState.CLOSED, DoorState.OPEN]
    assert doors.head_m.tolist() == [2.0, 2.1, 2.0]
    assert building.door_wall_m.tolist() == [0.2, 0.2, 0.1]
    assert (building.room_names, building.rooms[0].area) == (("lab",), 0.5)
    empty = parse_building({"features": []})
    assert (len(empty.doors), empty.faces.shape) == (0, (0, 2, 2))
    write_geojson(tmp_path / "doors.geojson", [])
    assert len(read_doors(tmp_path / "doors.geojson")) == 0
