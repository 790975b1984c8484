"""`ffmap rooms` as a user meets it: maps of other systems, truth, and files that are no maps."""

import json
import os
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
import yaml
from PIL import Image
from rerun.chunk import RrdReader

from ffmap.app.commands import rooms as rooms_command
from tests.program import ffmap_here

AREAS_M2 = {"left": 4.0 * 5.0, "right": 5.0 * 5.0}


@pytest.fixture
def ffmap(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Runs a command in an empty folder; returns exit code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> tuple[int, str, str]:
        done = ffmap_here({**os.environ, "COLUMNS": "150"}, *words)
        return done.returncode, done.stdout, done.stderr

    return run


def two_rooms(free: int = 254, wall: int = 0, outside: int = 205) -> np.ndarray:
    """Rooms of 4 × 5 m and 5 × 5 m with a door of 0.9 m between them; the first row is the top."""
    pixels = np.full((140, 220), outside, np.uint8)
    pixels[16:124, 16:206] = wall
    pixels[20:120, 20:100] = free
    pixels[20:120, 102:202] = free
    pixels[60:78, 100:102] = free
    return pixels


def save(path: Path, pixels: np.ndarray) -> Path:
    Image.fromarray(pixels).save(path)
    return path


def save_map(folder: Path, pixels: np.ndarray, **description: object) -> Path:
    save(folder / "map.pgm", pixels)
    path = folder / "map.yaml"
    values = {
        "image": "map.pgm",
        "resolution": 0.05,
        "origin": [-3.0, 2.0, 0.0],
        "negate": 0,
        **description,
    }
    path.write_text(yaml.safe_dump({"occupied_thresh": 0.65, "free_thresh": 0.25, **values}))
    return path


def features(out: Path) -> list[dict]:
    return json.loads((out / "rooms.geojson").read_text())["features"]


def room_in_the_middle() -> np.ndarray:
    """A room of 4.5 × 4.5 m within a corridor around it; its door of 0.9 m is in the lower wall."""
    pixels = np.full((240, 240), 205, np.uint8)
    pixels[16:224, 16:224] = 0
    pixels[20:220, 20:220] = 254
    pixels[70:170, 70:170] = 0
    pixels[75:165, 75:165] = 254
    pixels[165:170, 110:128] = 254
    return pixels


def osm_ways(path: Path) -> list[tuple[dict[str, str], list[tuple[float, float]]]]:
    """Tags and corners (m) of each way, by what Feng et al. document of osmAG and WGS 84."""
    file = ElementTree.parse(path).getroot()
    at = {
        node.attrib["id"]: (
            np.deg2rad(float(node.attrib["lon"])) * 6378137.0,
            np.deg2rad(float(node.attrib["lat"])) * 6378137.0 * (1 - 0.00669437999014),
        )
        for node in file.iter("node")
    }
    (root,) = (node for node in file.iter("node") if node.find("tag[@v='root']") is not None)
    assert at[root.attrib["id"]] == (0.0, 0.0)
    return [
        (
            {tag.attrib["k"]: tag.attrib["v"] for tag in way.iter("tag")},
            [at[nd.attrib["ref"]] for nd in way.iter("nd")],
        )
        for way in file.iter("way")
    ]


def assert_one_line(result: tuple[int, str, str], *words: str) -> None:
    code, _, err = result
    assert code == 2
    assert len(err.strip().splitlines()) == 1, err
    for word in words:
        assert word in err


def test_a_map_of_map_servers_gives_outlines_areas_and_topology_in_its_frame(
    ffmap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    code, out, err = ffmap("rooms", save_map(tmp_path, two_rooms()), "--out", "found")
    assert code == 0, err
    # A command that is to be copied is not broken, however narrow the terminal.
    assert re.search(r"view (--web )?found/rooms\.rrd$", out, re.MULTILINE)
    assert "room 1" in out
    assert "25.0" in out
    right, left = features(tmp_path / "found")
    assert right["properties"]["name"] == "room 1"
    assert right["properties"]["neighbours"] == [left["properties"]["name"]]
    assert right["properties"]["area"] == pytest.approx(AREAS_M2["right"], rel=0.02)
    assert left["properties"]["area"] == pytest.approx(AREAS_M2["left"], rel=0.02)
    # Columns 20 to 100 of 220 and rows 20 to 120 from the top of 140, from the corner (-3, 2).
    expected = shapely.box(-3 + 1.0, 2 + 1.0, -3 + 5.0, 2 + 6.0)
    polygon = shapely.geometry.shape(left["geometry"])
    assert polygon.symmetric_difference(expected).area < 0.2
    topology = json.loads((tmp_path / "found" / "topology.json").read_text())
    (passage,) = topology["passages"]
    assert passage["rooms"] == ["room 1", "room 2"]
    assert passage["door"] is None
    assert passage["width_m"] == pytest.approx(0.9, abs=0.1)
    np.testing.assert_allclose(passage["middle"], [-3 + 5.05, 2 + 3.55], atol=0.15)
    assert not list((tmp_path / "found").glob("*.part"))


@pytest.mark.parametrize("drawn", [two_rooms, room_in_the_middle])
def test_the_area_graph_is_written_for_osmag(ffmap, tmp_path: Path, drawn) -> None:
    code, _, err = ffmap("rooms", save_map(tmp_path, drawn()), "--out", "found")
    assert code == 0, err
    ways = osm_ways(tmp_path / "found" / "rooms.osm")
    rings = {tags["name"]: ring for tags, ring in ways if tags["osmAG:type"] == "area"}
    building = shapely.Polygon(rings.pop("building"))
    rooms = features(tmp_path / "found")
    assert list(rings) == [room["properties"]["name"] for room in rooms] == ["room 1", "room 2"]
    for room, ring in zip(rooms, rings.values(), strict=True):
        assert ring[0] == ring[-1]
        assert building.buffer(1e-6).covers(shapely.LinearRing(ring))
        # A doorway is added, and a hole is cut open.
        assert shapely.Polygon(ring).area == pytest.approx(room["properties"]["area"], abs=0.3)
        outline = shapely.geometry.shape(room["geometry"]).boundary
        off_m = shapely.distance(outline, shapely.points(ring))
        assert np.count_nonzero(off_m > 1e-3) <= 2
    ((tags, ends),) = (way for way in ways if way[0]["osmAG:type"] == "passage")
    assert {tags["osmAG:from"], tags["osmAG:to"]} == set(rings)
    assert shapely.LineString(ends).length == pytest.approx(0.9, abs=0.1)
    for ring in rings.values():
        assert set(ends) <= set(ring)


def test_rooms_of_another_map_of_the_same_name_are_left_alone(ffmap, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        save_map(tmp_path / name, two_rooms())
    assert ffmap("rooms", tmp_path / "a" / "map.yaml")[0] == 0
    before = (tmp_path / "rooms" / "map" / "rooms.geojson").stat().st_mtime_ns
    other = tmp_path / "b" / "map.yaml"
    assert_one_line(ffmap("rooms", other), "rooms/map", str(tmp_path / "a" / "map.yaml"), "--out")
    assert (tmp_path / "rooms" / "map" / "rooms.geojson").stat().st_mtime_ns == before
    assert ffmap("rooms", other, "--out", tmp_path / "rooms" / "map")[0] == 0


def test_what_is_not_of_the_maps_rooms_is_left_alone(ffmap, tmp_path: Path) -> None:
    save(tmp_path / "rooms.png", two_rooms())
    options = ("rooms.png", "--resolution", 0.05, "--out")
    for folder, name, content in (
        ("thesis", "rooms.geojson", "mine"),
        ("run", "rooms.geojson", "a run's"),
        ("measured", "metrics.json", "mine"),
        ("other", "topology.json", "{}"),
    ):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_text(content)
    (tmp_path / "run" / "run.json").write_text("{}")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert_one_line(ffmap("rooms", *options, "."), "rooms.png: is read")
    assert_one_line(ffmap("rooms", *options, "thesis"), "rooms.geojson: is there already")
    assert_one_line(ffmap("rooms", *options, "run"), "belongs to the run")
    assert_one_line(ffmap("rooms", *options, "measured"), "metrics.json")
    assert_one_line(ffmap("rooms", *options, "other"), "topology.json")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    for _ in range(2):
        assert ffmap("rooms", *options, "found")[0] == 0


def test_the_picture_and_the_recording_show_the_rooms(ffmap, tmp_path: Path) -> None:
    save(tmp_path / "floor.png", two_rooms())
    assert ffmap("rooms", "floor.png", "--resolution", 0.05)[0] == 0
    out = tmp_path / "rooms" / "floor"
    with Image.open(out / "rooms.png") as image:
        pixels = np.asarray(image.convert("RGB"))
    left, right = pixels[pixels.shape[0] // 4, [pixels.shape[1] // 4, 3 * pixels.shape[1] // 4]]
    assert min(np.ptp(left), np.ptp(right)) > 40
    assert np.abs(left.astype(int) - right).max() > 40
    paths = {chunk.entity_path for chunk in RrdReader(out / "rooms.rrd").stream()}
    assert {f"/world/rooms/{part}" for part in ("floors", "names", "passages")} <= paths
    assert "/rooms/graph" in paths


def test_truth_gives_recall_and_precision_and_a_folder_their_means(ffmap, tmp_path: Path) -> None:
    parted = two_rooms(free=255)
    parted[60:78, 100:102] = 120
    save(tmp_path / "a_gt_segmentation.png", parted)
    save(tmp_path / "a.png", two_rooms(free=255))
    furnished = two_rooms(free=255)
    furnished[40:44, 40:44] = furnished[80:90, 150:160] = 0
    save(tmp_path / "a_furnitures.png", furnished)
    whole = two_rooms(free=255)
    whole[20:120, 100:102] = 255
    save(tmp_path / "b.png", whole)
    save(tmp_path / "b_gt_segmentation.png", parted)
    code, out, _ = ffmap(
        "rooms", "a.png", "--resolution", 0.05, "--truth", "a_gt_segmentation.png", "--out", "one"
    )
    assert code == 0
    assert "2 rooms for 2 true ones" in out
    figures = json.loads((tmp_path / "one" / "metrics.json").read_text())
    assert figures["rooms.recall"] > 0.995
    assert figures["rooms.precision"] > 0.995
    code, out, err = ffmap("rooms", tmp_path, "--resolution", 0.05, "--out", "many")
    assert code == 0, err
    merged = json.loads((tmp_path / "many" / "b" / "metrics.json").read_text())
    assert (merged["rooms.true"], merged["rooms.found"], merged["rooms.merged"]) == (2, 1, 1)
    assert merged["rooms.precision"] == pytest.approx(25 / 45, abs=0.02)
    assert "mean of 2 plain" in out
    assert "mean of 1 furnitures" in out


def test_a_map_that_fails_leaves_the_others_of_its_folder(
    ffmap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in "abc":
        save(tmp_path / f"{name}.png", two_rooms(free=255))
        save(tmp_path / f"{name}_gt_segmentation.png", two_rooms(free=255))
    (tmp_path / "a.png").write_text("no image")
    segment = rooms_command.find_rooms
    maps = iter(["b", "c"])

    def failing(*given: object) -> object:
        if next(maps) == "b":
            raise ValueError("a fault of ours")
        return segment(*given)

    monkeypatch.setattr(rooms_command, "find_rooms", failing)
    code, out, err = ffmap("rooms", tmp_path, "--resolution", 0.05, "--out", "found")
    assert code == 2
    assert "│ c " in out
    assert "mean of 1 plain" in out
    unreadable, fault = err.splitlines()
    assert "a.png" in unreadable
    assert "b.png: could not be segmented (ValueError: a fault of ours)" in fault
    (tmp_path / "b.png").unlink()
    (tmp_path / "c.png").unlink()
    assert_one_line(ffmap("rooms", tmp_path, "--resolution", 0.05, "--out", "none"), "a.png")


def test_known_doors_part_rooms(ffmap, tmp_path: Path) -> None:
    pixels = two_rooms()
    pixels[24:116, 100:102] = 254  # an opening of 4.6 m between rooms of 5 m
    path = save_map(tmp_path, pixels)
    assert ffmap("rooms", path, "--out", "without")[0] == 0
    assert len(features(tmp_path / "without")) == 1
    sill = [[-3 + 5.05, 2 + 1.2], [-3 + 5.05, 2 + 5.8]]
    doors = {
        "features": [{"type": "Feature", "geometry": {"type": "LineString", "coordinates": sill}}]
    }
    (tmp_path / "doors.geojson").write_text(json.dumps(doors))
    assert ffmap("rooms", path, "--doors", "doors.geojson", "--out", "with")[0] == 0
    assert [feature["properties"]["doors"] for feature in features(tmp_path / "with")] == [[0], [0]]


def test_what_is_no_map_is_refused_in_one_line(ffmap, tmp_path: Path) -> None:
    whole = save(tmp_path / "good.png", two_rooms()).read_bytes()
    save(tmp_path / "black.png", np.zeros((9, 9), np.uint8))
    save(tmp_path / "one.png", np.full((1, 1), 254, np.uint8))
    save(tmp_path / "small.png", np.full((9, 9), 255, np.uint8))
    (tmp_path / "text.png").write_text("no image")
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "doors.geojson").write_text("[]")
    (tmp_path / "file").write_text("")
    for words, named in (
        (["nothing.yaml"], "is not there"),
        (["good.png"], "--resolution"),
        (["good.png", "--resolution", "nan"], "--resolution"),
        (["black.png", "--resolution", 0.05], "no free cell"),
        (["one.png", "--resolution", 0.05], "no room"),
        (["text.png", "--resolution", 0.05], "no image"),
        (["cut.png", "--resolution", 0.05], "cut.png"),
        (["good.png", "--resolution", 0.05, "--truth", "small.png"], "9 × 9"),
        ([".", "--resolution", 0.05], "no map has rooms beside it"),
        (["good.png", "--resolution", 0.05, "--doors", "doors.geojson"], "doors.geojson"),
        (["good.png", "--resolution", 0.05, "--out", "file"], "file"),
        (["good.png", "--resolution", 0.05, "--set", "area_graph.nothing=1"], "nothing"),
    ):
        assert_one_line(ffmap("rooms", *words), named)
