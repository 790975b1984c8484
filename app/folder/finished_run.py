"""An earlier run as commands read it: its record and its files."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.app.folder.names import RECORDING, RUN_JSON, TRAJECTORY, RunFolder, is_held
from ffmap.app.folder.record import FROM_ODOMETRY, bag_of, mount_corrections, topics_of
from ffmap.app.setup.inputs import Inputs, find_inputs, find_lidars
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Detail
from ffmap.app.setup.settings import Settings, validate
from ffmap.loaders.bag import Bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import Rig
from ffmap.loaders.text_files import require_regular


@dataclass(frozen=True)
class FinishedRun:
    """A run folder; complete, aborted, or killed. record: run.json, maybe of another version."""

    path: Path
    record: Mapping[str, Any]

    @property
    def name(self) -> str:
        """The name of the folder, links followed."""
        return self.path.resolve().name

    @property
    def complete(self) -> bool:
        return self.record.get("outcome") == "complete"

    @property
    def outcome(self) -> str:
        """complete, aborted, running, or killed (running, but no process holds its folder)."""
        outcome = str(self.record.get("outcome", "unknown"))
        return "killed" if outcome == "running" and not is_held(self.path) else outcome

    @property
    def map_origin_m(self) -> FloatArray:
        """(3,) origin of the map in the frame of given poses; zeros if they are the same.

        Raises InputError where run.json is damaged.
        """
        origin = self.record.get("map_origin", [0.0, 0.0, 0.0])
        numbers = isinstance(origin, list) and all(isinstance(v, int | float) for v in origin)
        if not numbers or len(origin) != 3:
            raise InputError(
                f"{self.path / RUN_JSON}: map_origin is {origin!r}, not x, y and z in metres; run "
                "ffmap again"
            )
        return np.array(origin, float)

    @property
    def recording(self) -> Path | None:
        """The recording, which may be cut."""
        return self.file(RECORDING)

    @property
    def has_scans(self) -> bool:
        """Whether the recording contains scans, not only the map."""
        return self.options.detail != Detail.MAP

    @property
    def has_lines(self) -> bool:
        """Whether the recording contains every intermediate of scans."""
        return self.options.detail == Detail.LINES

    @property
    def registered(self) -> bool:
        """Whether the poses are from the odometry."""
        return bool(self.record.get("poses_from", FROM_ODOMETRY) == FROM_ODOMETRY)

    @property
    def trajectory(self) -> Path | None:
        """T_map_base at the stamp of each vertical scan."""
        return self.file(TRAJECTORY)

    def file(self, name: str) -> Path | None:
        """Return a file of the run, or None. Raises InputError for a folder or a pipe."""
        path = self.path / name
        if not path.exists():
            return None
        require_regular(path, "give another run folder")
        return path

    @property
    def bag_path(self) -> BagPath | None:
        """The bag of the run; it may be gone."""
        return bag_of(self.record)

    @property
    def bag_digest(self) -> str | None:
        """Fingerprint of the bag; None for a run that was killed before it was known."""
        return self.part("bag").get("digest")

    def labelled_same_clouds(self, other: "FinishedRun") -> bool:
        """Return whether both runs labelled clouds of one topic of the same bag."""
        same_bag = self.bag_digest is not None and self.bag_digest == other.bag_digest
        return same_bag and not set(self.topics).isdisjoint(other.topics)

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics of the labelled clouds, in the order of their lidars."""
        return topics_of(self.record)

    @cached_property
    def options(self) -> RunOptions:
        """The options of the run; defaults where run.json has none."""
        return RunOptions.model_validate(self.part("options"))

    def find_inputs(self, bag: BagPath) -> Inputs:
        """Find the inputs of the run in its bag, wherever that is now."""
        return find_inputs(bag, self.options, mount_corrections(self.record), self._without_body)

    def find_lidars(self, bag: Bag) -> Rig:
        """Find the lidars in the open bag of the run, with the extrinsics that it used."""
        return find_lidars(bag, self.options, mount_corrections(self.record), self._without_body)

    @property
    def _without_body(self) -> bool:
        return bool(self.part("settings").get("scan", {}).get("own_body", False))

    def settings(self) -> Settings:
        """Return the settings. Raises InputError where this version does not know them."""
        settings = self.record.get("settings")
        if settings is None:
            raise InputError(f"{self.path / RUN_JSON}: has no settings; run ffmap again")
        try:
            return validate(settings, RUN_JSON)
        except InputError as error:
            raise InputError(
                f"{self.path}: was made by another version of ffmap ({error}); run ffmap again"
            ) from None

    def part(self, name: str) -> Mapping[str, Any]:
        """Return a mapping in run.json; empty if it is missing."""
        return self.record.get(name) or {}


def open_run(path: Path) -> FinishedRun:
    """Open a run folder. Raises InputError where it is none."""
    if not path.exists():
        raise InputError(f"{path}: no such folder; give a run folder that 'ffmap run' wrote")
    if not path.is_dir():
        raise InputError(f"{path}: is a file; give the run folder that contains it")
    return FinishedRun(path, RunFolder(path).read_json())
