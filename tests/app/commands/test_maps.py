"""ffmap maps as a user meets it: a reference that lies elsewhere, one of another building, and mistakes."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.maps import Agreement, ComparedMap, WallMapFigures
from ffmap.app.analysis import map_figures
from ffmap.app.analysis.map_figures import (
    TITLES,
    map_metrics,
    maps_table,
    walls_direction_deg,
    write_overlays,
)
from ffmap.app.folder.atomic import write_geojson
from ffmap.app.folder.map_files import write_grid
from ffmap.app.folder.names import REFERENCE_JSON, REFERENCE_OVERLAY, WALLS, map_file
from ffmap.loaders.errors import InputError
from tests.algorithms.truth.test_reference import OTHER, PLAN, moved, raster
from tests.program import ffmap_here


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with maps alone, and references beside it."""
    folder = tmp_path_factory.mktemp("maps")
    run = folder / "run"
    run.mkdir()
    (run / "run.json").write_text('{"outcome": "complete"}')
    for name in TITLES:
        write_grid(run / map_file(name), raster(PLAN, furniture=0 if name == "furniture_free" else 300))
    write_grid(folder / "reference.yaml", raster(moved(PLAN, 40.0, (5.0, -2.0))))
    write_grid(folder / "other.yaml", raster(OTHER))
    return folder


def test_every_map_is_aligned_and_compared(folder):
    done = ffmap_here(dict(os.environ), "maps", folder / "run", "--reference", folder / "reference.yaml")
    assert done.returncode == 0
    out = done.stdout
    assert "turned by 40." in out or "turned by 39." in out
    found = json.loads((folder / "run" / REFERENCE_JSON).read_text())
    np.testing.assert_allclose(np.array(found["T_reference_map"])[:2, 2], [5.0, -2.0], atol=0.05)
    assert list(found["maps"]) == [str(name) for name in TITLES]
    own = found["maps"]["furniture_free"]
    assert own["precision"] > 0.99
    assert own["recall"] > 0.99
    assert own["error_m"] < 0.03
    assert all(
        own["precision"] > rival["precision"] for name, rival in found["maps"].items() if name != "furniture_free"
    )
    with Image.open(folder / "run" / REFERENCE_OVERLAY) as picture:
        assert picture.width > 2 * 1200
    assert not list((folder / "run").glob("*.part"))


def test_another_building_is_told(folder):
    done = ffmap_here(dict(os.environ), "maps", folder / "run", "--reference", folder / "other.yaml")
    assert done.returncode == 2
    error = done.stderr
    assert "does not fit" in error
    assert len(error.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (None, "is not there"),
        ("not: [yaml", "is no valid YAML"),
        ("5", "holds no keys"),
        ("image: gone.pgm\nresolution: 0.1\n", "gone.pgm"),
        ("image: text.pgm\nresolution: 0.1\n", "text.pgm"),
        ("image: image.png\nnegate: 0\noccupied_thresh: 0.6\nfree_thresh: 0.2\norigin: [0, 0, 0]\n", "resolution"),
        (
            "image: image.png\nnegate: 0\noccupied_thresh: 0.6\nfree_thresh: 0.2\norigin: [0]\nresolution: 0.1\n",
            "origin",
        ),
        (
            "image: image.png\noccupied_thresh: x\nfree_thresh: 0.2\norigin: [0, 0, 0]\nresolution: 1\n",
            "occupied_thresh",
        ),
        (
            "image: image.png\nnegate: 0\noccupied_thresh: 0.6\nfree_thresh: 0.2\norigin: [0, 0, 0]\nresolution: 0\n",
            "resolution",
        ),
    ],
)
def test_a_reference_that_is_no_map_is_one_line(content, named, folder, tmp_path):
    (tmp_path / "text.pgm").write_text("no image at all")
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "image.png")
    if content is not None:
        (tmp_path / "bad.yaml").write_text(content)
    done = ffmap_here(dict(os.environ), "maps", folder / "run", "--reference", tmp_path / "bad.yaml")
    assert done.returncode == 2
    error = done.stderr
    assert named in error
    assert str(tmp_path / "bad.yaml") in error
    assert len(error.strip().splitlines()) == 1


def test_a_folder_without_a_run_or_without_maps_is_one_line(folder, tmp_path):
    done = ffmap_here(dict(os.environ), "maps", tmp_path, "--reference", folder / "reference.yaml")
    assert done.returncode == 2
    assert "no run folder" in done.stderr
    (tmp_path / "run.json").write_text("{}")
    done = ffmap_here(dict(os.environ), "maps", tmp_path, "--reference", folder / "reference.yaml")
    assert done.returncode == 2
    assert "map.yaml" in done.stderr


def test_an_image_of_a_picture_program_is_read(folder, tmp_path):
    grid = raster(PLAN)
    Image.fromarray(grid.cells[::-1]).convert("RGBA").save(tmp_path / "plan.png")
    description = {"image": "plan.png", "resolution": 0.05, "origin": [0, 0, 0], "negate": 0}
    description |= {"occupied_thresh": 0.65, "free_thresh": 0.196}
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump(description))
    assert ffmap_here(dict(os.environ), "maps", folder / "run", "--reference", tmp_path / "plan.yaml").returncode == 0


