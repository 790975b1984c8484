"""run.json: the kinds of its values, which readers rely on, and the values that are read again."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, FiniteFloat, ValidationError

from ffmap.app.setup.options import RunOptions
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.numbered import all_numbered

if TYPE_CHECKING:
    from ffmap.loaders.rig import MountCorrection

FROM_ODOMETRY = "odometry"
"""The source of poses in run.json, unless they are given."""


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


class RunRecord(BaseModel):
    """The values of run.json that are read; aborted runs and other versions lack some."""

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
    """Return the record. Raises InputError that names `path` where a value is of another kind."""
    try:
        RunRecord.model_validate(record)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        reason = shortened(first["msg"].lower())
        raise InputError(f"{path}: {name}: {reason}; give another run folder") from None
    return record


def bag_entry(bag: BagPath) -> dict[str, Any]:
    """Describe a bag: `path` of it or of its first part, `parts` of all where there are several."""
    paths = [str(part) for part in bag.resolve().parts]
    return {"path": paths[0], "parts": paths} if len(paths) > 1 else {"path": paths[0]}


def bag_of(record: Mapping[str, Any]) -> BagPath | None:
    """Return the bag of a run, which may be gone; None where run.json does not contain it."""
    bag = record.get("bag") or {}
    paths = bag.get("parts") or [bag.get("path")]
    return None if None in paths else BagPath(tuple(map(Path, paths)))


def topics_of(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the topics of the labelled clouds, in the order of their lidars."""
    verticals = all_numbered(record.get("rig") or {}, "vertical")
    return tuple(str(lidar["topic"]) for lidar in verticals if lidar is not None)


def mount_corrections(record: Mapping[str, Any]) -> "tuple[MountCorrection, ...]":
    """Return the extrinsics that a run has refined."""
    mounts = record.get("mounts")
    if not mounts:
        # Of one lidar: `mount`, the one that does not give the poses.
        horizontal = (record.get("rig") or {}).get("horizontal") or {}
        others = [topic for topic in topics_of(record) if topic != horizontal.get("topic")]
        mounts = {topic: record.get("mount") or {} for topic in others[:1]}
    # Not above: a list of runs needs none of the compiled code behind it.
    from ffmap.loaders.rig import MountCorrection

    corrections: list[MountCorrection] = []
    for topic, mount in mounts.items():
        T, clock_ns = np.array(mount.get("T_base_sensor") or ()), mount.get("clock_ns")
        if T.shape == (4, 4) and isinstance(clock_ns, int):
            rows = tuple(map(tuple, T.astype(np.float64).tolist()))
            corrections.append(MountCorrection(topic, rows, clock_ns))
    return tuple(corrections)
