"""A bag in the viewer: the importer as the viewer starts it, and its recording read back."""

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ffmap.app.folder.cloud_file import read_ply
from ffmap.app.folder.labels_file import stream_labels
from ffmap.app.record.read_back import chunk_stream
from ffmap.loaders.bag import open_bag
from tests.loaders.bag_builder import clouds, write_bag
from tests.program import rig_of

ROOT = Path(__file__).parents[3]
IMPORTER = [sys.executable, "-c", "from ffmap.app.importer import main; main()"]
IDS = ("--application-id", "drive", "--recording-id", "rec_1", "--opened-recording-id", "rec_0")


@pytest.fixture
def imported(tmp_path: Path):
    """Start the importer in an empty folder; returns exit code, recording and errors."""

    def start(path: Path, *options: str) -> tuple[int, Path, str]:
        recording = tmp_path / "read.rrd"
        with recording.open("wb") as file:
            command = [*IMPORTER, path, *IDS, *options]
            done = subprocess.run(command, stdout=file, stderr=subprocess.PIPE, cwd=tmp_path)
        return done.returncode, recording, done.stderr.decode()

    return start


def column(recording: Path, entity: str, name: str) -> dict[int, np.ndarray]:
    """A component of an entity by time stamp; of static data at 0."""
    found = {}
    for chunk in chunk_stream(recording).filter(content=entity):
        batch = chunk.to_record_batch()
        names = {own.rpartition(":")[2]: own for own in batch.schema.names}
        if name in names:
            stamps = [0]
            if "stamp" in names:
                stamps = batch.column(names["stamp"]).cast(pa.int64()).to_pylist()
            for stamp, row in zip(stamps, batch.column(names[name]), strict=True):
                values = row.values
                if pa.types.is_fixed_size_list(values.type):
                    size = values.type.list_size
                    values = values.flatten().to_numpy().reshape(-1, size)
                found[stamp] = np.asarray(values)
    return found


def test_the_viewer_finds_it_by_its_name() -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert scripts["rerun-importer-ffmap"] == "ffmap.app.importer:main"


def test_a_bag_without_a_run_shows_both_lidars_around_the_robot(
    imported, small_bag: Path, tmp_path: Path
) -> None:
    bag = tmp_path / "drive.bag"
    bag.hardlink_to(small_bag)
    code, recording, err = imported(bag)
    assert (code, err) == (0, "")
    rig = rig_of(bag)
    for role, lidar in (("horizontal", rig.horizontal), ("vertical", rig.vertical)):
        with open_bag(bag) as opened:
            stamps = lidar.index(opened).stamp_ns
        positions = column(recording, f"/world/base/{role}/points", "positions")
        assert sorted(positions) == stamps.tolist()
        assert all(1000 < len(points) <= 20_000 for points in positions.values())
        (place,) = column(recording, f"/world/base/{role}", "translation").values()
        np.testing.assert_allclose(place[0], lidar.T_base_sensor[:3, 3], atol=1e-6)
    assert not column(recording, "/world/base/vertical/points", "class_ids")
    (glance,) = column(recording, "/glance", "text").values()
    assert "ffmap run drive.bag" in glance[0]


def test_a_run_beside_the_bag_gives_map_poses_and_labels(
    imported, small_bag: Path, small_run: Path
) -> None:
    code, recording, err = imported(small_bag)
    assert (code, err) == (0, "")
    (glance,) = column(recording, "/glance", "text").values()
    assert str(small_run) in glance[0]
    positions = column(recording, "/world/vertical/points", "positions")
    class_ids = column(recording, "/world/vertical/points", "class_ids")
    translation = column(recording, "/world/vertical", "translation")
    quaternion = column(recording, "/world/vertical", "quaternion")
    labels = {own.stamp_ns: own.label for own in stream_labels(small_run / "labels.parquet")}
    assert positions.keys() == class_ids.keys() == labels.keys()
    building, of_building = read_ply(small_run / "cloud.ply")
    tree, near = KDTree(building), []
    for stamp in list(positions)[::10]:
        turned = Rotation.from_quat(quaternion[stamp][0]).apply(positions[stamp])
        off_m, nearest = tree.query(turned + translation[stamp][0])
        near.append((off_m < 0.15) & (of_building[nearest] == class_ids[stamp]))
        counts = (np.bincount(own, minlength=256)[:6] for own in (class_ids[stamp], labels[stamp]))
        shown, of_scan = (own / own.sum() for own in counts)
        np.testing.assert_allclose(shown, of_scan, atol=0.01)
    assert np.concatenate(near).mean() > 0.9
    assert column(recording, "/world/building/cloud", "positions")


def test_lidars_without_extrinsics_are_shown_apart(imported, tmp_path: Path) -> None:
    entries = [*clouds("/one", 8, frame="one"), *clouds("/two", 8, frame="two", late_ns=10**6)]
    bag = write_bag(tmp_path / "apart.bag", sorted(entries, key=lambda entry: entry[1]))
    code, recording, err = imported(bag)
    assert (code, err) == (0, "")
    for number in (1, 2):
        assert len(column(recording, f"/world/base/lidar_{number}/points", "positions")) == 8
        assert not column(recording, f"/world/base/lidar_{number}", "translation")


def test_what_is_no_bag_of_a_lidar_is_left_to_others(imported, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("of a drive")
    (tmp_path / "broken.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "pictures").mkdir()
    for name in ("notes.txt", "broken.bag", "pictures", "absent.mcap"):
        code, recording, err = imported(tmp_path / name)
        assert (code, recording.read_bytes(), err) == (66, b"", ""), name


def test_a_folder_is_shown_once(imported, tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "drive_mcap", clouds("/one", 8, ros_version=2))
    opened = ("--application-id", folder.name)
    code, recording, _ = imported(folder, *opened)
    assert code == 0
    assert len(column(recording, "/world/base/**", "positions")) == 8
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a.bag").hardlink_to(next(folder.glob("*.mcap")))
    # The viewer goes on to the files in the folder, and reports those that no importer takes.
    for file in (tmp_path / "other" / "a.bag", folder / "metadata.yaml"):
        code, recording, _ = imported(file, "--application-id", file.parent.name)
        assert (code, recording.read_bytes()) == (0, b"")
