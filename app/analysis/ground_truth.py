"""The ground truth of a bag: its building as arrays, and the true classes of its clouds."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.truth.doors import TrueDoors
from ffmap.algorithms.truth.elements import Element
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.names import METRICS
from ffmap.app.folder.room_files import outlines
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.text_files import read_object
from ffmap.loaders.truth import TruthClasses, read_truth

_DOOR_HEIGHT_M = 2.0
_WALL_M = 0.2
"""Height of a door and thickness of its wall (m) where the ground truth has none."""


@dataclass(frozen=True, eq=False)
class TrueBuilding:
    """A building in the map.

    faces: (F, 2, 2) of the walls. door_wall_m: (D,) thickness of the doors' walls.
    designs: (D,) design and state of the doors; empty if not described.
    """

    faces: FloatArray
    doors: TrueDoors
    door_wall_m: FloatArray
    designs: tuple[str, ...]
    elements: tuple[Element, ...]
    rooms: tuple[shapely.Polygon, ...]
    room_names: tuple[str, ...]


def parse_building(building: Mapping[str, Any]) -> TrueBuilding:
    """Parse a FeatureCollection by the `kind` of its features.

    wall: LineString or Polygon; every edge is a face.
    door: LineString along the sill with `state`; `height`, `wall_thickness`, `design`, and the
        outlines of its `leaves`. Without these, the leaf of a closed door is its sill.
    room: Polygon with `name`. element: Polygon with `element`, `truth`, `bottom` and `height`.
    """
    by_kind: dict[str, list[dict[str, Any]]] = {}
    for feature in building["features"]:
        by_kind.setdefault(feature["properties"]["kind"], []).append(feature)
    walls, doors, rooms, elements = (
        by_kind.get(kind, []) for kind in ("wall", "door", "room", "element")
    )
    faces = [_edges(feature["geometry"]["coordinates"]) for feature in walls]
    sills = [_edges(feature["geometry"]["coordinates"])[:1] for feature in doors]
    described = [feature["properties"] for feature in doors]
    return TrueBuilding(
        faces=np.concatenate(faces) if faces else np.zeros((0, 2, 2)),
        doors=TrueDoors(
            ends=np.array(sills).reshape(-1, 2, 2),
            head_m=np.array([float(own.get("height") or _DOOR_HEIGHT_M) for own in described]),
            leaves=tuple(map(_leaves, described, sills)),
            state=np.array([door_state(own["state"]) for own in described], np.uint8),
        ),
        door_wall_m=np.array([float(own.get("wall_thickness") or _WALL_M) for own in described]),
        designs=tuple(f"{own['design']}, {own['state']}" for own in described if "design" in own),
        elements=tuple(map(_element, elements)),
        rooms=tuple(outlines(rooms)),
        room_names=tuple(
            feature["properties"].get("name", str(i)) for i, feature in enumerate(rooms)
        ),
    )


def door_state(name: str) -> DoorState:
    """Parse the state of a door in GeoJSON."""
    return DoorState.CLOSED if name == "closed" else DoorState.OPEN


def _leaves(door: Mapping[str, Any], sill: FloatArray) -> FloatArray:
    if door.get("leaves"):
        return np.concatenate([_edges(leaf) for leaf in door["leaves"]])
    return sill if door_state(door["state"]) == DoorState.CLOSED else np.zeros((0, 2, 2))


def _element(feature: Mapping[str, Any]) -> Element:
    own = feature["properties"]
    area = shapely.Polygon(feature["geometry"]["coordinates"][0])
    z_m = own["bottom"], own["height"]
    return Element(own["element"], Truth[own["truth"].upper()], area, z_m)


def _edges(coordinates: Sequence[Any]) -> FloatArray:
    """(k, 2, 2) segments of a LineString's coordinates, or of all rings of a Polygon's."""
    if np.ndim(coordinates[0][0]) > 0:
        return np.concatenate([_edges(part) for part in coordinates])
    vertices = np.array([vertex[:2] for vertex in coordinates], float)
    return np.stack([vertices[:-1], vertices[1:]], axis=1)


ClassesAt = Callable[[str, int, int], UInt8Array | None]
"""Returns the true classes of the cloud of a topic, a stamp and a size; None if unknown."""


@contextmanager
def open_classes(run: FinishedRun, bag: BagPath | None) -> Iterator[ClassesAt | None]:
    """Open the ground truth that a run was evaluated with, or that of its bag; None without any.

    The bag, because a run without a recording of single scans has no errors of single scans.
    """
    paths = [] if bag is None else [bag]
    if (metrics := run.file(METRICS)) is not None:
        named = read_object(metrics, "'ffmap evaluate' makes it again").get("truth")
        paths = [BagPath((Path(str(named)),)), *paths] if named is not None else paths
    with ExitStack() as stack:
        truth = None
        for path in paths:
            # A file of true poses is no bag, and the name of several parts is no path.
            with suppress(InputError):
                opened = stack.enter_context(open_bag(path))
                truth = read_truth(opened)
            if truth is not None and truth.classes:
                break
        else:
            yield None
            return
        by_frame = {name: TruthClasses(opened, own) for name, own in truth.classes.items()}
        of_topic = {own.topic: by_frame.get(own.frame or "") for own in run.record.rig.values()}

        def classes_at(topic: str, stamp_ns: int, size: int) -> UInt8Array | None:
            own = of_topic.get(topic)
            found = own.at(stamp_ns, size) if own is not None else None
            return found if found is not None and len(found) == size else None

        yield classes_at
