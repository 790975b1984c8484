"""`import ffmap`: arrays and bags in, labels and tables out, and the examples of the documents."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

import ffmap
from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.app.record.read_back import chunk_stream
from tests import synthetic
from tests.program import with_cache

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
UP_SENSOR = tuple(synthetic.T_BASE_SENSOR[2, :3])
VERTICAL = "/vertical_velodyne/velodyne_points"


@pytest.fixture(scope="module")
def room() -> ffmap.LabelledArray:
    """A scan of a lidar on its side, in an empty room."""
    scan = synthetic.scan()
    return ffmap.label_scan(scan.points_sensor, scan.ring, up=UP_SENSOR)


def test_an_array_is_labelled_as_a_scan_of_a_run(room: ffmap.LabelledArray) -> None:
    scan, pose = synthetic.scan(), synthetic.trajectory(1)
    level = synthetic.level(scan, pose)
    as_in_a_run = label_scan(scan, level.placed, synthetic.settings(), 0, level.floor)
    assert room.label.shape == (len(scan),)
    assert np.mean(room.label == as_in_a_run.label) > 0.995
    assert room.counts["clutter"] == np.count_nonzero(room.label == ffmap.Label.CLUTTER)
    assert "in a wall plane" in room.lines["outcome"].to_pylist()


def test_labels_stay_with_their_points(room: ffmap.LabelledArray) -> None:
    scan = synthetic.scan()
    order = np.random.default_rng(1).permutation(len(scan))
    shuffled = ffmap.label_scan(scan.points_sensor[order], scan.ring[order], up=UP_SENSOR)
    assert np.mean(shuffled.label == room.label[order]) > 0.999


def test_an_upright_lidar_is_labelled_by_its_columns() -> None:
    rise, turn = np.radians(np.linspace(-45, 45, 64)), np.radians(np.linspace(-180, 179, 720))
    rays = np.stack(
        [
            np.outer(np.cos(rise), np.cos(turn)),
            np.outer(np.cos(rise), np.sin(turn)),
            np.outer(np.sin(rise), np.ones_like(turn)),
        ],
        axis=-1,
    )
    with np.errstate(divide="ignore"):
        walls = np.min(np.array([3.0, 4.0]) / np.abs(rays[..., :2]), axis=-1)
        level = np.where(rays[..., 2] > 0, 1.4, 1.2) / np.abs(rays[..., 2])
    points = rays * np.minimum(walls, level)[..., None]
    points[0, :100] = np.nan
    labelled = ffmap.label_scan(points)
    assert labelled.label.shape == (64, 720)
    assert (labelled.label[0, :100] == NO_RETURN).all()
    on_wall = walls < level - 0.1
    assert np.mean(labelled.label[on_wall] == ffmap.Label.WALL) > 0.97


@pytest.mark.parametrize(
    ("points", "ring", "words"),
    [
        (np.zeros((5, 2)), None, "give (n, 3)"),
        (np.full((5, 3), np.nan), None, "no return"),
        (np.ones((5, 3)), [1, 2], "2 values for 5 points"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(
    points: np.ndarray, ring: list[int] | None, words: str
) -> None:
    with pytest.raises(ValueError, match=r"points|ring") as raised:
        ffmap.label_scan(points, ring)
    assert words in str(raised.value)


def test_a_wrong_setting_is_refused() -> None:
    with pytest.raises(ffmap.InputError, match=r"wall_planes\.similarity_m"):
        ffmap.label_scan(np.ones((5, 3)), config={"wall_planes.similarty_m": 0.1})
    with pytest.raises(ffmap.InputError, match="'doors' is no step"):
        ffmap.label_scan(np.ones((5, 3)), config={"doors": 1, "doors.lines_min": 2})


def test_a_labelled_array_is_logged_line_by_line(room: ffmap.LabelledArray, tmp_path: Path) -> None:
    stream = rr.RecordingStream("array")
    stream.save(tmp_path / "array.rrd")
    room.log(stream)
    stream.flush()
    stream.disconnect()
    chunks = chunk_stream(tmp_path / "array.rrd").filter(content="/why/line")
    assert sum(len(chunk.to_record_batch()) for chunk in chunks) == len(room.reasons)


def test_a_run_is_opened_as_arrays_and_tables(small_run: Path, tmp_path: Path) -> None:
    run = ffmap.open_run(small_run)
    assert len(run.walls) == run.finished.record.counts["walls"]
    assert run.ends(run.walls).shape == (len(run.walls), 2, 2)
    assert len(run.doors) == run.finished.record.counts["doors"]
    assert len(run.rooms) == run.finished.record.counts["rooms"]
    assert run.cloud is not None
    points, label = run.cloud
    assert len(points) == len(label) == run.finished.record.counts["cloud_points"]
    assert run.trajectory is not None
    assert run.labels(3).label.shape == run.labels(3).label_scan.shape
    with pytest.raises(KeyError, match="scan 100000"):
        run.labels(100_000)
    stream = rr.RecordingStream("building")
    stream.save(tmp_path / "building.rrd")
    run.log(stream)
    stream.flush()
    stream.disconnect()
    (cloud,) = chunk_stream(tmp_path / "building.rrd").filter(content="/world/building/cloud")
    (drawn,) = cloud.to_record_batch()["Points3D:class_ids"].to_pylist()
    assert len(drawn) == np.count_nonzero(label != ffmap.Label.CEILING)


def example(name: str, folder: Path, *words: object) -> str:
    environment = os.environ | with_cache(folder / "cache")
    command = [sys.executable, str(EXAMPLES / name), *map(str, words)]
    done = subprocess.run(command, cwd=folder, env=environment, text=True, capture_output=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_examples_run(small_bag: Path, small_run: Path, tmp_path: Path) -> None:
    told = example("label_an_array.py", tmp_path, small_bag, VERTICAL, "0,1,0")
    assert "wall plane: normal" in told
    assert (tmp_path / "labelled.rrd").exists()
    told = example("map_a_bag.py", small_bag.parent, small_bag, tmp_path / "run")
    assert "points of the building" in told
    told = example("compare_two_runs.py", tmp_path, small_run, tmp_path / "run")
    assert "0 labels differ in 49 scans" in told
    assert "wall planes in" in example(
        "query_a_recording.py", tmp_path, small_run / "recording.rrd"
    )
    told = example("log_an_intermediate.py", tmp_path, small_bag, VERTICAL, "0,1,0")
    assert "/scan/off_plane" in told
    assert len([*chunk_stream(tmp_path / "off_plane.rrd").filter(content="/scan/off_plane")]) == 1


def test_the_notebook_runs(small_bag: Path, small_run: Path, tmp_path: Path) -> None:
    cells = json.loads((EXAMPLES / "first_look.ipynb").read_text("utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    code = code.replace("demo/small.bag", str(small_bag)).replace("demo/run", str(small_run))
    script = tmp_path / "notebook.py"
    script.write_text(code)
    environment = {**os.environ, "MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=environment, text=True, capture_output=True
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "first_look.rrd").exists()


def test_importing_the_package_takes_nothing_along() -> None:
    code = "import sys, ffmap; print(any(n in sys.modules for n in ('numpy', 'rerun', 'numba')))"
    told = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert told.stdout.strip() == "False"
