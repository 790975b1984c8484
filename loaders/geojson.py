"""GeoJSON of a run or a user: features of one kind of geometry, checked as they are read."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.errors import InputError, first_problem
from ffmap.loaders.text_files import read_json

Position = Annotated[list[FiniteFloat], Field(min_length=2)]
Positions = Annotated[list[Position], Field(min_length=2)]
Ring = Annotated[list[Position], Field(min_length=4)]


class Line(BaseModel):
    """A LineString; metres in the map frame."""

    type: Literal["LineString"]
    coordinates: Positions


class Outline(BaseModel):
    """A Polygon: its outer ring, then its holes, each closed; metres in the map frame."""

    type: Literal["Polygon"]
    coordinates: Annotated[list[Ring], Field(min_length=1)]


class _LineFeature(BaseModel):
    geometry: Line
    properties: dict[str, Any] | None = None


class _OutlineFeature(BaseModel):
    geometry: Outline
    properties: dict[str, Any] | None = None


class _Door(BaseModel):
    width: FiniteFloat
    state: str


class _DoorFeature(BaseModel):
    geometry: Line
    properties: _Door


class _TrueProperties(BaseModel):
    kind: str
    name: str | None = None
    state: str | None = None
    height: FiniteFloat | None = None
    wall_thickness: FiniteFloat | None = None
    leaves: list[Positions] | None = None


class _TrueFeature(BaseModel):
    """A wall, door, room or other element of a ground truth."""

    geometry: Line | Outline = Field(discriminator="type")
    properties: _TrueProperties

    @model_validator(mode="after")
    def _matches_its_kind(self) -> Self:
        kind, geometry = self.properties.kind, self.geometry.type
        if kind == "door" and (self.properties.state is None or geometry != "LineString"):
            raise ValueError("a door is a LineString with a state")
        if kind == "room" and geometry != "Polygon":
            raise ValueError("a room is a Polygon")
        return self


Kind = Literal["lines", "outlines", "doors", "building"]
_FEATURES: dict[Kind, type[BaseModel]] = {
    "lines": _LineFeature,
    "outlines": _OutlineFeature,
    "doors": _DoorFeature,
    "building": _TrueFeature,
}


def read_features(path: Path, of: Kind, advice: str) -> list[dict[str, Any]]:
    """Read the features of a FeatureCollection as dictionaries.

    Raises InputError, which ends with `advice`, where the file is no such GeoJSON.
    """
    return check_features(read_json(path, advice), of, str(path), advice)


def check_features(content: object, of: Kind, where: str, advice: str) -> list[dict[str, Any]]:
    """Check the features of a FeatureCollection, named `where` in errors; see `read_features`."""
    features = content.get("features") if isinstance(content, dict) else None
    if not isinstance(features, list):
        raise InputError(f"{where}: is no GeoJSON, it has no list of features; {advice}")
    for number, feature in enumerate(features):
        try:
            _FEATURES[of].model_validate(feature)
        except ValidationError as error:
            raise InputError(
                f"{where}: is no GeoJSON of {of}: feature {number}: {first_problem(error)}; "
                f"{advice}"
            ) from None
    return features


def segments(features: Sequence[Any]) -> FloatArray:
    """Return (n, 2, 2) x and y of the first two positions of each LineString."""
    lines = (feature["geometry"]["coordinates"][:2] for feature in features)
    ends = [[position[:2] for position in line] for line in lines]
    return np.array(ends, float).reshape(-1, 2, 2)
