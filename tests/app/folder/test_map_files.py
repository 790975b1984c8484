"""Grid maps, read back as map_server would read them."""

from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.app.folder.map_files import read_map, write_grid


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
