"""What run.json may hold: whoever reads it can rely on the kinds of its values, whatever was done to the file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, FiniteFloat, ValidationError

from ffmap.app.setup.options import RunOptions
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError, shortened


class _Bag(BaseModel):
    path: str | None = None
    parts: list[str] | None = None
    digest: str | None = None


class _Lidar(BaseModel):
    topic: str


class _Mount(BaseModel):
    used: str | None = None
    T_base_sensor: list[list[FiniteFloat]] | None = None
    clock_ns: int | None = None


class _Record(BaseModel):
    """What is read of it again; a run that was killed early, or of another version, may lack any of it, or hold more."""

    recording_id: str | None = None
    outcome: str | None = None
    bag: _Bag | None = None
    options: RunOptions | None = None
    rig: dict[str, _Lidar | None] | None = None
    mount: _Mount | None = None
    mounts: dict[str, _Mount] | None = None
    settings: dict[str, Any] | None = None
    settings_hash: str | None = None
    versions: dict[str, Any] | None = None
    counts: dict[str, Any] | None = None
    timings_s: dict[str, FiniteFloat] | None = None
    warnings: list[str] | None = None
    statistics: dict[str, dict[str, Any]] | None = None


def check_record(record: dict[str, Any], path: Path) -> dict[str, Any]:
    """The record as it is; raises InputError that names `path` where a value is not of its kind."""
    try:
        _Record.model_validate(record)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: {name}: {shortened(first['msg'].lower())}; give another run folder") from None
    return record


def bag_entry(bag: BagPath) -> dict[str, Any]:
    """Where a bag lies, as run.json has it: `path` of the bag or of its first part, `parts` of all where there are several."""
    paths = [str(part) for part in bag.resolve().parts]
    return {"path": paths[0], "parts": paths} if len(paths) > 1 else {"path": paths[0]}


def bag_of(record: Mapping[str, Any]) -> BagPath | None:
    """Where the bag of a run lies, or lay; None where its run.json does not say."""
    bag = record.get("bag") or {}
    paths = bag.get("parts") or [bag.get("path")]
    return None if None in paths else BagPath(tuple(map(Path, paths)))
