"""Grid maps, read back as map_server would read them."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.app.folder.map_files import read_map, write_grid
from ffmap.loaders.errors import InputError


class TestGrid:
    GRID = GridMap(
        np.array([[Cell.OCCUPIED, Cell.FREE, Cell.UNKNOWN], [Cell.FREE, Cell.FREE, Cell.OCCUPIED]], np.uint8),
        np.array([-1.5, 2.25]),
        0.05,
    )

    def test_as_pillow_and_yaml_read_it(self, tmp_path: Path):
        write_grid(tmp_path / "map.yaml", self.GRID)
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
        with Image.open(tmp_path / "map.pgm") as image:
            assert (image.format, image.mode, image.size) == ("PPM", "L", (3, 2))
            pixels = np.asarray(image)
        assert pixels.tolist() == [[254, 254, 0], [0, 254, 205]]

    def test_the_thresholds_tell_the_three_apart_as_map_server_does(self, tmp_path: Path):
        write_grid(tmp_path / "map.yaml", self.GRID)
        back = read_map(tmp_path / "map.yaml")
        np.testing.assert_array_equal(back.cells, self.GRID.cells)
        np.testing.assert_allclose(back.origin, self.GRID.origin)

    @pytest.mark.parametrize("name", ["map.jpg", "map.webp"])
    @pytest.mark.parametrize("described", [False, True])
    def test_lossy_compression_changes_no_cell(self, tmp_path: Path, name: str, described: bool):
        rooms = np.full((80, 120), Cell.UNKNOWN, np.uint8)
        rooms[10:70, 10:110] = Cell.FREE
        rooms[10, 10:110] = rooms[69, 10:110] = rooms[10:70, 10] = rooms[10:70, 109] = rooms[10:55, 60] = Cell.OCCUPIED
        Image.fromarray(rooms[::-1]).save(tmp_path / name, quality=85)
        with Image.open(tmp_path / name) as image:
            assert len(np.unique(np.asarray(image.convert("L")))) > 10
        (tmp_path / "map.yaml").write_text(f"image: {name}\nresolution: 0.05\norigin: [0, 0, 0]\n")
        back = read_map(tmp_path / ("map.yaml" if described else name), None if described else 0.05)
        np.testing.assert_array_equal(back.cells, rooms)

    def test_a_mode_in_capitals_and_an_image_that_was_moved_with_its_yaml(self, tmp_path: Path):
        write_grid(tmp_path / "map.yaml", self.GRID)
        text = (tmp_path / "map.yaml").read_text()
        moved = text.replace("mode: trinary", "mode: Trinary").replace("map.pgm", "/home/robot/maps/map.pgm")
        (tmp_path / "map.yaml").write_text(moved)
        np.testing.assert_array_equal(read_map(tmp_path / "map.yaml").cells, self.GRID.cells)
        (tmp_path / "map.pgm").unlink()
        with pytest.raises(InputError, match=r"/home/robot/maps/map\.pgm: is not there"):
            read_map(tmp_path / "map.yaml")

_THRESHOLDS = "negate: 0\noccupied_thresh: 0.6\nfree_thresh: 0.2\n"


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (None, "is not there"),
        ("not: [yaml", "is no valid YAML"),
        ("5", "holds no keys"),
        ("image: gone.pgm\nresolution: 0.1\n", "gone.pgm"),
        ("image: text.pgm\nresolution: 0.1\n", "text.pgm"),
        (f"image: image.png\n{_THRESHOLDS}origin: [0, 0, 0]\n", "resolution"),
        (f"image: image.png\n{_THRESHOLDS}origin: [0]\nresolution: 0.1\n", "origin"),
        (f"image: image.png\n{_THRESHOLDS}origin: [0, 0, 0]\nresolution: 0\n", "resolution"),
        ("image: image.png\noccupied_thresh: x\norigin: [0, 0, 0]\nresolution: 1\n", "occupied"),
    ],
)
def test_a_description_that_is_no_map_is_one_line(
    content: str | None, named: str, tmp_path: Path
) -> None:
    (tmp_path / "text.pgm").write_text("no image at all")
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "image.png")
    if content is not None:
        (tmp_path / "bad.yaml").write_text(content)
    with pytest.raises(InputError) as error:
        read_map(tmp_path / "bad.yaml")
    assert named in str(error.value)
    assert str(tmp_path / "bad.yaml") in str(error.value)
    assert "\n" not in str(error.value)
