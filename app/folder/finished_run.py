"""An earlier run as commands read it: its record and its files."""

from dataclasses import dataclass
from pathlib import Path

from ffmap.app.folder.names import RECORDING, RUN_JSON, TRAJECTORY
from ffmap.app.folder.record import FROM_ODOMETRY, RunRecord, read_record
from ffmap.app.folder.run_folder import is_held
from ffmap.app.setup.inputs import Inputs, find_inputs, find_lidars
from ffmap.app.setup.outputs import Detail
from ffmap.app.setup.settings import Settings, validate
from ffmap.loaders.bag import Bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import Rig
from ffmap.loaders.text_files import require_regular


@dataclass(frozen=True)
class FinishedRun:
    """A run folder; complete, aborted, or killed. record: maybe of another version."""

    path: Path
    record: RunRecord

    @property
    def name(self) -> str:
        """The name of the folder, links followed."""
        return self.path.resolve().name

    @property
    def complete(self) -> bool:
        return self.record.outcome == "complete"

    @property
    def outcome(self) -> str:
        """complete, aborted, running, or killed (running, but no process holds its folder)."""
        outcome = self.record.outcome
        return "killed" if outcome == "running" and not is_held(self.path) else outcome

    @property
    def recording(self) -> Path | None:
        """The recording, which may be cut."""
        return self.file(RECORDING)

    @property
    def has_scans(self) -> bool:
        """Whether the recording contains scans, not only the map."""
        return self.record.options.detail != Detail.MAP

    @property
    def has_lines(self) -> bool:
        """Whether the recording contains every intermediate of scans."""
        return self.record.options.detail == Detail.LINES

    @property
    def registered(self) -> bool:
        """Whether the poses are from the odometry."""
        return self.record.poses_from == FROM_ODOMETRY

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
        return self.record.bag.bag_path

    def find_inputs(self, bag: BagPath) -> Inputs:
        """Find the inputs of the run in its bag, wherever that is now."""
        record = self.record
        return find_inputs(bag, record.options, record.mount_corrections, self._without_body)

    def find_lidars(self, bag: Bag) -> Rig:
        """Find the lidars in the open bag of the run, with the extrinsics that it used."""
        record = self.record
        return find_lidars(bag, record.options, record.mount_corrections, self._without_body)

    @property
    def _without_body(self) -> bool:
        scan = self.record.settings.get("scan")
        return isinstance(scan, dict) and bool(scan.get("own_body", False))

    def settings(self) -> Settings:
        """Return the settings. Raises InputError where this version does not know them."""
        if not self.record.settings:
            raise InputError(f"{self.path / RUN_JSON}: has no settings; run ffmap again")
        try:
            return validate(self.record.settings, RUN_JSON)
        except InputError as error:
            raise InputError(
                f"{self.path}: was made by another version of ffmap ({error}); run ffmap again"
            ) from None


def open_run(path: Path) -> FinishedRun:
    """Open a run folder. Raises InputError where it is none."""
    if not path.exists():
        raise InputError(f"{path}: no such folder; give a run folder that 'ffmap run' wrote")
    if not path.is_dir():
        raise InputError(f"{path}: is a file; give the run folder that contains it")
    return FinishedRun(path, read_record(path))
