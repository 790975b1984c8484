"""A run that is there already, as `evaluate`, `inspect` and `compare` read it: its record, and whatever it has of its files."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.app.folder.names import (
    RECORDING,
    RUN_JSON,
    TRAJECTORY,
    RunFolder,
    is_held,
)
from ffmap.app.folder.record import bag_of
from ffmap.app.setup.inputs import Inputs, find_inputs, find_lidars
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Detail
from ffmap.app.setup.settings import Settings, validate
from ffmap.loaders.bag import Bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.numbered import all_numbered
from ffmap.loaders.rig import MountCorrection, Rig
from ffmap.loaders.text_files import require_regular

Record = Mapping[str, Any]

FROM_ODOMETRY = "odometry"
"""What `run.json` says as to where the poses are from, unless they were given."""


@dataclass(frozen=True)
class FinishedRun:
    """A run folder; complete, aborted, or killed.

    record: what run.json holds; runs of other versions of the program may hold other things.
    """

    path: Path
    record: Record

    @property
    def name(self) -> str:
        """The folder's own name, a link followed."""
        return self.path.resolve().name

    @property
    def complete(self) -> bool:
        """Whether the run came to its end."""
        return self.record.get("outcome") == "complete"

    @property
    def outcome(self) -> str:
        """complete, aborted, running or killed: then it says that it is running, but nobody is at its folder."""
        outcome = str(self.record.get("outcome", "unknown"))
        return "killed" if outcome == "running" and not is_held(self.path) else outcome

    @property
    def map_origin_m(self) -> FloatArray:
        """(3,) where the map's origin lies in the frame of the poses that were given; zeros where it is theirs.

        Raises InputError where run.json is damaged.
        """
        origin = self.record.get("map_origin", [0.0, 0.0, 0.0])
        if not (isinstance(origin, list) and len(origin) == 3 and all(isinstance(v, int | float) for v in origin)):
            wrong = f"map_origin is {origin!r}, not x, y and z in metres"
            raise InputError(f"{self.path / RUN_JSON}: {wrong}; run ffmap again")
        return np.array(origin, float)

    @cached_property
    def recording(self) -> Path | None:
        """The recording; it may have been cut."""
        return self.file(RECORDING)

    @property
    def has_scans(self) -> bool:
        """Whether its recording, if it has one, holds single scans and not the map alone."""
        return self.options.detail != Detail.MAP

    @property
    def has_lines(self) -> bool:
        """Whether its recording, if it has one, holds every intermediate of single scans."""
        return self.options.detail == Detail.LINES

    @property
    def registered(self) -> bool:
        """Whether its poses are the odometry's, whose quality the recording then holds."""
        return bool(self.record.get("poses_from", FROM_ODOMETRY) == FROM_ODOMETRY)

    @property
    def trajectory(self) -> Path | None:
        """T_map_base at each vertical scan's stamp."""
        return self.file(TRAJECTORY)

    def file(self, name: str) -> Path | None:
        """A file of the run; None where the run has none. Raises InputError where it is no file, but a folder or a pipe."""
        path = self.path / name
        if not path.exists():
            return None
        require_regular(path, "give another run folder")
        return path

    @property
    def bag_path(self) -> BagPath | None:
        """The bag that the run was made from; it may be gone."""
        return bag_of(self.record)

    @property
    def bag_digest(self) -> str | None:
        """Fingerprint of the bag; None for a run that was killed before it was known."""
        return self.part("bag").get("digest")

    def labelled_same_clouds(self, other: "FinishedRun") -> bool:
        """Whether both runs labelled clouds of one topic of the same bag."""
        same_bag = self.bag_digest is not None and self.bag_digest == other.bag_digest
        return same_bag and not set(self.topics).isdisjoint(other.topics)

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics of the clouds that were labelled, in the order of their lidars."""
        return _topics(self.record)

    @cached_property
    def options(self) -> RunOptions:
        """What the user said of the run; the defaults where run.json does not."""
        return RunOptions.model_validate(self.part("options"))

    def find_inputs(self, bag: BagPath) -> Inputs:
        """What the run read of its bag, wherever that lies now."""
        return find_inputs(bag, self.options, mount_corrections(self.record), self._without_body)

    def find_lidars(self, bag: Bag) -> Rig:
        """The lidars of the run's bag, which is open, where the run found them to sit."""
        return find_lidars(bag, self.options, mount_corrections(self.record), self._without_body)

    @property
    def _without_body(self) -> bool:
        return bool(self.part("settings").get("scan", {}).get("own_body", False))

    def settings(self) -> Settings:
        """The settings that the run was made with; raises InputError where this version does not know them."""
        settings = self.record.get("settings")
        if settings is None:
            raise InputError(f"{self.path / RUN_JSON}: holds no settings; run ffmap again")
        return validate(settings, str(self.path / RUN_JSON))

    def part(self, name: str) -> Record:
        """One mapping within the record; empty where there is none."""
        return self.record.get(name) or {}


def mount_corrections(record: Record) -> tuple[MountCorrection, ...]:
    """Where a run found vertical lidars to sit, of those that it did not use as given. record: its run.json."""
    corrections: list[MountCorrection] = []
    for topic, mount in _mounts(record).items():
        T, clock_ns = np.array(mount.get("T_base_sensor") or ()), mount.get("clock_ns")
        if T.shape == (4, 4) and isinstance(clock_ns, int):
            corrections.append(MountCorrection(topic, tuple(map(tuple, T.astype(np.float64).tolist())), clock_ns))
    return tuple(corrections)


def _mounts(record: Record) -> Mapping[str, Record]:
    """What a run found of the mounts, by topic: `mounts`, or `mount` where one lidar alone was looked into."""
    if record.get("mounts"):
        return dict(record["mounts"])
    horizontal = (record.get("rig") or {}).get("horizontal")
    others = [topic for topic in _topics(record) if horizontal is None or topic != horizontal["topic"]]
    return {topic: record.get("mount") or {} for topic in others[:1]}


def _topics(record: Record) -> tuple[str, ...]:
    return tuple(str(lidar["topic"]) for lidar in all_numbered(record.get("rig") or {}, "vertical") if lidar is not None)


def open_run(path: Path) -> FinishedRun:
    """Raises InputError where the folder is no run."""
    if not path.exists():
        raise InputError(f"{path}: no such folder; give a run folder that 'ffmap run' made")
    if not path.is_dir():
        raise InputError(f"{path}: is a file; give the run folder that holds it")
    return FinishedRun(path, RunFolder(path).read_json())
