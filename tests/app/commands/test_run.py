"""The command line as a user meets it: whole runs, resumed runs, and mistakes."""

import errno
import json
import mmap
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from PIL import Image
from rerun.chunk import RrdReader
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from ffmap.algorithms.base.labels import Verdict
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.maps.rivals import Rival
from ffmap.app import cli, pipeline
from ffmap.app.analysis.evaluation import evaluate_run
from ffmap.app.commands import run as run_command
from ffmap.app.folder import names as run_folder
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.names import rooms_file
from ffmap.app.record.errors import LEGEND
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.blueprints import entities
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import (
    FFMAP,
    FFMAP_BEHIND,
    FFMAP_IN_FRONT,
    ffmap,
    ffmap_here,
    kill_once,
    with_cache,
)
from tests.receiver import content, receiving, shown

ROOT = Path(__file__).parents[3]
UPRIGHT_TOPIC = "/horizontal_velodyne/velodyne_points"
FILES = [
    "recording.rrd",
    "evaluation.rrd",
    "run.json",
    "trajectory.tum",
    "cloud.ply",
    "map.yaml",
    "map.pgm",
    *(f"map_{name}.{suffix}" for name in Rival for suffix in ("yaml", "pgm")),
    "floorplan.svg",
    "floorplan.dxf",
    "overlay.png",
    "walls.geojson",
    "doors.geojson",
    "rooms.geojson",
    "metrics.json",
]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return {**with_cache(tmp_path_factory.mktemp("cache")), "COLUMNS": "200"}


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same drive in each container."""
    folder = tmp_path_factory.mktemp("bags")
    paths = {}
    for container, name in (("bag", "drive.bag"), ("mcap", "drive_mcap"), ("db3", "drive_db3")):
        paths[container] = folder / name
        values = {"building": "small", "seed": 3, "sensor": "vlp16", "format": container, "duration_s": 3.0}
        simulate(paths[container], SimulationSettings.model_validate(values))
    return paths


@pytest.fixture(scope="module")
def finished_as_said(
    bags: dict[str, Path], environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """A run on the ROS 1 bag, and what it said."""
    out = tmp_path_factory.mktemp("runs") / "whole"
    done = ffmap(environment, "run", bags["bag"], "--out", out, "--outputs", "+labelled-bag")
    assert done.returncode == 0, done.stderr
    return out, done


@pytest.fixture(scope="module")
def finished(finished_as_said: tuple[Path, subprocess.CompletedProcess[str]]) -> Path:
    """A run on the ROS 1 bag."""
    return finished_as_said[0]


def labels_of(run: Path) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Stamp, label and label_scan of every cloud of the labelled bag, read with rosbags."""
    path = run / "labelled.bag" if (run / "labelled.bag").exists() else run / "labelled"
    clouds = []
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.msgtype == "sensor_msgs/msg/PointCloud2"]
        for connection, _, raw in reader.messages(connections):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            points = np.asarray(message.data).reshape(-1, message.point_step)
            offsets = {field.name: field.offset for field in message.fields}
            clouds.append((stamp, points[:, offsets["label"]].copy(), points[:, offsets["label_scan"]].copy()))
    return clouds


def assert_same_labels(run: Path, other: Path) -> None:
    ours, theirs = labels_of(run), labels_of(other)
    assert len(ours) == len(theirs) > 0
    for (stamp, label, label_scan), (other_stamp, other_label, other_label_scan) in zip(ours, theirs, strict=True):
        assert stamp == other_stamp
        np.testing.assert_array_equal(label, other_label)
        np.testing.assert_array_equal(label_scan, other_label_scan)


