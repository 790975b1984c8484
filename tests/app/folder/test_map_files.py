"""Grid maps, read back as map_server would read them."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.app.folder.map_files import read_map, write_grid
from ffmap.loaders.errors import InputError

FREE, WALL, NONE = int(Cell.FREE), int(Cell.OCCUPIED), int(Cell.UNKNOWN)
GRID = GridMap(
    np.array([[WALL, FREE, NONE], [FREE, FREE, WALL]], np.uint8), np.array([-1.5, 2.25]), 0.05
)


def test_pillow_and_yaml_read_what_is_written(tmp_path: Path) -> None:
    write_grid(tmp_path / "map.yaml", GRID)
    description = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert description == {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": 0.05,
        "origin": [-1.5, 2.25, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    assert (tmp_path / "map.pgm").read_bytes().startswith(b"P5\n3 2\n255\n")
    with Image.open(tmp_path / "map.pgm") as image:
        assert np.asarray(image).tolist() == [[254, 254, 0], [0, 254, 205]]
    back = read_map(tmp_path / "map.yaml")
    np.testing.assert_array_equal(back.cells, GRID.cells)
    np.testing.assert_allclose(back.origin, GRID.origin)


@pytest.mark.parametrize("name", ["map.jpg", "map.webp"])
@pytest.mark.parametrize("described", [False, True])
def test_lossy_compression_changes_no_cell(tmp_path: Path, name: str, described: bool) -> None:
    rooms = np.full((80, 120), NONE, np.uint8)
    rooms[10:70, 10:110] = WALL
    rooms[11:69, 11:60] = rooms[11:69, 61:109] = rooms[55:69, 60] = FREE
    Image.fromarray(rooms[::-1]).save(tmp_path / name, quality=85)
    with Image.open(tmp_path / name) as image:
        assert len(np.unique(np.asarray(image.convert("L")))) > 10
    (tmp_path / "map.yaml").write_text(f"image: {name}\nresolution: 0.05\norigin: [0, 0, 0]\n")
    back = read_map(tmp_path / ("map.yaml" if described else name), None if described else 0.05)
    np.testing.assert_array_equal(back.cells, rooms)


@pytest.mark.parametrize(
    ("description", "pixels"),
    [
        ("", [254, 0, 205]),
        ("negate: 1", [0, 255, 128]),
        ("mode: raw", [0, 100, 255]),
        ("mode: Scale\nfree_thresh: 0.4", [170, 0, 205]),
        ("negate: true\noccupied_thresh: 0.3\nfree_thresh: 0.1", [10, 90, 60]),
    ],
)
def test_a_yaml_files_own_thresholds_hold(
    description: str, pixels: list[int], tmp_path: Path
) -> None:
    Image.fromarray(np.array([pixels], np.uint8)).save(tmp_path / "map.png")
    # map_saver writes the absolute path on another computer.
    (tmp_path / "map.yaml").write_text(f"image: /home/robot/map.png\nresolution: 1\n{description}")
    assert read_map(tmp_path / "map.yaml").cells.tolist() == [[FREE, WALL, NONE]]
    (tmp_path / "map.png").unlink()
    with pytest.raises(InputError, match=r"/home/robot/map\.png: is not there"):
        read_map(tmp_path / "map.yaml")


def test_transparent_pixels_are_unknown(tmp_path: Path) -> None:
    rgba = np.array([[[255] * 4, [255, 255, 255, 0], [0, 0, 0, 255]]], np.uint8)
    Image.fromarray(rgba).save(tmp_path / "map.png")
    assert read_map(tmp_path / "map.png", 0.05).cells.tolist() == [[FREE, NONE, WALL]]


_GOOD = "image: image.png\nresolution: 0.1\n"


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (None, "is not there"),
        ("not: [yaml", "is no valid YAML"),
        ("5", "holds no keys"),
        ("\x00", "YAML"),
        ("image: !!python/object/apply:os.mkdir ['ran']", "YAML"),
        ("image: gone.pgm\nresolution: 0.1\n", "gone.pgm"),
        ("image: text.pgm\nresolution: 0.1\n", "text.pgm"),
        ("image: 7\nresolution: 0.1\n", "image"),
        ("image: image.png\n", "resolution"),
        ("image: image.png\nresolution: 0", "resolution"),
        ("image: image.png\nresolution: .inf", "resolution"),
        (f"{_GOOD}origin: [0]", "origin"),
        (f"{_GOOD}origin: [0, .nan, 0]", "origin"),
        (f"{_GOOD}origin: [0, 0, 0.5]", "yaw"),
        (f"{_GOOD}mode: colour", "mode"),
        (f"{_GOOD}occupied_thresh: x", "occupied"),
        (f"{_GOOD}occupied_thresh: 0.1\nfree_thresh: 0.6", "free_thresh"),
    ],
)
def test_an_error_in_a_description_is_one_line(
    content: str | None, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.pgm").write_text("no image at all")
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "image.png")
    if content is not None:
        (tmp_path / "bad.yaml").write_text(content)
    with pytest.raises(InputError) as error:
        read_map(tmp_path / "bad.yaml")
    assert named in str(error.value)
    assert str(tmp_path / "bad.yaml") in str(error.value)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "ran").exists()
