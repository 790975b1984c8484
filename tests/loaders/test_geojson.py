"""Features of a ground truth are checked, each by its kind."""

from typing import Any

import pytest

from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import check_features

SILL = {"type": "LineString", "coordinates": [[0.0, 0.0], [1.0, 0.0]]}
OUTLINE = {"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 0]]]}


def check(geometry: Any, **properties: Any) -> list[dict[str, Any]]:
    content = {"features": [{"geometry": geometry, "properties": properties}]}
    return check_features(content, "building", "truth", "make it again")


def test_what_a_building_has() -> None:
    for geometry, properties in (
        (SILL, {"kind": "wall", "height": 2.5}),
        (OUTLINE, {"kind": "wall"}),
        (
            SILL,
            {"kind": "door", "state": "open", "leaves": [[[0, 0], [0, 1]]], "wall_thickness": 0.1},
        ),
        (OUTLINE, {"kind": "room", "name": "office"}),
        (SILL, {"kind": "something else", "colour": "red"}),
    ):
        assert check(geometry, **properties) == [{"geometry": geometry, "properties": properties}]


@pytest.mark.parametrize(
    ("geometry", "properties", "words"),
    [
        (SILL, {}, "properties.kind"),
        (SILL, {"kind": "door"}, "a door is a LineString with a state"),
        (OUTLINE, {"kind": "door", "state": "open"}, "a door is a LineString"),
        (SILL, {"kind": "room"}, "a room is a Polygon"),
        (SILL, {"kind": "door", "state": "open", "leaves": [[[0, 0]]]}, "leaves"),
        (SILL, {"kind": "wall", "height": "high"}, "height"),
        ({"type": "LineString", "coordinates": [[0.0, 0.0], []]}, {"kind": "wall"}, "coordinates"),
        ({"type": "Point", "coordinates": [0.0, 0.0]}, {"kind": "wall"}, "geometry"),
    ],
)
def test_what_a_building_lacks(geometry: Any, properties: dict[str, Any], words: str) -> None:
    with pytest.raises(
        InputError,
        match=rf"truth: is no GeoJSON of building: feature 0: .*{words}.*; make it again",
    ):
        check(geometry, **properties)
