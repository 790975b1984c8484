"""ffmap maps as a user meets it: a reference that lies elsewhere, one of another building, and mistakes."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from algorithms.grid_map import Cell, GridMap
from app import cli
from app.map_figures import TITLES, ComparedMap, map_metrics, maps_table, write_overlays
from app.results import write_grid
from app.run_folder import REFERENCE_JSON, REFERENCE_OVERLAY, map_file
from tests.algorithms.test_map_comparison import OTHER, PLAN, moved, raster


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


def ffmap(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr("sys.argv", ["ffmap", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


def test_every_map_is_aligned_and_compared(folder, monkeypatch, capsys):
    assert ffmap(monkeypatch, "maps", folder / "run", "--reference", folder / "reference.yaml") == 0
    out = capsys.readouterr().out
    assert "turned by 40." in out or "turned by 39." in out
    found = json.loads((folder / "run" / REFERENCE_JSON).read_text())
    np.testing.assert_allclose(np.array(found["T_reference_map"])[:2, 2], [5.0, -2.0], atol=0.05)
    assert list(found["maps"]) == [str(name) for name in TITLES]
    own = found["maps"]["furniture_free"]
    assert own["precision"] > 0.99
    assert own["recall"] > 0.99
    assert own["error_m"] < 0.03
    assert all(own["precision"] > rival["precision"] for name, rival in found["maps"].items() if name != "furniture_free")
    with Image.open(folder / "run" / REFERENCE_OVERLAY) as picture:
        assert picture.width > 5 * 180
    assert not list((folder / "run").glob("*.part"))


def test_another_building_is_told(folder, monkeypatch, capsys):
    assert ffmap(monkeypatch, "maps", folder / "run", "--reference", folder / "other.yaml") == 2
    error = capsys.readouterr().err
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
        ("image: image.png\nnegate: 0\noccupied_thresh: 0.6\nfree_thresh: 0.2\norigin: [0]\nresolution: 0.1\n", "origin"),
        ("image: image.png\noccupied_thresh: x\nfree_thresh: 0.2\norigin: [0, 0, 0]\nresolution: 1\n", "occupied_thresh"),
        ("image: image.png\nnegate: 0\noccupied_thresh: 0.6\nfree_thresh: 0.2\norigin: [0, 0, 0]\nresolution: 0\n", "resolution"),
    ],
)
def test_a_reference_that_is_no_map_is_one_line(content, named, folder, tmp_path, monkeypatch, capsys):
    (tmp_path / "text.pgm").write_text("no image at all")
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "image.png")
    if content is not None:
        (tmp_path / "bad.yaml").write_text(content)
    assert ffmap(monkeypatch, "maps", folder / "run", "--reference", tmp_path / "bad.yaml") == 2
    error = capsys.readouterr().err
    assert named in error
    assert str(tmp_path / "bad.yaml") in error
    assert len(error.strip().splitlines()) == 1


def test_a_folder_without_a_run_or_without_maps_is_one_line(folder, tmp_path, monkeypatch, capsys):
    assert ffmap(monkeypatch, "maps", tmp_path, "--reference", folder / "reference.yaml") == 2
    assert "no run folder" in capsys.readouterr().err
    (tmp_path / "run.json").write_text("{}")
    assert ffmap(monkeypatch, "maps", tmp_path, "--reference", folder / "reference.yaml") == 2
    assert "map.yaml" in capsys.readouterr().err


def test_an_image_of_a_picture_program_is_read(folder, tmp_path, monkeypatch):
    grid = raster(PLAN)
    Image.fromarray(grid.cells[::-1]).convert("RGBA").save(tmp_path / "plan.png")
    description = {"image": "plan.png", "resolution": 0.05, "origin": [0, 0, 0], "negate": 0}
    description |= {"occupied_thresh": 0.65, "free_thresh": 0.196}
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump(description))
    assert ffmap(monkeypatch, "maps", folder / "run", "--reference", tmp_path / "plan.yaml") == 0


def test_doors_and_cabinets_are_in_the_table(tmp_path):
    from algorithms.evaluation import WallMapFigures

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
    write_overlays(tmp_path / "overlay.png", compared, "truth")
    with Image.open(tmp_path / "overlay.png") as picture:
        colours = {colour for _, colour in picture.convert("RGB").getcolors(1 << 20) or []}
    assert {(20, 140, 60), (240, 50, 50), (255, 150, 0)} <= colours
