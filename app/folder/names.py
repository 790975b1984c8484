"""The folder of a run: the names of its files, who may write to it, and how it is replaced.

Nothing is ever removed but files that runs write.
"""

import os
import shutil
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.record import check_record
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.text_files import read_object

RUN_JSON = "run.json"
RECORDING = "recording.rrd"
EVALUATION = "evaluation.rrd"
TRAJECTORY = "trajectory.tum"
CLOUD = "cloud.ply"
LABELLED_BAG = "labelled.bag"
LABELLED_FOLDER = "labelled"
LABELS = "labels.parquet"
METRICS = "metrics.json"
WALLS = "walls.geojson"
DOORS = "doors.geojson"
ROOMS = "rooms.geojson"
FLOOR_PLAN_SVG = "floorplan.svg"
FLOOR_PLAN_DXF = "floorplan.dxf"
OVERLAY = "overlay.png"
SPOOL = "spool"
"""Folder of finished blocks of scans, from which a killed run is resumed."""
SWEEP_TABLE = "sweep.csv"
"""In the folder of a sweep, beside its runs."""
PROGRAM = "furniture-free-mapping"
"""The program in run.json."""
_LABELLED = ("metadata.yaml", f"{LABELLED_FOLDER}*.db3", f"{LABELLED_FOLDER}*.mcap")
"""The files of a labelled ROS 2 bag."""
_PATIENCE_S = 0.15
"""Time (s) to wait for a lock: `is_held` locks a folder for a moment."""


def map_file(name: str) -> str:
    """Name a grid map: map.yaml for the furniture-free one, map_NAME.yaml for the others."""
    # Imported here, as below: `ffmap runs` needs no algorithms.
    from ffmap.blueprints.entities import FURNITURE_FREE

    return "map.yaml" if name == FURNITURE_FREE else f"map_{name}.yaml"


def rooms_file(name: str) -> str:
    """Name the rooms of a map: rooms.geojson for the furniture-free one, or rooms_NAME.geojson."""
    from ffmap.algorithms.maps.area_graph import Segmented

    return ROOMS if name == Segmented.FURNITURE_FREE else f"rooms_{name}.geojson"


