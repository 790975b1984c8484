"""The plan's files, read back: what is drawn where, in what units, on which layers."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
import shapely

from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.area_graph import Room
from ffmap.algorithms.maps.floor_plan import FloorPlan, PlanDoor
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.folder.pictures import INCHES_PER_M, PLAN_STYLES, write_floor_plan
from ffmap.app.folder.plan_dxf import LAYERS, write_dxf

SVG = "{http://www.w3.org/2000/svg}"


def door(state: DoorState, x: float) -> PlanDoor:
    sill = np.array([[x, 0.0], [x + 0.9, 0.0]])
    return PlanDoor(shapely.box(x, 0.0, x + 0.9, 0.2), sill, sill + np.array([0.0, 0.04]), state)


PLAN = FloorPlan(
    walls=(
        shapely.box(0.0, 0.0, 1.0, 0.2),
        shapely.box(3.0, 0.0, 8.0, 4.0).difference(shapely.box(3.2, 0.2, 7.8, 3.8)),
    ),
    assumed=(shapely.box(-2.0, 0.0, 0.0, 0.15),),
    columns=(shapely.box(5.0, 2.0, 5.4, 2.4),),
    doors=(
        door(DoorState.OPEN, 1.0),
        door(DoorState.CLOSED, 2.0),
        door(DoorState.OPEN, -1.5),
    ),
    windows=(shapely.box(4.0, 0.0, 5.0, 0.2),),
    rooms=(
        Room("Room 1", shapely.box(3.2, 0.2, 7.8, 3.8), 16.56, ()),
        Room("<R&D>", shapely.box(0, 0.2, 3, 4), 11.4, ()),
    ),
    direction_deg=0.0,
)
EMPTY = FloorPlan((), (), (), (), (), (), 0.0)
TURN_DEG = -22.0


def turned_plan() -> FloorPlan:
    """The same building in a map whose x axis lies 22° off its walls."""

    def area(polygon: shapely.Polygon) -> shapely.Polygon:
        return shapely.transform(polygon, lambda xy: turned(xy, TURN_DEG))

    doors = tuple(
        PlanDoor(area(d.outline), turned(d.sill, TURN_DEG), turned(d.closed, TURN_DEG), d.state)
        for d in PLAN.doors
    )
    parts = [
        tuple(area(p) for p in own)
        for own in (PLAN.walls, PLAN.assumed, PLAN.columns, PLAN.windows)
    ]
    rooms = tuple(replace(room, polygon=area(room.polygon)) for room in PLAN.rooms)
    return FloorPlan(parts[0], parts[1], parts[2], doors, parts[3], rooms, TURN_DEG)


PT_PER_M = 72 * INCHES_PER_M


def drawn(path: Path) -> dict[str, np.ndarray]:
    """Corners (n, 2) of each part by its name, in metres on the sheet, y up."""
    root = ElementTree.parse(path).getroot()
    height = float(root.get("viewBox", "").split()[3])
    found = {}
    for group in root.iter(f"{SVG}g"):
        name = group.get("id", "")
        if re.fullmatch(r"[a-z]+-\d+", name) and (outline := group.find(f"{SVG}path")) is not None:
            pairs = re.findall(r"[ML] (-?[\d.]+) (-?[\d.]+)", outline.get("d", ""))
            found[name] = np.array(pairs, float) * [1, -1] / PT_PER_M + [0, height / PT_PER_M]
    return found


def texts(path: Path) -> str:
    return " ".join(ElementTree.parse(path).getroot().itertext())


def test_the_plan_is_to_scale_with_y_up(tmp_path: Path) -> None:
    write_floor_plan(tmp_path / "plan.svg", PLAN, "drive.bag")
    parts = drawn(tmp_path / "plan.svg")
    wall, column = (
        next(v for k, v in parts.items() if k.startswith(kind)) for kind in ("wall", "column")
    )
    np.testing.assert_allclose(np.ptp(wall, axis=0), [1.0, 0.2], atol=1e-3)
    assert column[:, 1].min() > wall[:, 1].max()
    assert all((corners >= 0).all() for corners in parts.values())


def test_the_plan_shows_doors_rooms_and_scale(tmp_path: Path) -> None:
    write_floor_plan(tmp_path / "plan.svg", PLAN, "drive.bag")
    parts = drawn(tmp_path / "plan.svg")
    kinds = [name.split("-")[0] for name in parts]
    assert [kinds.count(kind) for kind in ("closed", "open", "room")] == [1, 2, 2]
    for words in ("Room 1", "<R&D>", "16.6 m²", "scale 1:100", "drive.bag"):
        assert words in texts(tmp_path / "plan.svg")


def test_the_plan_is_drawn_square_to_its_walls(tmp_path: Path) -> None:
    write_floor_plan(tmp_path / "plan.svg", PLAN, "drive.bag")
    write_floor_plan(tmp_path / "turned.svg", turned_plan(), "drive.bag")
    straight, other = drawn(tmp_path / "plan.svg"), drawn(tmp_path / "turned.svg")
    assert straight.keys() == other.keys()
    for name, corners in straight.items():
        np.testing.assert_allclose(other[name], corners, atol=2e-3)
    assert "turned by 22.0°" in texts(tmp_path / "turned.svg")


def test_the_legend_names_what_occurs_and_nothing_else(tmp_path: Path) -> None:
    def legend(plan: FloorPlan) -> set[str]:
        write_floor_plan(tmp_path / "plan.svg", plan, "drive.bag")
        written = texts(tmp_path / "plan.svg")
        return {kind for kind, label in labels.items() if label in written}

    labels = {kind: label for kind, (label, _) in PLAN_STYLES.items() if label is not None}
    assert legend(PLAN) == set(labels)
    assert legend(EMPTY) == set()
    some = replace(PLAN, columns=(), windows=(), doors=PLAN.doors[1:2])
    assert legend(some) == {"wall", "assumed", "closed", "room"}


def test_the_same_plan_is_the_same_file(tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg"):
        write_floor_plan(tmp_path / name, PLAN, "drive.bag")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_dxf_keeps_map_coordinates_and_opens_square(tmp_path: Path):
    plan = turned_plan()
    write_dxf(tmp_path / "plan.dxf", plan)
    document = ezdxf.readfile(tmp_path / "plan.dxf")
    assert not document.audit().has_errors
    column = document.modelspace().query('LWPOLYLINE[layer=="COLUMNS"]')[0]
    assert shapely.Polygon(column.get_points("xy")).equals_exact(plan.columns[0], 1e-9)
    (view,) = document.viewports.get_config("*Active")
    assert view.dxf.view_twist == pytest.approx(22.0)
    # The view's middle counts in its own, twisted, axes: there the plan lies as the straight one does.
    np.testing.assert_allclose(np.array(view.dxf.center)[:2], [3.0, 2.0], atol=0.01)
    axes = document.ucs.get("WALLS")
    np.testing.assert_allclose(np.array(axes.dxf.xaxis)[:2], turned(np.array([1.0, 0.0]), TURN_DEG))
    assert [text.dxf.rotation for text in document.modelspace().query("TEXT")] == pytest.approx(
        [TURN_DEG] * 4
    )


def test_dxf_is_clean_and_in_metres(tmp_path: Path):
    write_dxf(tmp_path / "plan.dxf", PLAN)
    document = ezdxf.readfile(tmp_path / "plan.dxf")
    assert not document.audit().has_errors
    assert document.units == ezdxf.units.M
    space = document.modelspace()
    assert {entity.dxf.layer for entity in space} == set(LAYERS)
    outlines = [
        shapely.Polygon(p.get_points("xy")) for p in space.query('LWPOLYLINE[layer=="COLUMNS"]')
    ]
    assert outlines[0].equals(PLAN.columns[0])
    assert len(space.query('HATCH[layer=="WALLS"]')) == 2
    assert len(space.query('LWPOLYLINE[layer=="WALLS"]')) == 3
    assert {text.dxf.text for text in space.query("TEXT")} == {
        "Room 1",
        "16.6 m²",
        "<R&D>",
        "11.4 m²",
    }


def test_an_empty_plan_is_still_a_drawing(tmp_path: Path):
    write_floor_plan(tmp_path / "plan.svg", EMPTY, "empty.bag")
    assert ElementTree.parse(tmp_path / "plan.svg").getroot().tag == f"{SVG}svg"
    write_dxf(tmp_path / "plan.dxf", EMPTY)
    assert not ezdxf.readfile(tmp_path / "plan.dxf").audit().has_errors
