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
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from PIL import Image
from rerun.chunk import RrdReader
from rosbags.rosbag1 import Reader

from ffmap.algorithms.base.labels import Verdict
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.maps.rivals import Rival
from ffmap.app import cli, pipeline
from ffmap.app.folder import run_folder
from ffmap.app.folder.labels_file import read_labels
from ffmap.app.folder.names import file_names, rooms_file
from ffmap.app.record.errors import VERDICT_COLORS
from ffmap.app.record.read_back import rows
from ffmap.blueprints import entities
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.loaders.bag_builder import PERIOD_NS, START_NS, cloud, only, sweep, write_bag
from tests.program import (
    FFMAP,
    FFMAP_IN_FRONT,
    ffmap,
    ffmap_here,
)
from tests.receiver import content, receiving, shown

ROOT = Path(__file__).parents[3]
MAP_NAMES = ("map", *(f"map_{rival}" for rival in Rival))
UPRIGHT_TOPIC = "/horizontal_velodyne/velodyne_points"


@pytest.fixture(scope="module", autouse=True)
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache of odometries for these tests, and a wide terminal."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FFMAP_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setenv("COLUMNS", "200")
        yield


DRIVE = SimulationSettings(building="small", seed=3, sensor="vlp16", duration_s=3.0)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    simulate(path, DRIVE)
    return path


