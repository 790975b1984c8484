"""The plan's files, read back: what is drawn where, in what units, on which layers."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
import shapely

from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.floor_plan import FloorPlan, Leaf, PlanDoor
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.folder.plan_files import LAYERS, MM_PER_M, write_dxf, write_svg

SVG = "{http://www.w3.org/2000/svg}"
PARTS = ("rooms", "assumeds", "walls", "columns", "windows", "doors")


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
    walls=(
        shapely.box(0.0, 0.0, 1.0, 0.2),
        shapely.box(3.0, 0.0, 8.0, 4.0).difference(shapely.box(3.2, 0.2, 7.8, 3.8)),
    ),
    assumed=(shapely.box(-2.0, 0.0, 0.0, 0.15),),
    columns=(shapely.box(5.0, 2.0, 5.4, 2.4),),
    doors=(door(DoorState.OPEN, 1.0, (LEAF,)), door(DoorState.CLOSED, 2.0), door(DoorState.OPEN, -1.5)),
    windows=(shapely.box(4.0, 0.0, 5.0, 0.2),),
    rooms=(Room("Room 1", shapely.box(3.2, 0.2, 7.8, 3.8), 16.56), Room("<R&D>", shapely.box(0, 0.2, 3, 4), 11.4)),
    direction_deg=0.0,
)
EMPTY = FloorPlan((), (), (), (), (), (), 0.0)
TURN_DEG = -22.0


def turned_plan() -> FloorPlan:
    """The same building in a map whose x axis lies 22° off its walls."""

    def area(polygon: shapely.Polygon) -> shapely.Polygon:
        return shapely.transform(polygon, lambda xy: turned(xy, TURN_DEG))

    doors = tuple(
        PlanDoor(
            area(d.outline),
            turned(d.sill, TURN_DEG),
            turned(d.closed, TURN_DEG),
            d.state,
            tuple(Leaf(turned(o.hinge, TURN_DEG), turned(o.tip, TURN_DEG), o.swing_deg, o.share) for o in d.leaves),
        )
        for d in PLAN.doors
    )
    parts = [tuple(area(p) for p in own) for own in (PLAN.walls, PLAN.assumed, PLAN.columns, PLAN.windows)]
    rooms = tuple(Room(room.name, area(room.polygon), room.area_m2) for room in PLAN.rooms)
    return FloorPlan(parts[0], parts[1], parts[2], doors, parts[3], rooms, TURN_DEG)


def group(root: ElementTree.Element, name: str) -> ElementTree.Element:
    found = root.find(f"{SVG}g[@id='{name}']")
    assert found is not None
    return found


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
    kinds = [p.get("class") for name in ("doors", "rooms") for p in group(root, name).iter(f"{SVG}path")]
    assert kinds.count("swing") == 1
    assert kinds.count("leaf") == 2
    assert kinds.count("unknown") == 1
    assert kinds.count("room") == 2
    texts = [t.text for t in root.iter(f"{SVG}text")]
    for words in ("Room 1", "<R&D>", "16.6 m²", "x", "y", "5", "m"):
        assert words in texts
    swing = next(p.get("d", "") for p in group(root, "doors") if p.get("class") == "swing")
    start, end = numbers(swing)
    # From where the leaf is when shut, along the wall, to where it stood, a quarter turn counter-clockwise in the map.
    np.testing.assert_allclose(end - start, [-0.9 * MM_PER_M, -0.9 * MM_PER_M], atol=0.02)
    assert " 0 0 0 " in swing


@pytest.mark.parametrize("name", ["rooms", "assumeds", "walls", "columns", "windows", "doors", "room-names"])
def test_the_plan_is_drawn_square_to_its_walls(tmp_path: Path, name: str):
    write_svg(tmp_path / "plan.svg", PLAN, "drive.bag")
    write_svg(tmp_path / "turned.svg", turned_plan(), "drive.bag")
    straight, other = (group(ElementTree.parse(tmp_path / f"{n}.svg").getroot(), name) for n in ("plan", "turned"))
    assert len(straight) == len(other) > 0
    for one, same in zip(straight, other, strict=True):
        assert one.text == same.text
        for key in ("x", "y"):
            assert float(same.get(key, 0)) == pytest.approx(float(one.get(key, 0)), abs=0.011)
        np.testing.assert_allclose(numbers(same.get("d", "")), numbers(one.get("d", "")), atol=0.011)


def test_the_axes_of_the_map_are_turned_with_the_plan(tmp_path: Path):
    write_svg(tmp_path / "plan.svg", turned_plan(), "drive.bag")
    foot = group(ElementTree.parse(tmp_path / "plan.svg").getroot(), "foot")
    arrows = [numbers(p.get("d", ""))[:2] for p in foot.iter(f"{SVG}path")][1:]
    along = [np.degrees(np.arctan2(-(tip - origin)[1], (tip - origin)[0])) for origin, tip in arrows]
    assert along == pytest.approx([22.0, 112.0], abs=0.1)
    assert "turned by 22.0° to draw walls square" in [t.text for t in foot.iter(f"{SVG}text")]


def test_the_legend_tells_what_occurs_and_nothing_else(tmp_path: Path):
    def legend(plan: FloorPlan) -> tuple[list[str | None], set[str | None]]:
        write_svg(tmp_path / "plan.svg", plan, "drive.bag")
        root = ElementTree.parse(tmp_path / "plan.svg").getroot()
        assert all(
            0 <= float(t.get("y", -1)) <= float(root.get("viewBox", "").split()[3]) for t in root.iter(f"{SVG}text")
        )
        own = group(root, "legend")
        drawn = {p.get("class") for name in PARTS for p in root.iterfind(f"{SVG}g[@id='{name}']/{SVG}path")}
        assert drawn - {"doorway"} <= {e.get("class") for e in own}
        return [t.text for t in own.iter(f"{SVG}text")], drawn

    assert legend(PLAN)[0] == [
        "wall, both sides seen",
        "wall, one side seen, its thickness assumed",
        "column",
        "window",
        "closed door",
        "open door, its leaf as it stood",
        "open doorway, no leaf seen",
        "room as far as seen; colours tell rooms apart",
    ]
    assert legend(PLAN)[1] >= {"wall", "assumed", "column", "window", "pane", "leaf", "swing", "unknown", "room"}
    assert legend(EMPTY)[0] == []
    assert legend(replace(PLAN, columns=(), windows=(), doors=PLAN.doors[1:2]))[0] == [
        "wall, both sides seen",
        "wall, one side seen, its thickness assumed",
        "closed door",
        "room as far as seen; colours tell rooms apart",
    ]


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
    np.testing.assert_allclose(np.array(view.dxf.center)[:2], [3.0, 2.0], atol=1e-6)
    axes = document.ucs.get("WALLS")
    np.testing.assert_allclose(np.array(axes.dxf.xaxis)[:2], turned(np.array([1.0, 0.0]), TURN_DEG))
    assert [text.dxf.rotation for text in document.modelspace().query("TEXT")] == pytest.approx([TURN_DEG] * 4)


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