def test_doors_and_cabinets_are_in_the_table(tmp_path):
    grid = GridMap(np.full((10, 10), Cell.FREE, np.uint8), np.zeros(2), 0.05)
    occupied = np.array([[0.1, 0.1], [0.2, 0.1], [0.3, 0.1], [0.4, 0.4]])
    figures = WallMapFigures(occupied, np.array([0.0, 0.02, 0.04, 0.3]), occupied[:2], np.array([True, False]))
    compared = {"furniture_free": ComparedMap(grid, figures, np.zeros((0, 2)), np.array([True, False, False]), 1)}
    own = map_metrics(compared)["furniture_free"]
    assert (own["precision"], own["recall"], own["error_m"]) == (0.75, 0.5, pytest.approx(0.02))
    assert (own["doors_passed"], own["doors_blocked"]) == (3, 1)
    assert (own["false_cells_of_cabinets"], own["precision_without_cabinets"]) == (1, 1.0)
    columns = [list(column.cells) for column in maps_table({"furniture_free": own}, "maps").columns]
    assert ["1 of 3"] in columns
    write_overlays(tmp_path / "overlay.png", compared, "truth", 0.0)
    with Image.open(tmp_path / "overlay.png") as picture:
        colours = {colour for _, colour in picture.convert("RGB").getcolors(1 << 20) or []}
    assert {(20, 140, 60), (240, 50, 50)} <= colours
    assert (255, 150, 0) not in colours  # neither on a map nor in the legend


GREEN, RED, ORANGE, FRAME, BLACK = (20, 140, 60), (240, 50, 50), (255, 150, 0), (90, 90, 90), (0, 0, 0)


def runs(along: np.ndarray, least: int) -> list[tuple[int, int]]:
    """Where values are true: begin and end of each run of at least `least` of them."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], along, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a >= least]


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, -44.0])
def test_the_overlay_shows_all_maps_alike_and_square_to_the_walls(tmp_path, direction_deg):
    wall = np.stack([np.linspace(-3.0, 3.0, 400), np.full(400, 1.0)], axis=1)
    floor = np.stack([axis.ravel() for axis in np.meshgrid(np.arange(-3, 3, 0.02), np.arange(-1, 1, 0.02))], axis=1)
    wall, floor = turned(wall, direction_deg), turned(floor, direction_deg)
    compared = {}
    for k, name in enumerate(list(TITLES)[:3]):
        origin = np.array([-6.0, -5.0]) - 0.05 * np.array([0, 40 * k])
        cells = np.full((200 + 60 * k, 240), Cell.UNKNOWN, np.uint8)
        for places, cell in ((floor, Cell.FREE), (wall, Cell.OCCUPIED)):
            column, row = np.floor((places - origin) / 0.05).astype(int).T
            cells[row, column] = cell
        grid = GridMap(cells, origin, 0.05)
        occupied = grid.centres(Cell.OCCUPIED)
        right = np.full(len(occupied), k != 1)
        figures = WallMapFigures(occupied, np.where(right, 0.0, 0.5), occupied, right)
        compared[str(name)] = ComparedMap(grid, figures, np.zeros((0, 2)))
    write_overlays(tmp_path / "overlay.png", compared, "truth", direction_deg)
    with Image.open(tmp_path / "overlay.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    frame, green, red, black = ((pixels == colour).all(axis=2) for colour in (FRAME, GREEN, RED, BLACK))
    sides = [(a, b) for row in frame[np.flatnonzero(frame.sum(axis=1) > 400)] for a, b in runs(row, 400)]
    assert len(sides) == 2 * len(compared)
    assert len({b - a for a, b in sides}) == 1
    # The wall of 6 m lies level in each picture, one cell thick or two, at one scale with the bar.
    px_per_m = ((sides[0][1] - sides[0][0]) - 2) / (6.0 + 2 * 0.5 + 0.05)
    for mask, pictures in ((green, 2), (red, 1)):
        level = np.flatnonzero(mask.sum(axis=1) > 300)
        assert 0.05 * px_per_m * 0.9 < len(level) / pictures < 0.05 * px_per_m * 2.5
        across = np.flatnonzero(mask[level[0]])
        assert across[-1] - across[0] == pytest.approx(6.0 * px_per_m, rel=0.03)
    bars = {run for row in black for run in runs(row, 100)}
    assert [b - a for a, b in bars] == [pytest.approx(2.0 * px_per_m, rel=0.03)]


def test_a_run_of_a_turned_building_gets_an_upright_overlay(folder, tmp_path):
    assert walls_direction_deg(folder / "run") == 0.0  # no walls, no turn
    ends = turned(np.array([[[0.0, 0.0], [4.0, 0.0]], [[0.0, 0.0], [0.0, 9.0]]]), 33.0)
    features = [{"properties": {}, "geometry": {"type": "LineString", "coordinates": line}} for line in ends]
    write_geojson(tmp_path / WALLS, features)
    assert walls_direction_deg(tmp_path) == pytest.approx(33.0)
    (tmp_path / WALLS).write_text("{}")
    with pytest.raises(InputError, match=WALLS):
        walls_direction_deg(tmp_path)


def test_no_wall_is_lost_where_a_large_map_is_drawn_small():
    agreement = np.full((7, 9), Agreement.FREE, np.uint8)
    agreement[0, 8], agreement[3, 3], agreement[4, 3], agreement[6, 0] = (
        *(Agreement.BOTH, Agreement.ONLY_REFERENCE),
        *(Agreement.BOTH, Agreement.NOTHING),
    )
    small = map_figures._coarsened(agreement, 3)
    assert small.tolist() == [
        [Agreement.FREE, Agreement.FREE, Agreement.BOTH],
        [Agreement.FREE, Agreement.ONLY_REFERENCE, Agreement.FREE],
        [Agreement.FREE, Agreement.FREE, Agreement.FREE],
    ]
