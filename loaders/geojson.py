"""GeoJSON that a run wrote, or a user gives in its place: features of one kind of geometry, checked as they are read."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from loaders.errors import InputError, shortened
from loaders.text_files import read_json

Position = Annotated[list[FiniteFloat], Field(min_length=2)]


class Line(BaseModel):
    """A LineString; coordinates in metres in the map frame."""

    type: Literal["LineString"]
    coordinates: Annotated[list[Position], Field(min_length=2)]


class Outline(BaseModel):
    """A Polygon: its outer ring, then its holes, each closed; metres in the map frame."""

    type: Literal["Polygon"]
    coordinates: Annotated[list[Annotated[list[Position], Field(min_length=4)]], Field(min_length=1)]


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


_FEATURES: dict[str, type[BaseModel]] = {"lines": _LineFeature, "outlines": _OutlineFeature, "doors": _DoorFeature}


def read_features(path: Path, of: Literal["lines", "outlines", "doors"], advice: str) -> list[dict[str, Any]]:
    """The features of a FeatureCollection as dictionaries; doors are lines that have a width and a state.

    advice: what the user can do; the end of the error's line. Raises InputError where the file is no such GeoJSON.
    """
    content = read_json(path, advice)
    features = content.get("features") if isinstance(content, dict) else None
    if not isinstance(features, list):
        raise InputError(f"{path}: is no GeoJSON, it has no list of features; {advice}")
    for number, feature in enumerate(features):
        try:
            _FEATURES[of].model_validate(feature)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"])
            raise InputError(
                f"{path}: is no GeoJSON of {of}: feature {number}: {place}: {shortened(first['msg'].lower())}; {advice}"
            ) from None
    return features
