"""What users give as a text file and is none, or never ends: one line that names it."""

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.map_files import read_image, read_map
from ffmap.app.setup.settings import load_settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig_file import read_rig_file
from ffmap.loaders.text_files import read_json, read_text, read_toml, read_yaml
from ffmap.loaders.trajectory_file import read_tum

READERS: dict[str, Callable[[Path], Any]] = {
    "config.toml": lambda path: load_settings(path, []),
    "rig.toml": read_rig_file,
    "poses.tum": read_tum,
    "map.yaml": read_map,
    "map.png": read_image,
    "drive.bag": open_bag,
    "drive.db3": open_bag,
    "drive.mcap": open_bag,
    "metadata.yaml": lambda path: open_bag(path.parent),
    "run.json": lambda path: open_run(path.parent),
}


def refused(read: Callable[[Path], Any], path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000
    return str(caught.value)


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_not_waited_for(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    assert f"{name}: is a pipe" in refused(READERS[name], tmp_path / name)


@pytest.mark.parametrize("name", READERS)
def test_a_device_is_not_read(name: str, tmp_path: Path) -> None:
    (tmp_path / name).symlink_to("/dev/zero")
    assert f"{name}: is a device" in refused(READERS[name], tmp_path / name)


@pytest.mark.parametrize("name", [name for name in READERS if not name.startswith(("drive", "metadata"))])
def test_a_folder_and_a_link_to_itself_are_told(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    assert f"{name}: is a folder" in refused(READERS[name], tmp_path / name)
    (tmp_path / name).rmdir()
    (tmp_path / name).symlink_to(name)
    assert "symbolic links" in refused(READERS[name], tmp_path / name)


def test_a_socket_is_told(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(tmp_path / "s"))
        assert "a socket" in refused(lambda path: read_text(path, "give a file"), tmp_path / "s")


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (read_toml, "a = " + "[" * 100_000),
        (read_toml, "a = " + "9" * 100_000),
        (read_toml, "a." * 100_000 + "b = 1"),
        (read_yaml, "[" * 100_000),
        (read_yaml, "resolution: " + "9" * 100_000),
        (read_yaml, "day: 2024-99-99"),
        (read_json, "[" * 1_000_000),
        (read_json, "9" * 100_000),
    ],
    ids=["deep", "long number", "long name", "deep", "long number", "no day", "deep", "long number"],
)
def test_what_parsers_stumble_over_is_told(read: Callable[[Path, str], Any], text: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text(text)
    assert "give another" in refused(lambda path: read(path, "give another"), tmp_path / "file")


def test_what_is_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "large").open("wb") as file:
        file.truncate(1 << 40)
    for read in (read_text, read_toml, read_yaml, read_json):
        assert "bytes" in refused(lambda path, read=read: read(path, "give another"), tmp_path / "large")


@pytest.mark.parametrize(
    "word",
    [
        "seed=99999999999999999999999",
        "seed=-99999999999999999999999",
        "seed=" + "9" * 100_000,
        "odometry.points_max=99999999999",
        "wall_planes.similarity_m=1e300",
        "wall_planes.similarity_m=" + "[" * 100_000,
        "grid_map.cell_m=1e-300",
        "pose_graph.every_scans=-2000000000",
    ],
    ids=lambda word: word[:30],
)
def test_a_setting_of_any_size_is_told(word: str) -> None:
    assert word.partition("=")[0] in refused(lambda _: load_settings(None, [word]), Path())


@pytest.mark.parametrize("value", ["1e300", "1e-300", "1e999", "9" * 100_000], ids=lambda value: value[:30])
def test_a_resolution_of_any_size_is_told(value: str, tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(f"image: map.png\nresolution: {value}\n")
    assert "map.yaml" in refused(read_map, tmp_path / "map.yaml")


def test_what_is_no_text_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(bytes(range(256)))
    assert "is no text" in refused(lambda path: read_text(path, "give another"), tmp_path / "file")
