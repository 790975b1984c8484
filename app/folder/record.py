"""run.json: what a run was made from, and its results."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError

from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.names import RUN_JSON
from ffmap.app.setup.options import RunOptions
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.numbered import all_numbered
from ffmap.loaders.text_files import read_object

if TYPE_CHECKING:
    from ffmap.loaders.rig import MountCorrection

PROGRAM = "furniture-free-mapping"
FROM_ODOMETRY = "odometry"
"""The source of poses, unless they are given."""

_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True)


class BagEntry(_Entry):
    """A bag. path: of its first part. parts: all of several. digest: see `fingerprint`."""

    path: str | None = None
    parts: tuple[str, ...] | None = None
    container: str | None = None
    digest: str | None = None

    @classmethod
    def of(cls, bag: BagPath, container: str) -> "BagEntry":
        paths = tuple(str(part) for part in bag.resolve().parts)
        return cls(path=paths[0], parts=paths if len(paths) > 1 else None, container=container)

    @property
    def bag_path(self) -> BagPath | None:
        """The bag, which may be gone; None where run.json does not contain it."""
        if self.path is None:
            return None
        return BagPath(tuple(map(Path, self.parts or (self.path,))))


class LidarEntry(_Entry):
    """A lidar of the run. why: the reasons of its role."""

    topic: str
    frame: str | None = None
    why: str | None = None
    own_body_share: FiniteFloat | None = None


class MountEntry(_Entry):
    """What the first seconds show of a vertical lidar's extrinsics.

    rms: distance between surfaces of both lidars, and between those of the horizontal one alone.
    T_base_sensor, clock_ns: those that are used, unless the given ones are.
    """

    used: Literal["as given", "refined"] = "as given"
    rms_horizontal_m: float | None = None
    rms_as_given_m: float | None = None
    rms_refined_m: float | None = None
    T_base_sensor: tuple[_Row, _Row, _Row, _Row] | None = None
    clock_ns: int | None = None


class RunRecord(_Entry):
    """The content of run.json; aborted runs lack results, other versions have other values.

    rig: the lidars by role. mounts: by topic. map_origin: in the frame of given poses (metres).
    """

    program: str = ""
    recording_id: str = ""
    started: str = ""
    outcome: str = "unknown"
    bag: BagEntry = BagEntry()
    base_frame: str | None = None
    mounts_from: str | None = None
    rig: dict[str, LidarEntry] = {}
    mounts: dict[str, MountEntry] = {}
    poses_from: str = FROM_ODOMETRY
    poses_frame: str | None = None
    map_origin: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    settings_hash: str | None = None
    settings: dict[str, Any] = {}
    options: RunOptions = RunOptions()
    versions: dict[str, str] = {}
    counts: dict[str, Any] = {}
    statistics: dict[str, dict[str, Any]] = {}
    timings_s: dict[str, FiniteFloat] = {}
    odometry_cached: bool | None = None
    labels_digest: str | None = None
    topology: dict[str, Any] | None = None
    warnings: tuple[str, ...] = ()
    tracebacks: dict[str, str] = {}
    files: tuple[str, ...] = ()

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics of the labelled clouds, in the order of their lidars."""
        return tuple(lidar.topic for lidar in all_numbered(self.rig, "vertical"))

    @property
    def mount_corrections(self) -> "list[MountCorrection]":
        """The extrinsics that the run has refined."""
        # Not above: a list of runs needs none of the compiled code behind it.
        from ffmap.loaders.rig import MountCorrection

        return [
            MountCorrection(topic, mount.T_base_sensor, mount.clock_ns)
            for topic, mount in self.mounts.items()
            if mount.T_base_sensor is not None and mount.clock_ns is not None
        ]

    def as_json(self, *names: str) -> dict[str, Any]:
        """Return the values of these names, or all of them, as plain data."""
        include = set(names) if names else None
        return self.model_dump(mode="json", include=include, exclude_none=True)


def read_record(folder: Path) -> RunRecord:
    """Read run.json. Raises InputError where it is missing or damaged."""
    path = folder / RUN_JSON
    if not folder.is_dir() or not os.path.lexists(path):
        raise InputError(
            f"{folder}: is no run folder (it has no {RUN_JSON}); give a folder that 'ffmap run' "
            "wrote"
        )
    try:
        return RunRecord.model_validate(read_object(path, "give another run folder"))
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        reason = shortened(first["msg"].lower())
        raise InputError(f"{path}: {name}: {reason}; give another run folder") from None


def write_record(folder: Path, record: RunRecord) -> None:
    """Write run.json, whole or not at all."""
    write_json(folder / RUN_JSON, record.as_json())
