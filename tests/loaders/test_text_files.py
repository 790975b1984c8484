"""Text files that cannot be read are refused with one line that names them."""

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
def test_pipes_devices_folders_and_loops_are_not_opened(name: str, tmp_path: Path) -> None:
    path, read = tmp_path / name, READERS[name]
    os.mkfifo(path)
    assert f"{name}: is a pipe" in refused(read, path)
    path.unlink()
    path.symlink_to("/dev/zero")
    assert f"{name}: is a device" in refused(read, path)
    path.unlink()
    if name.startswith(("drive", "metadata")):
        return
    path.symlink_to(name)
    assert "symbolic links" in refused(read, path)
    path.unlink()
    path.mkdir()
    assert f"{name}: is a folder" in refused(read, path)


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
        (read_text, None),
    ],
    ids=range(9),
)
def test_invalid_content(
    read: Callable[[Path, str], Any], text: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "file"
    path.write_bytes(bytes(range(256)) if text is None else text.encode())
    assert "give another" in refused(lambda path: read(path, "give another"), path)
    with path.open("wb") as file:
        file.truncate(1 << 40)
    assert "bytes" in refused(lambda path: read(path, "give another"), path)
    path.unlink()
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))
        assert "a socket" in refused(lambda path: read(path, "give another"), path)


@pytest.mark.parametrize("value", ["1e300", "1e-300", "1e999", "9" * 100_000], ids=range(4))
def test_a_resolution_out_of_range(value: str, tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(f"image: map.png\nresolution: {value}\n")
    assert "map.yaml" in refused(read_map, tmp_path / "map.yaml")


NINES = "9" * 100_000
OUT_OF_RANGE = [f"seed={NINES}", "seed=-99999999999999999999999", "odometry.points_max=99999999999"]
OUT_OF_RANGE += ["wall_planes.similarity_m=1e300", "wall_planes.similarity_m=" + "[" * 100_000]


@pytest.mark.parametrize("word", OUT_OF_RANGE, ids=range(5))
def test_a_setting_out_of_range(word: str) -> None:
    assert word.partition("=")[0] in refused(lambda _: load_settings(None, [word]), Path())