@cache
def file_names() -> frozenset[str]:
    """List all files and folders that commands write into the folder of a run."""
    from ffmap.algorithms.maps.area_graph import Segmented
    from ffmap.algorithms.maps.rivals import Rival
    from ffmap.blueprints.entities import FURNITURE_FREE

    names = {RUN_JSON, RECORDING, EVALUATION, TRAJECTORY, CLOUD, LABELLED_BAG, LABELLED_FOLDER}
    names |= {LABELS, METRICS, WALLS, DOORS, FLOOR_PLAN_SVG, FLOOR_PLAN_DXF, OVERLAY, SPOOL}
    names |= {rooms_file(name) for name in Segmented}
    for name in (FURNITURE_FREE, *Rival):
        names |= {map_file(name), str(Path(map_file(name)).with_suffix(".pgm"))}
    return frozenset(names)


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run."""

    path: Path

    @property
    def spool(self) -> Path:
        """Finished blocks; removed when the run is complete."""
        return self.path / SPOOL

    def read_json(self) -> dict[str, Any]:
        """Read run.json. Raises InputError where it is missing or damaged."""
        path = self.path / RUN_JSON
        if not self.path.is_dir() or not os.path.lexists(path):
            raise InputError(
                f"{self.path}: is no run folder (it has no {RUN_JSON}); give a folder that 'ffmap "
                "run' wrote"
            )
        return check_record(read_object(path, "give another run folder"), path)

    def write_json(self, content: dict[str, Any]) -> None:
        """Write run.json, whole or not at all."""
        write_json(self.path / RUN_JSON, content)

    def written_files(self) -> list[str]:
        """List the files of a run that exist."""
        known = file_names() - {SPOOL}
        return sorted(entry.name for entry in self.path.iterdir() if entry.name in known)

    def clear(self) -> None:
        """Remove what an earlier run has written."""
        shutil.rmtree(self.spool, ignore_errors=True)
        labelled = self.path / LABELLED_FOLDER
        if labelled.is_dir() and not labelled.is_symlink():
            for pattern in _LABELLED:
                for file in labelled.glob(pattern):
                    file.unlink()
            with suppress(OSError):
                labelled.rmdir()
        for name in file_names():
            for path in (self.path / name, self.path / f"{name}.part"):
                if path.is_symlink() or not path.is_dir():
                    path.unlink(missing_ok=True)
        self.spool.mkdir(exist_ok=True)


def default_path(bag: BagPath, settings_hash: str) -> Path:
    """Return runs/<bag>-<time>-<hash> below the working directory."""
    return Path("runs") / f"{bag.stem}-{datetime.now():%Y%m%d-%H%M%S}-{settings_hash}"


def create(path: Path, overwrite: bool = False, inputs: Iterable[Path] = ()) -> RunFolder:
    """Create the folder of a new run if need be; its files stay until `RunFolder.clear`.

    overwrite: whether it may contain an earlier run. inputs: files that the run reads.
    Raises InputError where the earlier run must not be replaced or is an input, where there is
    anything but a run, and where the folder cannot be written.
    """
    try:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file; give a folder to --out")
        if path.is_dir() and any(path.iterdir()) and not (path / RUN_JSON).exists():
            raise InputError(f"{path}: has files that are no run; give an empty folder to --out")
        if (path / RUN_JSON).exists():
            _check_replaceable(RunFolder(path), overwrite, inputs)
        make_writable(path)
    except OSError as error:
        instead = "give another folder to --out"
        raise InputError(f"{path}: cannot be written ({error.strerror}); {instead}") from error
    return RunFolder(path)


def _check_replaceable(folder: RunFolder, overwrite: bool, inputs: Iterable[Path]) -> None:
    path, record = folder.path, folder.read_json()
    if record.get("program") != PROGRAM:
        raise InputError(
            f"{path}: has a {RUN_JSON} that ffmap did not write; give an empty folder to --out"
        )
    if not overwrite:
        kind = "a run"
        if record.get("outcome") == "complete":
            kind = "a finished run"
        elif record.get("outcome") in ("aborted", "running"):
            kind += f" that is not finished ('ffmap run --resume {path}' continues it)"
        raise InputError(
            f"{path}: contains {kind}; give another folder to --out, or replace it with --overwrite"
        )
    own = {path.resolve() / name for name in file_names()}
    for read in inputs:
        if own & {read.resolve(), *read.resolve().parents}:
            raise InputError(
                f"{read}: is an input, and belongs to the run that --overwrite replaces; give "
                "another folder to --out"
            )


@contextmanager
def held(path: Path, patience_s: float = _PATIENCE_S) -> Iterator[bool]:
    """Lock a run folder, or another file, until the context or the process ends.

    Yields False where it cannot be locked, as on some network drives.
    Raises InputError where another run has locked it.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        # The next read or write reports the problem.
        yield False
        return
    try:
        yield _lock(descriptor, path, patience_s)
    finally:
        os.close(descriptor)


def _lock(descriptor: int, path: Path, patience_s: float) -> bool:
    if sys.platform == "win32":
        return False
    import fcntl

    until_s = time.monotonic() + patience_s
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise InputError(
                    f"{path}: another run is writing there; wait for its end, or give another "
                    "folder to --out"
                ) from None
            time.sleep(0.05)
        except OSError:
            return False
        else:
            return True


def is_held(path: Path) -> bool:
    """Return whether a run is writing to a folder; True where folders cannot be locked."""
    try:
        with held(path) as locked:
            return path.exists() and not locked
    except InputError:
        return True


def check_same_run(folder: RunFolder, record: Mapping[str, Any]) -> None:
    """Raise InputError where another run has taken the folder since `record` was read."""
    if folder.read_json().get("recording_id") != record.get("recording_id"):
        raise InputError(f"{folder.path}: another run has replaced this one; start again")


def check_no_run_loses(path: Path, option: str = "--out") -> None:
    """Raise InputError where this file belongs to a run. option: names the path."""
    if path.name in file_names() and (path.parent / RUN_JSON).exists():
        raise InputError(
            f"{path}: belongs to the run in that folder; give another place to {option}"
        )


def make_writable(path: Path) -> None:
    """Create a folder, and try to write in it. Raises OSError where that fails."""
    path.mkdir(parents=True, exist_ok=True)
    probe = path / f".writable-{os.getpid()}"
    probe.touch()
    probe.unlink()


def require_writable(path: Path, instead: str) -> None:
    """Call `make_writable`. Raises InputError where it fails. instead: what the user can do."""
    try:
        make_writable(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); {instead}") from error


def point_latest_at(path: Path) -> None:
    """Point the link `latest` beside a run folder at it, unless `latest` is no link to a run."""
    latest = path.parent / "latest"
    if latest.exists() and not (latest.is_symlink() and (latest / RUN_JSON).exists()):
        return
    link = path.parent / f".latest-{os.getpid()}"
    try:
        link.symlink_to(path.name, target_is_directory=True)
        link.replace(latest)
    except OSError:
        link.unlink(missing_ok=True)