@pytest.fixture(scope="module")
def finished_as_said(
    bag: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """A run on the ROS 1 bag, and what it said."""
    out = tmp_path_factory.mktemp("runs") / "whole"
    done = ffmap(dict(os.environ), "run", bag, "--out", out)
    assert done.returncode == 0, done.stderr
    return out, done


@pytest.fixture(scope="module")
def finished(finished_as_said: tuple[Path, subprocess.CompletedProcess[str]]) -> Path:
    """A run on the ROS 1 bag."""
    return finished_as_said[0]


def read(run: Path, name: str) -> dict[str, Any]:
    return json.loads((run / name).read_text())


def here(*words: object) -> subprocess.CompletedProcess[str]:
    return ffmap_here(dict(os.environ), *words)


def assert_one_line_error(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    for word in words:
        assert word in done.stderr


def write_empty_clouds(path: Path) -> Path:
    """A bag whose only lidar never sees anything: clouds without points, and clouds of NaN."""
    clouds = []
    for k in range(6):
        points = only(sweep(), "x", "y", "z")[: 20 * (k % 2)]
        for axis in "xyz":
            points[axis] = np.nan
        stamp_ns = START_NS + k * PERIOD_NS
        clouds.append(("/points", stamp_ns, cloud(points, stamp_ns)))
    return write_bag(path, clouds)


def printed(done: subprocess.CompletedProcess[str]) -> dict[str, str]:
    """The five lines at the end of a run."""
    lines = dict(line.split(":", 1) for line in done.stdout.splitlines()[-5:])
    assert list(lines) == ["made", "quality", "results", "look", "warnings"]
    return {name: text.strip() for name, text in lines.items()}


def test_five_lines_summarize_a_run(
    finished_as_said: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    out, done = finished_as_said
    counts, metrics = read(out, "run.json")["counts"], read(out, "metrics.json")
    lines = printed(done)
    assert f"{counts['scans']} of {counts['clouds']} scans" in lines["made"]
    assert f"{counts['doors']} doors, {counts['rooms']} rooms" in lines["made"]
    assert f"wall F1 {100 * metrics['wall.f1']:.2f} %" in lines["quality"]
    assert str(out / "metrics.json") in lines["quality"]
    assert lines["results"] == str(out)
    assert lines["look"].endswith(str(out))
    assert lines["warnings"] == "none"


def test_a_cut_bag_is_processed_up_to_the_cut_with_a_warning(bag: Path, tmp_path: Path) -> None:
    whole = bag.read_bytes()
    cut, out = tmp_path / "cut.bag", tmp_path / "run"
    cut.write_bytes(whole[: int(0.7 * len(whole))])
    options = ("--outputs", "maps", "--workers", "1")
    done = here("run", cut, "--out", out, *options, "-v")
    assert done.returncode == 0, done.stderr
    assert "warning" in done.stderr
    assert "ATE RMSE" in done.stdout
    record, lines = read(out, "run.json"), printed(done)
    assert 10 < record["counts"]["scans"] < 30
    assert lines["warnings"].startswith(f"{len(record['warnings'])},")
    assert lines["warnings"].endswith(record["warnings"][0])
    assert "not compared: labels" in lines["quality"]
    options += ("--no-evaluate", "--overwrite")
    assert "--no-evaluate" in printed(here("run", cut, "--out", out, *options))["quality"]
    assert not here("run", cut, "--out", out, *options, "--quiet").stdout


def test_rooms_doors_topology_and_recording_agree(finished: Path) -> None:
    rooms, doors = (
        [own["properties"] for own in read(finished, name)["features"]]
        for name in ("rooms.geojson", "doors.geojson")
    )
    record, metrics = (read(finished, name) for name in ("run.json", "metrics.json"))
    topology = record["topology"]
    assert len(rooms) == record["counts"]["rooms"] > 0
    assert [room["name"] for room in rooms] == [room["name"] for room in topology["rooms"]]
    for room in rooms:
        assert all(room["name"] in doors[door]["rooms"] for door in room["doors"])
        passages = [own["rooms"] for own in topology["passages"] if room["name"] in own["rooms"]]
        others = {name for names in passages for name in names} - {room["name"]}
        assert others == set(room["neighbours"])
    assert any(door["rooms"] for door in doors)
    osm = ElementTree.parse(finished / "rooms.osm").getroot()
    nodes_of = {
        way.find("tag[@k='name']").attrib["v"]: {nd.attrib["ref"] for nd in way.iter("nd")}
        for way in osm.iter("way")
    }
    assert len(nodes_of) == 1 + len(rooms) + len(topology["passages"])
    for number, passage in enumerate(topology["passages"]):
        door = passage["door"]
        ends = nodes_of[f"opening {number}" if door is None else f"door {door}"]
        assert len(ends) == 2
        assert all(ends <= nodes_of[room] for room in passage["rooms"])
    paths = {str(chunk.entity_path) for chunk in RrdReader(finished / "recording.rrd").stream()}
    assert {"/world/rooms/floors", "/world/rooms/names", "/rooms/graph"} <= paths
    # Beside them, as in Fig. 10, the rooms of the normal map, with and without alpha removal.
    for name in Segmented:
        file = json.loads((finished / rooms_file(name)).read_text())
        assert metrics[f"rooms.{name}.found"] == len(file["features"])
        if name != Segmented.FURNITURE_FREE:
            assert f"{entities.ROOMS_COMPARED}/{name}/passages" in paths


def test_every_file_can_be_read_by_something_else(finished: Path) -> None:
    record = read(finished, "run.json")
    assert record["outcome"] == "complete"
    absent = {"labelled.bag", "labelled", "spool"}
    written = {path.name for path in finished.iterdir()}
    assert written == file_names() - absent
    assert {*record["files"], "metrics.json", "evaluation.rrd", "overlay.png"} == written
    meta = yaml.safe_load((finished / "map.yaml").read_text())
    with Image.open(finished / meta["image"]) as image:
        assert set(np.unique(np.asarray(image))) <= {0, 205, 254}
    trajectory = np.loadtxt(finished / "trajectory.tum")
    assert trajectory.shape == (record["counts"]["scans"], 8)
    for name in ("recording.rrd", "evaluation.rrd"):
        rerun = Path(sys.executable).parent / "rerun"
        done = subprocess.run([rerun, "rrd", "verify", finished / name], check=False)
        assert done.returncode == 0, name
    assert read(finished, "walls.geojson")["features"]
    assert 0.5 < read(finished, "metrics.json")["floor.f1"] <= 1.0


def test_errors_are_a_layer_of_the_recording(finished: Path) -> None:
    record, metrics = (read(finished, name) for name in ("run.json", "metrics.json"))
    reader = RrdReader(finished / "evaluation.rrd")
    assert {entry.recording_id for entry in reader.recordings()} == {record["recording_id"]}
    colors = {
        row.scan: row.values[entities.POINT_VERDICT_COLOR]
        for row in rows(finished / "evaluation.rrd", entities.POINTS)
    }
    false_wall = VERDICT_COLORS[Verdict.FALSE_WALL]
    false_walls = sum(np.count_nonzero(own == false_wall) for own in colors.values())
    assert false_walls == metrics["points.wall.wrong"] > 0
    # One verdict for each return, in the order of the recorded points.
    labels = read_labels(finished / "labels.parquet")
    assert colors.keys() == labels.keys()
    for scan, row in labels.items():
        assert len(colors[scan]) == np.count_nonzero(row.label != 255)
    # The viewer takes either of what both files log once: only the layouts may be in both.
    once = [
        {chunk.entity_path for chunk in RrdReader(finished / name).stream() if chunk.is_static}
        for name in ("recording.rrd", "evaluation.rrd")
    ]
    assert all(path.startswith("/__properties") for path in once[0] & once[1])
    for name in ("recording.rrd", "evaluation.rrd"):
        assert len(RrdReader(finished / name).blueprints())


def test_a_ros2_bag_gives_the_same_labels(finished: Path, tmp_path: Path) -> None:
    simulate(tmp_path / "drive", DRIVE.model_copy(update={"format": "mcap"}))
    options = ("--no-evaluate", "--detail", "map", "--workers", "1", "--outputs", "+labelled-bag")
    done = here("run", tmp_path / "drive", "--out", tmp_path / "run", *options)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "labelled").is_dir()
    ours, theirs = (read(run, "run.json")["labels_digest"] for run in (tmp_path / "run", finished))
    assert ours == theirs != ""


def test_a_run_is_not_resumed_with_other_inputs(bag: Path, finished: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(finished, tmp_path / "run"))
    other = Path(shutil.copy(bag, tmp_path))
    record = read(out, "run.json")
    record |= {"outcome": "aborted", "bag": record["bag"] | {"path": str(other)}}
    poses = out / "poses.tum"
    poses.write_text("other poses\n")
    given = {"trajectory": str(poses), "digests": {"trajectory": "another"}}
    for changed, words in (
        ({"options": record["options"] | {"outputs": 3}}, ("run.json",)),
        ({"versions": record["versions"] | {"git_revision": "0123"}}, ("another version",)),
        ({"options": record["options"] | given}, ("poses.tum", "is not what", "start a new run")),
        ({"outcome": "aborted"}, ("not the bag", "start a new run")),
    ):
        (out / "run.json").write_text(json.dumps(record | changed))
        if changed == {"outcome": "aborted"}:
            flip_a_bit(other, UPRIGHT_TOPIC, 3)
        assert_one_line_error(here("run", "--resume", out), *words)
    assert "complete already" in here("run", "--resume", finished).stdout


def flip_a_bit(bag: Path, topic: str, cloud: int) -> None:
    """In the middle of a cloud's points, with size, index and times of the file as they were."""
    with Reader(bag) as reader:
        wanted = [c for c in reader.connections if c.topic == topic]
        data = [bytes(data) for _, _, data in reader.messages(wanted)][cloud]
    with bag.open("r+b") as file:
        found = mmap.mmap(file.fileno(), 0)
        found[found.find(data) + len(data) // 2] ^= 4
        found.close()


def test_mistakes_are_one_line_and_leave_earlier_results_alone(
    bag: Path, finished: Path, tmp_path: Path
) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in finished.iterdir()}
    text, foreign = tmp_path / "text.bag", tmp_path / "foreign"
    text.write_text("this is no bag\n")
    foreign.mkdir()
    (foreign / "small.bag").write_text("mine")
    nothing = write_empty_clouds(tmp_path / "nothing.bag")
    run, out = ("run", bag), ("--out", finished)
    dead = "rerun+http://127.0.0.1:1/proxy"
    for words, named in (
        (("run", tmp_path / "none.bag", *out), "none.bag"),
        (("run", text, *out), "text.bag"),
        (("info", text), "text.bag"),
        ((*run, *out, "--set", "wall_planes.similarty_m=1"), "wall_planes.similarity_m"),
        ((*run, *out, "--vertical", "/nothing"), "/nothing"),
        ((*run, *out, "--overwrite", "--connect", dead), "127.0.0.1:1"),
        ((*run, *out), "finished run"),
        ((*run, "--out", foreign), "foreign"),
        ((*run, "--out", text / "run"), "text.bag"),
        (("demo", "--out", foreign), "small.bag"),
        (("demo", "--out", text / "run"), "text.bag"),
        (("run", "--resume", tmp_path), "run.json"),
        (("run", "--resume", finished, "--overwrite"), "--resume"),
        (("run",), "--resume"),
        (("evaluate", tmp_path), str(tmp_path)),
        (("run", nothing, *out), "no usable cloud"),
    ):
        assert_one_line_error(here(*words), named)
    assert (foreign / "small.bag").read_text() == "mine"
    assert {path.name: path.stat().st_mtime_ns for path in finished.iterdir()} == before


@pytest.mark.parametrize(("free", "warnings"), [(1_900_000_000, 1), (2_100_000_000, 0)])
def test_little_free_space_is_a_warning(
    free: int, warnings: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    assert len(pipeline._little_space(tmp_path)) == warnings


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "the disk is full"),
        (
            PermissionError(errno.EACCES, "Permission denied", "a/metrics.json"),
            "a/metrics.json: cannot be read or written (Permission denied)",
        ),
        (MemoryError(), "out of memory"),
    ],
)
def test_errors_of_the_system_are_one_line(
    error: Exception,
    line: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(cli, "app", mock.Mock(side_effect=error))
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith(f"ffmap: {line}")


def test_two_runs_never_write_into_one_folder(bag: Path, finished: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(finished, tmp_path / "run")
    with run_folder.held(copy):
        done = ffmap(dict(os.environ), "run", bag, "--out", copy, "--overwrite")
        assert_one_line_error(done, str(copy), "another run")
        done = here("run", "--resume", copy)
        assert_one_line_error(done, str(copy), "another run")
    assert (copy / "recording.rrd").exists()


def test_run_is_replaced_where_the_user_says_so(bag: Path, finished: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(finished, tmp_path / "run")
    (copy / "notes.txt").write_text("mine")
    options = ("--overwrite", "--outputs", "maps", "--no-evaluate", "--workers", "1")
    # Not by one that reads it.
    own = ("--trajectory", copy / "trajectory.tum")
    done = here("run", bag, "--out", copy, *options, *own)
    assert_one_line_error(done, "trajectory.tum")
    assert (copy / "recording.rrd").exists()
    done = here("run", bag, "--out", copy, *options)
    assert done.returncode == 0, done.stderr
    maps = [f"{name}.{end}" for name in MAP_NAMES for end in ("yaml", "pgm")]
    assert set(read(copy, "run.json")["files"]) == {"run.json", "trajectory.tum", *maps}
    written = {path.name for path in copy.iterdir()}
    assert written == {"notes.txt", "run.json", "trajectory.tum", *maps}


@pytest.mark.parametrize("stage", ["odometry", "final"])
def test_interruption_is_one_line_that_says_how_to_go_on(
    stage: str, bag: Path, finished: Path, tmp_path: Path
) -> None:
    # The stage before it has ended, or the run's folder is there.
    out, before = tmp_path / "run", {"odometry": "", "final": "building:"}[stage]
    cold = {"FFMAP_CACHE": str(tmp_path)} if stage == "odometry" else {}
    words = ("run", str(bag), "--out", str(out), "--workers", "2", "--no-evaluate")
    process = subprocess.Popen(
        [*FFMAP_IN_FRONT, *words],
        env={**os.environ, **cold},
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
    assert "Traceback" not in "".join(said)
    assert read(out, "run.json")["outcome"] == "aborted"


def test_a_viewer_receives_the_whole_run(bag: Path, tmp_path: Path) -> None:
    with receiving(tmp_path / "seen.rrd") as viewer:
        words = ("--outputs", "recording,maps", "--no-evaluate", "--connect", viewer.url)
        done = here("run", bag, "--out", tmp_path / "a", *words)
        assert done.returncode == 0, done.stderr
        assert viewer.holds(tmp_path / "a" / "recording.rrd")
        assert "Odometry's map; the labelled map follows" not in shown(viewer.path)
    scans = json.loads((tmp_path / "a" / "run.json").read_text())["counts"]["scans"]
    assert content(viewer.path)[entities.POINTS, entities.SCAN_TIMELINE] >= scans > 0


def test_a_viewer_that_does_not_start_is_one_line(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    done = here("run", bag, "--out", tmp_path / "a", "--spawn")
    assert_one_line_error(done, "--spawn", "display")
    assert not (tmp_path / "a" / "run.json").exists()


def test_mistakes_in_options_are_one_line() -> None:
    for words, named in (
        (("run", "a.bag", "--nope"), "--nope"),
        (("rum",), "rum"),
        (("inspect",), "RUN"),
        (("run", "a.bag", "--workers", "0"), "--workers"),
        (("run", "a.bag", "--time-from", "sun"), "azimuth"),
    ):
        assert_one_line_error(here(*words), "ffmap: ", named, "--help")


def test_version_and_help() -> None:
    done = here("--version")
    assert done.returncode == 0
    assert done.stdout.startswith("ffmap 0.")
    assert "--overwrite" in here("run", "--help").stdout
    assert "simulate" in here().stdout


def test_help_may_be_read_in_part() -> None:
    """By grep -q, in a script that ends where a program of a pipe fails."""
    with subprocess.Popen([*FFMAP, "run", "--help"], stdout=subprocess.PIPE, bufsize=0) as process:
        assert process.stdout is not None
        assert process.stdout.read(1)
        process.stdout.close()
        assert process.wait() == 0


def test_hints_name_what_helps(finished: Path, tmp_path: Path) -> None:
    bag = tmp_path / "a.bag"
    for words, hints in (
        (("settings", "--set", "doors=3"), ("'doors' is a group", "doors.recess_min_m")),
        (("settings", "--set", "wall_planes.similarity_m=nan"), ("no finite number",)),
        (("settings", "--set", "wall_plane.similarity_m=1"), ("'wall_planes.similarity_m'",)),
        (("settings", "--set", "wall_planes.nope=1"), ("'ffmap settings --all'",)),
        (("settings", "--set", "doors.reces_min=1"), ("scan labels; building.recess_min_m acts",)),
        (("settings", "nope"), ("no setting 'nope'",)),
        (("simulate", bag, "--building", "foo"), ("'foo'", "'office'")),
        (("simulate", bag, "--set", "clutter=7"), ("less than or equal to 1",)),
        (("simulate", bag, "--set", "nope=7"), ("'nope'", "noise_m")),
        (("rooms", finished / "doors.geojson"), ("doors.geojson: is no map",)),
        (("rooms", finished / "map.yaml", "--resolution", "50"), ("--resolution 50",)),
    ):
        assert_one_line_error(here(*words), *hints)


def test_evaluation_of_nothing_is_refused(bag: Path, finished: Path, tmp_path: Path) -> None:
    aborted = tmp_path / "aborted"
    aborted.mkdir()
    record = read(finished, "run.json")
    (aborted / "run.json").write_text(json.dumps({**record, "outcome": "aborted"}))
    assert_one_line_error(here("evaluate", aborted), "aborted", "--resume")
    assert not (aborted / "metrics.json").exists()
    copy = shutil.copytree(finished, tmp_path / "run")
    poses = [line.split() for line in (copy / "trajectory.tum").read_text().splitlines()]
    later, moved = tmp_path / "later.tum", tmp_path / "true.tum"
    later.write_text("".join(" ".join([f"2{p[0][1:]}", *p[1:]]) + "\n" for p in poses))
    moved.write_text(
        "".join(" ".join([p[0], str(float(p[1]) + 1.0), *p[2:]]) + "\n" for p in poses)
    )
    before = (copy / "metrics.json").read_bytes()
    assert_one_line_error(here("evaluate", copy, "--truth", later), "later.tum", "same drive")
    assert (copy / "metrics.json").read_bytes() == before
    done = ffmap(dict(os.environ), "evaluate", copy, "--truth", moved)
    assert done.returncode == 0, done.stderr
    assert "not compared: labels, doors, maps and rooms: the truth has poses alone" in done.stdout
    figures = read(copy, "metrics.json")
    assert figures["trajectory.ate_rmse_m"] < 1e-6 < figures["trajectory.unaligned_rmse_m"]
    (copy / "doors.geojson").unlink()
    done = here("evaluate", copy)
    assert (
        "not compared: doors: the run has no doors.geojson; --outputs with geojson writes it"
        in done.stdout
    )


def test_info_and_run_say_the_same_of_mistakes(bag: Path, tmp_path: Path) -> None:
    cut, rig = tmp_path / "cut.bag", tmp_path / "rig.toml"
    cut.write_bytes(bag.read_bytes()[:1000])
    said = f"{cut}: the bag is empty, it has no messages; record it again"
    assert said in here("info", cut).stdout
    assert_one_line_error(here("run", cut), said)
    rig.write_text("[[lidar]]\n")
    for option, value in (("--horizontal", "/nope"), ("--vertical", "/nope"), ("--rig", rig)):
        info, run = (here(command, bag, option, value) for command in ("info", "run"))
        assert_one_line_error(info, str(value))
        assert info.stderr == run.stderr


def test_settings_round_trip(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    for words in ((), ("--all",)):
        shown = here("settings", *words, "--set", "doors.recess_min_m=0.03")
        assert shown.returncode == 0
        file.write_text(shown.stdout)
        assert here("settings", *words, "--config", file).stdout == shown.stdout
        assert "doors.recess_min_m = 0.03" in shown.stdout


def test_the_settings_that_matter_are_listed_with_reasons_to_change_them() -> None:
    shown = here("settings").stdout
    names = re.findall(r"^(\S+) = ", shown, re.MULTILINE)
    assert len(names) == 10
    assert shown.count("# Raise it if ") == shown.count("Lower it if ") == 10
    found = here("settings", "recess_min_m").stdout
    assert re.findall(r"^(\S+) = ", found, re.MULTILINE) == [
        "doors.recess_min_m",
        "building.recess_min_m",
    ]
    assert [re.search(r"Acts on ([\w ]+)", own)[1] for own in found.split("\n\n")] == [
        "scan labels",
        "final labels and maps",
    ]


def test_real_lidar_gives_a_trajectory_and_nothing_to_label(tmp_path: Path) -> None:
    data = os.environ.get("FFMAP_REAL_DATA")
    if not data:
        pytest.skip("FFMAP_REAL_DATA is not set: no real recordings here")
    bag = Path(data) / "hilti_14.bag"
    shutil.copy(bag, tmp_path / "hilti.bag")
    done = here("run", tmp_path / "hilti.bag", "--out", tmp_path / "run")
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