def assert_one_line_error(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    for word in words:
        assert word in done.stderr


def write_empty_clouds(path: Path) -> Path:
    """A bag whose only lidar never sees anything: clouds without points, and clouds of NaN."""
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    fields = [types["sensor_msgs/msg/PointField"](name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
    with Writer(path) as writer:
        connection = writer.add_connection("/points", "sensor_msgs/msg/PointCloud2", typestore=store)
        for k in range(6):
            points = np.full((20 * (k % 2), 3), np.nan, np.float32)
            stamp = types["builtin_interfaces/msg/Time"](1000, k * 100_000_000)
            cloud = types["sensor_msgs/msg/PointCloud2"](
                types["std_msgs/msg/Header"](k, stamp, "lidar"),
                1,
                len(points),
                fields,
                False,
                12,
                12 * len(points),
                points.view(np.uint8).reshape(-1),
                False,
            )
            writer.write(connection, 10**12 + k * 10**8, store.serialize_ros1(cloud, "sensor_msgs/msg/PointCloud2"))
    return path


def said_at_the_end(done: subprocess.CompletedProcess[str]) -> dict[str, str]:
    return {name: text.strip() for name, text in (line.split(":", 1) for line in done.stdout.splitlines())}


def test_five_lines_tell_of_a_finished_run(finished_as_said: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, done = finished_as_said
    record, metrics = (json.loads((out / name).read_text()) for name in ("run.json", "metrics.json"))
    said = said_at_the_end(done)
    assert list(said) == ["made", "quality", "results", "look", "warnings"]
    counts = record["counts"]
    assert f"{counts['scans']} of {counts['clouds']} scans" in said["made"]
    assert f"{counts['doors']} doors, {counts['rooms']} rooms" in said["made"]
    assert f"wall F1 {100 * metrics['wall.f1']:.2f} %" in said["quality"]
    assert str(out / "metrics.json") in said["quality"]
    assert said["results"] == str(out)
    assert said["look"].endswith(str(out))
    assert said["warnings"] == "none"


def test_truth_that_cannot_be_compared_with_is_not_said_to_be_absent(
    bags: dict[str, Path],
    environment: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def damaged(*_: object) -> None:
        raise InputError("the truth is damaged")

    monkeypatch.setenv("FFMAP_CACHE", environment["FFMAP_CACHE"])
    monkeypatch.setattr(run_command, "_evaluate", damaged)
    options = RunOptions(detail="map", outputs=("labels",), workers=1)
    with pytest.raises(InputError, match="the truth is damaged"):
        run_command.run(BagPath((bags["bag"],)), Settings(), options, out=tmp_path / "run")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 5
    assert "the evaluation failed" in lines[1]


def test_tables_come_when_asked_for_and_warnings_are_counted(
    bags: dict[str, Path], environment: dict[str, str], tmp_path: Path
) -> None:
    whole = bags["bag"].read_bytes()
    cut = tmp_path / "cut.bag"
    cut.write_bytes(whole[: int(0.9 * len(whole))])
    options = ("--outputs", "maps", "--workers", "1")
    tables = ffmap_here(environment, "run", cut, "--out", tmp_path / "a", *options, "-v")
    assert tables.returncode == 0, tables.stderr
    assert "ATE RMSE" in tables.stdout
    warnings = json.loads((tmp_path / "a" / "run.json").read_text())["warnings"]
    last = tables.stdout.splitlines()[-5:]
    assert [line.split(":")[0] for line in last] == ["made", "quality", "results", "look", "warnings"]
    assert last[-1].split()[1] == f"{len(warnings)},"
    assert last[-1].endswith(warnings[0])
    assert "not compared: labels" in last[1]
    said = said_at_the_end(ffmap_here(environment, "run", cut, "--out", tmp_path / "b", *options, "--no-evaluate"))
    assert "--no-evaluate" in said["quality"]
    assert not ffmap_here(environment, "run", cut, "--out", tmp_path / "c", *options, "--no-evaluate", "--quiet").stdout


def test_rooms_doors_topology_and_recording_tell_the_same(finished: Path) -> None:
    rooms = [f["properties"] for f in json.loads((finished / "rooms.geojson").read_text())["features"]]
    doors = [f["properties"] for f in json.loads((finished / "doors.geojson").read_text())["features"]]
    record = json.loads((finished / "run.json").read_text())
    topology = record["topology"]
    assert len(rooms) == record["counts"]["rooms"] == len(topology["rooms"]) > 0
    assert [room["name"] for room in rooms] == [room["name"] for room in topology["rooms"]]
    for room in rooms:
        for door in room["doors"]:
            assert room["name"] in doors[door]["rooms"]
        assert {name for p in topology["passages"] if room["name"] in p["rooms"] for name in p["rooms"]} - {
            room["name"]
        } == set(room["neighbours"])
    joined = [door for door in doors if door["rooms"] and None not in door["rooms"] and len(set(door["rooms"])) == 2]
    assert len(joined) == sum(passage["door"] is not None for passage in topology["passages"])
    assert any(door["rooms"] for door in doors)
    paths = {str(chunk.entity_path) for chunk in RrdReader(finished / "recording.rrd").stream()}
    assert {
        "/world/rooms/floors",
        "/world/rooms/names",
        "/rooms/graph",
    } <= paths
    metrics = json.loads((finished / "metrics.json").read_text())
    assert metrics["rooms.furniture_free.found"] == len(rooms)
    assert metrics["rooms.furniture_free.precision"] > 0.8
    # Beside them, as in Fig. 10, the rooms of the normal map, with and without alpha removal.
    for name in Segmented:
        file = json.loads((finished / rooms_file(name)).read_text())
        assert metrics[f"rooms.{name}.found"] == len(file["features"])
        if name != Segmented.FURNITURE_FREE:
            assert f"{entities.ROOMS_COMPARED}/{name}/passages" in paths


def test_every_file_can_be_read_by_something_else(finished: Path, environment: dict[str, str]) -> None:
    assert all((finished / name).exists() for name in FILES)
    assert not list(finished.rglob("*.part"))
    record = json.loads((finished / "run.json").read_text())
    assert record["outcome"] == "complete"
    assert record["counts"]["scans"] == len(labels_of(finished))
    meta = yaml.safe_load((finished / "map.yaml").read_text())
    with Image.open(finished / meta["image"]) as image:
        assert set(np.unique(np.asarray(image))) <= {0, 205, 254}
    trajectory = np.loadtxt(finished / "trajectory.tum")
    assert trajectory.shape == (record["counts"]["scans"], 8)
    evo = Path(sys.executable).parent / "evo_traj"
    if evo.exists():
        done = subprocess.run(
            [evo, "tum", finished / "trajectory.tum"], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
    for name in ("recording.rrd", "evaluation.rrd"):
        rerun = Path(sys.executable).parent / "rerun"
        done = subprocess.run([rerun, "rrd", "verify", finished / name], capture_output=True, check=False)
        assert done.returncode == 0, name
    walls = json.loads((finished / "walls.geojson").read_text())
    assert walls["features"]
    metrics = json.loads((finished / "metrics.json").read_text())
    assert 0.5 < metrics["floor.f1"] <= 1.0


def test_errors_are_a_layer_of_the_recording(finished: Path) -> None:
    record = json.loads((finished / "run.json").read_text())
    metrics = json.loads((finished / "metrics.json").read_text())
    reader = RrdReader(finished / "evaluation.rrd")
    assert {entry.recording_id for entry in reader.recordings()} == {record["recording_id"]}
    chunks = [(chunk.entity_path, chunk.to_record_batch()) for chunk in reader.stream()]
    verdicts: dict[int, np.ndarray] = {}
    for path, rows in chunks:
        if path == entities.POINTS:
            for scan, colors in zip(
                rows.column("scan").to_pylist(), rows.column(entities.POINT_VERDICT_COLOR).to_pylist(), strict=True
            ):
                verdicts[scan] = np.array(colors)
    assert len(verdicts) == record["counts"]["scans"]
    red, green, blue = entities.VERDICTS[Verdict.FALSE_WALL][1]
    false_walls = sum(
        int(np.count_nonzero(c == (red << 24 | green << 16 | blue << 8 | 255))) for c in verdicts.values()
    )
    assert false_walls == metrics["points.wall.wrong"] > 0
    assert metrics["points_in_cloud.max"] >= max(map(len, verdicts.values()))
    static = {path: rows for path, rows in chunks if "scan" not in rows.schema.names}
    entries = static["/legend/errors/names"].column("Points2D:labels").to_pylist()[0]
    assert entries == [name for name, _ in LEGEND]
    # From above, a door's upright frame would be a slab.
    sills = static["/world/truth/door_sills"].column("LineStrips3D:strips").to_pylist()[0]
    assert {len({round(float(point[2]), 3) for point in sill}) for sill in sills} == {1}
    assert len(sills) == len(static["/world/truth/doors"].column("LineStrips3D:strips").to_pylist()[0])
    # Of what is logged once in both files, the viewer takes either: nothing but the layouts may be in both.
    recorded = {c.entity_path for c in RrdReader(finished / "recording.rrd").stream() if c.is_static}
    assert not {path for path in static if not path.startswith("/__properties")} & recorded
    assert all(len(RrdReader(finished / name).blueprints()) for name in ("recording.rrd", "evaluation.rrd"))
    # One verdict for each return, in the order of the recorded points.
    for scan, (_, label, _) in enumerate(labels_of(finished)):
        assert len(verdicts[scan]) == np.count_nonzero(label != 255)


def test_what_odometry_measured_lies_on_the_timeline_that_opens(finished: Path) -> None:
    record = json.loads((finished / "run.json").read_text())
    chunks = RrdReader(finished / "recording.rrd").stream().collect()
    for name in ("weak", "refined_inlier_share", "weakest_share", "threshold_m"):
        path = f"/metrics/registration/{name}"
        found = chunks.stream().filter(content=path).collect().reader(index=entities.SCAN_TIMELINE).to_pandas()
        assert len(found) > 0.8 * record["counts"]["registrations"]
        assert 0 <= found["scan"].min() <= found["scan"].max() < record["counts"]["clouds"]


@pytest.mark.parametrize("container", ["mcap", "db3"])
def test_every_container_gives_the_same_labels(
    container: str, bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    options = ("--no-evaluate", "--detail", "map", "--workers", "1", "--outputs", "labelled-bag")
    done = ffmap_here(environment, "run", bags[container], "--out", tmp_path / "run", *options)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "labelled").is_dir()
    assert_same_labels(tmp_path / "run", finished)


def test_killed_run_is_resumed_with_the_same_labels(
    bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    out, bag = tmp_path / "killed", Path(shutil.copy(bags["bag"], tmp_path))
    words = ("run", bag, "--out", out, "--no-evaluate", "--outputs", "labelled-bag")
    kill_once(environment, lambda: list(out.glob("spool/*.arrow")), *words)
    record = json.loads((out / "run.json").read_text())
    assert record["outcome"] == "running"
    for options in ({"outputs": 3}, {"rig": 5}, {"time_from": "never"}):
        (out / "run.json").write_text(json.dumps(record | {"options": record["options"] | options}))
        assert_one_line_error(ffmap_here(environment, "run", "--resume", out), "run.json")
    by_another = record | {"versions": record["versions"] | {"git_revision": "0123456789ab"}}
    (out / "run.json").write_text(json.dumps(by_another))
    assert_one_line_error(ffmap_here(environment, "run", "--resume", out), "another version")
    (out / "run.json").write_text(json.dumps(record))
    flip_a_bit(bag, UPRIGHT_TOPIC.replace("horizontal", "vertical"), 3)
    assert_one_line_error(ffmap_here(environment, "run", "--resume", out), "not the bag", "start a new run")
    shutil.copy(bags["bag"], bag)
    done = ffmap(environment, "run", "--resume", out)
    assert done.returncode == 0, done.stderr
    assert json.loads((out / "run.json").read_text())["outcome"] == "complete"
    assert_same_labels(out, finished)
    assert "complete already" in ffmap_here(environment, "run", "--resume", out).stdout


def test_run_is_not_gone_on_with_on_other_poses(
    bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    poses, out = Path(shutil.copy(finished / "trajectory.tum", tmp_path)), tmp_path / "run"
    options = ("--trajectory", poses, "--no-evaluate", "--outputs", "labels", "--workers", "1")
    assert ffmap_here(environment, "run", bags["bag"], "--out", out, *options).returncode == 0
    record = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(record | {"outcome": "aborted"}))
    lines = poses.read_text().splitlines()
    poses.write_text("\n".join(lines[:-1]))
    assert_one_line_error(
        ffmap_here(environment, "run", "--resume", out), "trajectory.tum", "is not what", "start a new run"
    )
    poses.unlink()
    assert_one_line_error(ffmap_here(environment, "run", "--resume", out), "trajectory.tum", "or is missing")


def flip_a_bit(bag: Path, topic: str, cloud: int) -> None:
    """In the middle of a cloud's points, with size, index and times of the file as they were."""
    with Reader(bag) as reader:
        wanted = [c for c in reader.connections if c.topic == topic]
        data = [bytes(data) for _, _, data in reader.messages(wanted)][cloud]
    with bag.open("r+b") as file:
        found = mmap.mmap(file.fileno(), 0)
        found[found.find(data) + len(data) // 2] ^= 4
        found.close()


@pytest.mark.parametrize("lidar", ["horizontal", "vertical"])
def test_bag_that_differs_in_one_bit_shares_nothing(
    lidar: str, bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    other = Path(shutil.copy2(bags["bag"], tmp_path))
    flip_a_bit(other, UPRIGHT_TOPIC.replace("horizontal", lidar), 15)
    options = ("--outputs", "labels", "--no-evaluate", "--workers", "1")
    done = ffmap_here(environment, "run", other, "--out", tmp_path / "run", *options)
    assert done.returncode == 0, done.stderr
    record, before = (json.loads((run / "run.json").read_text()) for run in (tmp_path / "run", finished))
    assert not record["odometry_cached"]
    assert record["bag"]["digest"] != before["bag"]["digest"]
    done = ffmap_here(environment, "inspect", finished, "--scan", "3", "--bag", other, "--out", tmp_path / "scan.rrd")
    assert_one_line_error(done, other.name, "is not the bag")


def test_cut_bag_is_processed_up_to_the_cut(bags: dict[str, Path], environment: dict[str, str], tmp_path: Path) -> None:
    whole = bags["bag"].read_bytes()
    cut = tmp_path / "cut.bag"
    cut.write_bytes(whole[: int(0.7 * len(whole))])
    done = ffmap_here(environment, "run", cut, "--out", tmp_path / "run", "--no-evaluate", "--detail", "map")
    assert done.returncode == 0, done.stderr
    assert "warning" in done.stderr
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert 10 < record["counts"]["scans"] < 30
    assert record["warnings"]


def test_mistakes_are_one_line_and_leave_earlier_results_alone(
    bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in finished.iterdir()}
    missing = tmp_path / "none.bag"
    assert_one_line_error(ffmap_here(environment, "run", missing, "--out", finished), "none.bag")
    text = tmp_path / "text.bag"
    text.write_text("this is no bag\n")
    assert_one_line_error(ffmap_here(environment, "run", text, "--out", finished), "text.bag")
    assert_one_line_error(ffmap_here(environment, "info", text), "text.bag")
    done = ffmap_here(environment, "run", bags["bag"], "--out", finished, "--set", "wall_planes.similarty_m=0.05")
    assert_one_line_error(done, "similarty_m", "wall_planes.similarity_m")
    done = ffmap_here(environment, "run", bags["bag"], "--out", finished, "--vertical", "/nothing")
    assert_one_line_error(done, "/nothing")
    assert_one_line_error(ffmap_here(environment, "run", "--resume", tmp_path), "run.json")
    assert_one_line_error(ffmap_here(environment, "evaluate", tmp_path), str(tmp_path))
    dead = "rerun+http://127.0.0.1:1/proxy"
    done = ffmap_here(environment, "run", bags["bag"], "--out", finished, "--overwrite", "--connect", dead)
    assert_one_line_error(done, "--connect", "127.0.0.1:1")
    assert_one_line_error(ffmap_here(environment, "run", bags["bag"], "--out", finished), "finished run", "--overwrite")
    assert_one_line_error(ffmap_here(environment, "run", "--resume", finished, "--overwrite"), "--resume")
    nothing = write_empty_clouds(tmp_path / "nothing.bag")
    done = ffmap_here(environment, "run", nothing, "--out", finished)
    assert done.returncode == 2
    assert "no usable cloud" in done.stderr
    assert {path.name: path.stat().st_mtime_ns for path in finished.iterdir()} == before


def test_folder_that_cannot_be_written_is_named(
    bags: dict[str, Path], environment: dict[str, str], tmp_path: Path
) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("")
    assert_one_line_error(ffmap_here(environment, "run", bags["bag"], "--out", blocker / "run"), str(blocker))
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("mine")
    assert_one_line_error(ffmap_here(environment, "run", bags["bag"], "--out", foreign), "foreign")
    assert (foreign / "thesis.tex").read_text() == "mine"


def test_little_free_space_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.shutil, "disk_usage", lambda _: SimpleNamespace(free=1_900_000_000))
    assert "only 1.9 GB are free" in pipeline._little_space(tmp_path)[0]
    monkeypatch.setattr(pipeline.shutil, "disk_usage", lambda _: SimpleNamespace(free=2_100_000_000))
    assert pipeline._little_space(tmp_path) == []


def test_full_disk_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fill(**_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(cli, "app", fill)
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith("ffmap: the disk is full")


def test_what_may_not_be_written_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def refuse(**_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", "runs/a/metrics.json")

    monkeypatch.setattr(cli, "app", refuse)
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith(
        "ffmap: runs/a/metrics.json: cannot be read or written (Permission denied)"
    )


def test_evaluation_writes_nothing_to_a_run_that_took_the_place_of_its_own(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = shutil.copytree(finished, tmp_path / "run")
    run, before = open_run(copy), (copy / "metrics.json").read_bytes()
    (copy / "run.json").write_text(json.dumps({**run.record, "recording_id": "another"}))
    with pytest.raises(InputError, match="another run has replaced"):
        evaluate_run(run, None, 1)
    assert (copy / "metrics.json").read_bytes() == before


def test_demo_leaves_the_users_bag_alone(environment: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "small.bag").write_text("mine")
    assert_one_line_error(ffmap_here(environment, "demo", "--out", tmp_path), "small.bag", "--out")
    assert (tmp_path / "small.bag").read_text() == "mine"


def test_folders_of_demo_and_evaluation_that_cannot_be_written(
    finished: Path, environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("")
    assert_one_line_error(ffmap_here(environment, "demo", "--out", blocker / "demo"), str(blocker), "--out")

    def refuse(path: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(run_folder, "make_writable", refuse)
    with pytest.raises(InputError, match=r"whole: cannot be written \(Permission denied\)"):
        evaluate_run(open_run(finished))


def test_two_runs_never_write_into_one_folder(
    bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    with (
        run_folder.held(tmp_path),
        pytest.raises(InputError, match="another run is writing there"),
        run_folder.held(tmp_path),
    ):
        pass
    with run_folder.held(tmp_path):  # whoever held it before has let go
        done = ffmap(environment, "run", bags["bag"], "--out", tmp_path)
        assert_one_line_error(done, str(tmp_path), "another run")
    copy = shutil.copytree(finished, tmp_path / "run")
    with run_folder.held(copy):
        done = ffmap_here(environment, "run", bags["bag"], "--out", copy, "--overwrite")
        assert_one_line_error(done, str(copy), "another run")
        assert_one_line_error(ffmap_here(environment, "run", "--resume", copy), str(copy), "another run")
    assert (copy / "recording.rrd").exists()


def test_run_is_replaced_where_the_user_says_so(
    bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    copy = shutil.copytree(finished, tmp_path / "run")
    (copy / "notes.txt").write_text("mine")
    options = ("--overwrite", "--outputs", "maps", "--no-evaluate", "--workers", "1")
    # Not by one that reads it, as a drive labelled before.
    own = ("--trajectory", copy / "trajectory.tum")
    assert_one_line_error(
        ffmap_here(environment, "run", copy / "labelled.bag", "--out", copy, *options, *own), "labelled.bag"
    )
    assert_one_line_error(ffmap_here(environment, "run", bags["bag"], "--out", copy, *options, *own), "trajectory.tum")
    assert (copy / "labelled.bag").exists()
    done = ffmap_here(environment, "run", bags["bag"], "--out", copy, *options)
    assert done.returncode == 0, done.stderr
    maps = [f"{name}.{suffix}" for name in ("map", *(f"map_{rival}" for rival in Rival)) for suffix in ("yaml", "pgm")]
    assert {path.name for path in copy.iterdir()} == {"notes.txt", "run.json", "trajectory.tum", *maps}
    record = json.loads((copy / "run.json").read_text())
    assert set(record["files"]) == {"run.json", "trajectory.tum", *maps}


@pytest.mark.parametrize("stage", ["odometry", "scans", "final"])
def test_interruption_is_one_line_that_says_how_to_go_on(
    stage: str, bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    # The stage before it has ended, or the run's folder is there.
    out, before = tmp_path / "run", {"odometry": "", "scans": "odometry:", "final": "building:"}[stage]
    cold = {"FFMAP_CACHE": str(tmp_path)} if stage == "odometry" else {}
    process = subprocess.Popen(
        [*FFMAP_IN_FRONT, "run", str(bags["bag"]), "--out", str(out), "--workers", "2", "--no-evaluate"],
        env={**environment, **cold},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stderr is not None
    said: list[str] = []
    while before and not (said and said[-1].startswith(before)):
        said.append(process.stderr.readline())
        assert said[-1]
    end = time.monotonic() + 120
    while not (out / "run.json").exists() and time.monotonic() < end:
        time.sleep(0.02)
    if not before:
        time.sleep(0.3)  # until scans are registered; a later stage may be over by then
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to the workers too
    said += process.communicate(timeout=60)[1].splitlines(keepends=True)
    assert process.returncode == 130
    assert said[-1] == f"ffmap: interrupted; 'ffmap run --resume {out}' continues the run\n"
    assert all(line.split(":")[0].split(" of ")[0] in ("odometry", "scans", "building", "final") for line in said[:-1]), said
    assert json.loads((out / "run.json").read_text())["outcome"] == "aborted"


def test_a_run_in_the_background_is_not_interrupted(
    bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "run"
    process = subprocess.Popen(
        [*FFMAP_BEHIND, "run", str(bags["bag"]), "--out", str(out), "--workers", "2", "--no-evaluate", "--outputs", "maps"],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    end = time.monotonic() + 120
    while not (out / "run.json").exists() and time.monotonic() < end:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=120)[1]
    assert process.returncode == 0, said
    assert json.loads((out / "run.json").read_text())["outcome"] == "complete"


def test_a_viewer_receives_the_whole_run(bags: dict[str, Path], environment: dict[str, str], tmp_path: Path) -> None:
    with receiving(tmp_path / "seen.rrd") as viewer:
        words = ("--outputs", "recording,maps", "--no-evaluate", "--connect", viewer.url)
        done = ffmap_here(environment, "run", bags["bag"], "--out", tmp_path / "a", *words)
        assert done.returncode == 0, done.stderr
        assert viewer.holds(tmp_path / "a" / "recording.rrd")
        assert "Odometry's map; the labelled map follows" not in shown(viewer.path)
    scans = json.loads((tmp_path / "a" / "run.json").read_text())["counts"]["scans"]
    assert content(viewer.path)[0][entities.POINTS, entities.SCAN_TIMELINE] >= scans > 0


def test_viewer_that_ends_is_one_line_and_no_run_goes_on(
    bags: dict[str, Path], environment: dict[str, str], tmp_path: Path
) -> None:
    blind = {name: value for name, value in environment.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = ffmap_here(blind, "run", bags["bag"], "--out", tmp_path / "a", "--spawn")
    assert_one_line_error(done, "--spawn", "display")
    assert not (tmp_path / "a" / "run.json").exists()


def test_viewer_that_ends_before_the_recording_begins_aborts_the_run(
    bags: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ffmap.app.run.start.check_viewer", lambda url: None)
    options = RunOptions(connect="rerun+http://127.0.0.1:1/proxy", workers=1, quiet=True)
    with pytest.raises(InputError, match="the viewer has ended"):
        run_command.run(BagPath((bags["bag"],)), Settings(), options, out=tmp_path / "a")
    assert json.loads((tmp_path / "a" / "run.json").read_text())["outcome"] == "aborted"


def test_mistakes_in_options_are_one_line(environment: dict[str, str]) -> None:
    for words, named in (
        (("run", "a.bag", "--nope"), "--nope"),
        (("rum",), "rum"),
        (("inspect",), "RUN"),
        (("run", "a.bag", "--workers", "0"), "--workers"),
        (("run", "a.bag", "--time-from", "sun"), "azimuth"),
    ):
        assert_one_line_error(ffmap_here(environment, *words), "ffmap: ", named, "--help")


def test_version_and_help(environment: dict[str, str]) -> None:
    done = ffmap_here(environment, "--version")
    assert done.returncode == 0
    assert done.stdout.startswith("ffmap 0.")
    assert "--overwrite" in ffmap_here(environment, "run", "--help").stdout
    assert "simulate" in ffmap_here(environment).stdout


def test_odometry_from_the_cache_is_told(
    bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    options = ("--outputs", "maps", "--no-evaluate", "--workers", "1")
    done = ffmap_here(environment, "run", bags["bag"], "--out", tmp_path / "a", *options)
    cache = Path(environment["FFMAP_CACHE"]) / "odometry"
    assert f"odometry: read from the cache in {cache}; set FFMAP_CACHE" in done.stderr


def test_help_may_be_read_in_part(environment: dict[str, str]) -> None:
    """By grep -q, in a script that ends where a program of a pipe fails."""
    with subprocess.Popen([*FFMAP, "run", "--help"], env=environment, stdout=subprocess.PIPE, bufsize=0) as process:
        assert process.stdout is not None
        assert process.stdout.read(1)
        process.stdout.close()
        assert process.wait() == 0


def test_hints_name_what_helps(environment: dict[str, str], finished: Path, tmp_path: Path) -> None:
    for setting, words in {
        "doors=3": ("'doors' is a group of settings", "doors.recess_min_m"),
        "wall_planes.similarity_m=nan": ("no finite number",),
        "wall_plane.similarity_m=0.1": ("'wall_planes.similarity_m'",),
    }.items():
        assert_one_line_error(ffmap_here(environment, "settings", "--set", setting), *words)
    done = ffmap_here(environment, "settings", "--set", "wall_planes.nope=1")
    assert_one_line_error(done, "wall_planes.nope", "'ffmap settings'")
    assert "did you mean" not in done.stderr
    done = ffmap_here(environment, "simulate", tmp_path / "a.bag", "--building", "foo")
    assert_one_line_error(done, "there are office")
    assert "noise_m" not in done.stderr
    done = ffmap_here(environment, "simulate", tmp_path / "a.bag", "--set", "clutter=7")
    assert_one_line_error(done, "less than or equal to 1")
    assert "noise_m" not in done.stderr
    assert "angled" in ffmap_here(environment, "simulate", "--help").stdout
    assert_one_line_error(ffmap_here(environment, "rooms", finished / "doors.geojson"), "doors.geojson: is no map")
    assert_one_line_error(ffmap_here(environment, "rooms", finished / "map.yaml", "--resolution", "50"), "--resolution 50")


def test_evaluation_of_nothing_is_refused(
    bags: dict[str, Path], finished: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    aborted = tmp_path / "aborted"
    aborted.mkdir()
    record = json.loads((finished / "run.json").read_text())
    (aborted / "run.json").write_text(json.dumps({**record, "outcome": "aborted"}))
    assert_one_line_error(ffmap_here(environment, "evaluate", aborted), "aborted", "--resume")
    assert not (aborted / "metrics.json").exists()
    copy = shutil.copytree(finished, tmp_path / "run")
    poses = [line.split() for line in (copy / "trajectory.tum").read_text().splitlines()]
    later, moved = tmp_path / "later.tum", tmp_path / "true.tum"
    later.write_text("".join(" ".join([f"2{p[0][1:]}", *p[1:]]) + "\n" for p in poses))
    moved.write_text("".join(" ".join([p[0], str(float(p[1]) + 1.0), *p[2:]]) + "\n" for p in poses))
    before = (copy / "metrics.json").read_bytes()
    assert_one_line_error(ffmap_here(environment, "evaluate", copy, "--truth", later), "later.tum", "same drive")
    assert (copy / "metrics.json").read_bytes() == before
    done = ffmap(environment, "evaluate", copy, "--truth", moved)
    assert done.returncode == 0, done.stderr
    assert "not compared: labels, doors, maps and rooms: the truth has poses alone" in done.stdout
    figures = json.loads((copy / "metrics.json").read_text())
    assert figures["trajectory.ate_rmse_m"] < 1e-6 < figures["trajectory.unaligned_rmse_m"]
    (copy / "doors.geojson").unlink()
    done = ffmap_here(environment, "evaluate", copy)
    assert "not compared: doors: the run has no doors.geojson; --outputs with geojson writes it" in done.stdout


def test_info_and_run_say_the_same_of_mistakes(
    bags: dict[str, Path], environment: dict[str, str], tmp_path: Path
) -> None:
    cut, rig = tmp_path / "cut.bag", tmp_path / "rig.toml"
    cut.write_bytes(bags["bag"].read_bytes()[:1000])
    said = f"{cut}: the bag is empty, it has no messages; record it again"
    assert said in ffmap_here(environment, "info", cut).stdout
    assert_one_line_error(ffmap_here(environment, "run", cut), said)
    assert "(medians of several clouds); the first has 1 x" in ffmap_here(environment, "info", bags["bag"]).stdout
    rig.write_text("[[lidar]]\n")
    for option, value in (("--horizontal", "/nope"), ("--vertical", "/nope"), ("--rig", rig)):
        info, run = (ffmap_here(environment, command, bags["bag"], option, value) for command in ("info", "run"))
        assert_one_line_error(info, str(value))
        assert info.stderr == run.stderr


def test_settings_round_trip(environment: dict[str, str], tmp_path: Path) -> None:
    shown = ffmap_here(environment, "settings", "--set", "doors.recess_min_m=0.03")
    assert shown.returncode == 0
    file = tmp_path / "mine.toml"
    file.write_text(shown.stdout)
    assert ffmap_here(environment, "settings", "--config", file).stdout == shown.stdout
    assert "recess_min_m = 0.03" in shown.stdout


def test_real_lidar_gives_a_trajectory_and_nothing_to_label(environment: dict[str, str], tmp_path: Path) -> None:
    data = os.environ.get("FFMAP_REAL_DATA")
    if not data:
        pytest.skip("FFMAP_REAL_DATA is not set: no real recordings here")
    bag = Path(data) / "hilti_14.bag"
    shutil.copy(bag, tmp_path / "hilti.bag")
    done = ffmap_here(environment, "run", tmp_path / "hilti.bag", "--out", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert "nothing was labelled" in done.stdout
    found = np.loadtxt(tmp_path / "run" / "trajectory.tum")[:, 1:4]
    given = np.loadtxt(Path(data) / "hilti_14.tum")[:, 1:4]
    # Umeyama's alignment without scale.
    a, b = found - found.mean(axis=0), given - given.mean(axis=0)
    u, _, v = np.linalg.svd(b.T @ a)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v))]) @ v
    assert np.linalg.norm(b - a @ turn.T, axis=1).mean() < 0.06


def test_recordings_are_as_documented(finished: Path) -> None:
    """docs/recording.md has every entity of a recording, and recordings have every entity in it."""
    document = (ROOT / "docs" / "recording.md").read_text("utf-8")
    of_evaluation = document.index("## Evaluation")
    for name, part in (
        ("recording.rrd", document[:of_evaluation]),
        ("evaluation.rrd", document[of_evaluation:]),
    ):
        documented: dict[str, tuple[set[str], set[str], str]] = {}
        for line in re.findall(r"^\| `/(?!__).*\|$", part, re.MULTILINE):
            entity, _, *schema, by, only_if = (cell.strip() for cell in line[1:-1].split("|"))
            timelines, archetypes, columns = schema
            names = set(re.findall(r"\w+", f"{timelines} {archetypes}"))
            documented[entity.strip("`")] = names, set(re.findall(r"`(\w+)`", columns)), only_if
            # The file has the last part of the path that is not a placeholder, as it logs it.
            last = next(p for p in (*entity.strip("`").split("/")[::-1], "") if p != "*")
            assert last in (ROOT / by.strip("`")).read_text("utf-8").lower(), (entity, by)
        found: dict[str, tuple[set[str], set[str]]] = {}
        for chunk in RrdReader(finished / name).stream():
            path = chunk.entity_path
            if path.startswith("/__"):
                continue
            path = path if path in documented else next(p for p in documented if matches(p, path))
            schema_of, columns_of = found.setdefault(path, (set(), set()))
            schema_of |= {"static"} if chunk.is_static else set(chunk.timeline_names)
            for column in chunk.to_record_batch().schema.names:
                archetype, _, component = column.rpartition(":")
                if archetype:
                    schema_of.add(archetype)
                elif component not in (*chunk.timeline_names, "rerun.controls.RowId"):
                    columns_of.add(component)
        for path, (schema_of, columns_of) in found.items():
            assert schema_of <= documented[path][0], path
            assert columns_of <= documented[path][1], path
        for path, (schema_in, columns_in, only_if) in documented.items():
            if not only_if:
                assert found[path] == (schema_in, columns_in), path
            elif path in found and only_if != "any":
                assert found[path][1] == columns_in, path


def matches(pattern: str, path: str) -> bool:
    return re.fullmatch(pattern.replace("*", "[^/]+"), path) is not None
