"""The plan's files, read back: what is drawn where, in what units, on which layers."""

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
import shapely

from algorithms.doors import DoorState
from algorithms.floor_plan import FloorPlan, Leaf, PlanDoor
from app.plan_files import LAYERS, MM_PER_M, write_dxf, write_svg

SVG = "{http://www.w3.org/2000/svg}"


@dataclass(frozen=True)
class Room:
    name: str
    polygon: shapely.Polygon
    area_m2: float


def door(state: DoorState, x: float, leaves: tuple[Leaf, ...] = ()) -> PlanDoor:
    sill = np.array([[x, 0.0], [x + 0.9, 0.0]])
    return PlanDoor(shapely.box(x, 0.0, x + 0.9, 0.2), sill, sill + np.array([0.0, 0.04]), state, leaves)


LEAF = Leaf(np.array([1.0, 0.2]), np.array([1.0, 1.1]), 90.0, 0.9)
PLAN = FloorPlan(
    walls=(shapely.box(0.0, 0.0, 1.0, 0.2), shapely.box(3.0, 0.0, 8.0, 4.0).difference(shapely.box(3.2, 0.2, 7.8, 3.8))),
    assumed=(shapely.box(-2.0, 0.0, 0.0, 0.15),),
    columns=(shapely.box(5.0, 2.0, 5.4, 2.4),),
    doors=(door(DoorState.OPEN, 1.0, (LEAF,)), door(DoorState.CLOSED, 2.0), door(DoorState.OPEN, -1.5)),
    windows=(shapely.box(4.0, 0.0, 5.0, 0.2),),
    rooms=(Room("Room 1", shapely.box(3.2, 0.2, 7.8, 3.8), 16.56), Room("<R&D>", shapely.box(0, 0.2, 3, 4), 11.4)),
)
EMPTY = FloorPlan((), (), (), (), (), ())


def numbers(path: str) -> np.ndarray:
    return np.array([[float(v) for v in pair] for pair in re.findall(r"(-?[\d.]+),(-?[\d.]+)", path)])


def test_svg_is_to_scale_with_y_up(tmp_path: Path):
    write_svg(tmp_path / "plan.svg", PLAN, "drive.bag")
    root = ElementTree.parse(tmp_path / "plan.svg").getroot()
    assert root.get("width", "").endswith("mm")
    walls = [numbers(p.get("d", "")) for p in root.iter(f"{SVG}path") if p.get("class") == "wall"]
    assert len(walls) == 2
    np.testing.assert_allclose(np.ptp(walls[0], axis=0), [1.0 * MM_PER_M, 0.2 * MM_PER_M])
    column = next(numbers(p.get("d", "")) for p in root.iter(f"{SVG}path") if p.get("class") == "column")
    # The column lies further up in the map than the first wall, so higher on paper.
    assert column[:, 1].max() < walls[0][:, 1].min()
    box = [float(v) for v in root.get("viewBox", "").split()]
    every = np.concatenate([numbers(p.get("d", "")) for p in root.iter(f"{SVG}path")])
    assert (every >= 0).all()
    assert (every <= box[2:]).all()


def test_svg_shows_doors_rooms_and_scale(tmp_path: Path):
    write_svg(tmp_path / "plan.svg", PLAN, "drive.bag")
    root = ElementTree.parse(tmp_path / "plan.svg").getroot()
    kinds = [p.get("class") for p in root.iter(f"{SVG}path")]
    assert kinds.count("swing") == 1
    assert kinds.count("leaf") == 2
    assert kinds.count("unknown") == 1
    assert kinds.count("room") == 2
    texts = [t.text for t in root.iter(f"{SVG}text")]
    for words in ("Room 1", "<R&D>", "16.6 m²", "x", "y", "5", "m"):
        assert words in texts
    swing = next(p.get("d", "") for p in root.iter(f"{SVG}path") if p.get("class") == "swing")
    start, end = numbers(swing)
    # From where the leaf is when shut, along the wall, to where it stood, a quarter turn counter-clockwise in the map.
    np.testing.assert_allclose(end - start, [-0.9 * MM_PER_M, -0.9 * MM_PER_M], atol=0.02)
    assert " 0 0 0 " in swing


def test_dxf_is_clean_and_in_metres(tmp_path: Path):
    write_dxf(tmp_path / "plan.dxf", PLAN)
    document = ezdxf.readfile(tmp_path / "plan.dxf")
    assert not document.audit().has_errors
    assert document.units == ezdxf.units.M
    space = document.modelspace()
    assert {entity.dxf.layer for entity in space} == set(LAYERS)
    outlines = [shapely.Polygon(p.get_points("xy")) for p in space.query('LWPOLYLINE[layer=="COLUMNS"]')]
    assert outlines[0].equals(PLAN.columns[0])
    assert len(space.query('HATCH[layer=="WALLS"]')) == 2
    assert len(space.query('LWPOLYLINE[layer=="WALLS"]')) == 3
    arc = space.query("ARC")[0]
    assert (arc.dxf.center.x, arc.dxf.center.y, arc.dxf.radius) == pytest.approx((1.0, 0.2, 0.9))
    assert (arc.dxf.start_angle % 360, arc.dxf.end_angle % 360) == pytest.approx((0.0, 90.0))
    assert {text.dxf.text for text in space.query("TEXT")} == {"Room 1", "16.6 m²", "<R&D>", "11.4 m²"}


def test_an_empty_plan_is_still_a_drawing(tmp_path: Path):
    write_svg(tmp_path / "plan.svg", EMPTY, "empty.bag")
    assert ElementTree.parse(tmp_path / "plan.svg").getroot().tag == f"{SVG}svg"
    write_dxf(tmp_path / "plan.dxf", EMPTY)
    assert not ezdxf.readfile(tmp_path / "plan.dxf").audit().has_errors
