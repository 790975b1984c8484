"""The folder of a run: its files' names, run.json, the spool that a killed run is resumed from.

Nothing is ever removed but files that runs write.
"""

import os
import re
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
PROGRAM = "furniture-free-mapping"
"""What run.json says that it was written by."""


SWEEP_TABLE = "sweep.csv"
"""In a sweep's folder, beside its runs."""

_WITHIN = re.compile(
    rf"{LABELLED_FOLDER}|metadata\.yaml|{LABELLED_FOLDER}(_\d+)?\.(db3|mcap)"
    r"|(\d{5}(\.final)?|own-\d{5}|halo)\.(arrow|rrd)(\.part)?"
)
"""What runs write into the folders within their own: the files of a labelled ROS 2 bag and of the spool."""


def map_file(name: str) -> str:
    """The file of a grid map: map.yaml for the furniture-free one, map_NAME.yaml for the others."""
    # Not above: it brings the algorithms with it, and a list of runs needs none of them.
    from ffmap.blueprints.entities import FURNITURE_FREE

    return "map.yaml" if name == FURNITURE_FREE else f"map_{name}.yaml"


def rooms_file(name: str) -> str:
    """The file of a map's rooms: rooms.geojson for the furniture-free one, rooms_NAME.geojson for the others."""
    from ffmap.algorithms.maps.area_graph import Segmented  # as above

    return ROOMS if name == Segmented.FURNITURE_FREE else f"rooms_{name}.geojson"


@cache
def file_names() -> frozenset[str]:
    """The names of all files and folders that a run, its evaluation and the commands after it write into its folder."""
    from ffmap.algorithms.maps.area_graph import Segmented  # as above
    from ffmap.algorithms.maps.rivals import Rival
    from ffmap.blueprints.entities import FURNITURE_FREE

    names = {RUN_JSON, RECORDING, EVALUATION, TRAJECTORY, CLOUD, LABELLED_BAG, LABELLED_FOLDER, LABELS, METRICS}
    names |= {WALLS, DOORS, FLOOR_PLAN_SVG, FLOOR_PLAN_DXF, OVERLAY, SPOOL}
    names |= {rooms_file(name) for name in Segmented}
    maps = {map_file(name) for name in (FURNITURE_FREE, *Rival)}
    return frozenset(names | maps | {str(Path(name).with_suffix(".pgm")) for name in maps})


@dataclass(frozen=True)
class RunFolder:
    """Paths within a run's folder."""

    path: Path

    @property
    def spool(self) -> Path:
        """Finished blocks of scans; removed when the run is complete."""
        return self.path / SPOOL

    def block(self, number: int, suffix: str) -> Path:
        """A block's file in the spool."""
        return self.spool / f"{number:05d}{suffix}"

    def read_json(self) -> dict[str, Any]:
        """run.json; raises InputError where there is none or it cannot be read."""
        path = self.path / RUN_JSON
        if not self.path.is_dir() or not os.path.lexists(path):
            raise InputError(f"{self.path}: is no run folder (it has no {RUN_JSON}); give one that 'ffmap run' made")
        return check_record(read_object(path, "give another run folder"), path)

    def write_json(self, content: dict[str, Any]) -> None:
        """run.json, whole or not at all."""
        write_json(self.path / RUN_JSON, content)


def default_path(bag: BagPath, settings_hash: str) -> Path:
    """runs/<bag>-<time>-<hash> below the working directory."""
    return Path("runs") / f"{bag.stem}-{datetime.now():%Y%m%d-%H%M%S}-{settings_hash}"


def create(path: Path, overwrite: bool = False, inputs: Iterable[Path] = ()) -> RunFolder:
    """The folder of a new run, made if need be.

    Nothing in it is touched before `clear`.

    overwrite: whether an earlier run may be there. inputs: what the run will read.
    Raises InputError where there is an earlier run that must not be replaced, or that the new one reads from, where there
    is anything but a run, and where the folder cannot be written.
    """
    try:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file; give a folder to --out")
        if path.is_dir() and any(path.iterdir()) and not (path / RUN_JSON).exists():
            raise InputError(f"{path}: holds files that are no run; give an empty or a new folder to --out")
        if (path / RUN_JSON).exists():
            _check_replaceable(RunFolder(path), overwrite, inputs)
        make_writable(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another folder to --out") from error
    return RunFolder(path)


def _check_replaceable(folder: RunFolder, overwrite: bool, inputs: Iterable[Path]) -> None:
    path = folder.path
    if folder.read_json().get("program") != PROGRAM:
        raise InputError(f"{path}: holds a {RUN_JSON} that ffmap did not write; give an empty or a new folder to --out")
    if not overwrite:
        raise InputError(
            f"{path}: holds {_state(folder)}; give another folder to --out, or replace it with --overwrite"
        )
    own = {path.resolve() / name for name in file_names()}
    for read in inputs:
        if own & {read.resolve(), *read.resolve().parents}:
            raise InputError(
                f"{read}: is read, and belongs to the run that --overwrite replaces; give another folder to --out"
            )


def _state(folder: RunFolder) -> str:
    """What kind of run a folder holds, in words."""
    with suppress(InputError):
        outcome = folder.read_json().get("outcome")
        if outcome == "complete":
            return "a finished run"
        if outcome in ("aborted", "running"):
            return f"a run that is not finished ('ffmap run --resume {folder.path}' goes on with it)"
    return "a run"


def written_files(folder: RunFolder) -> list[str]:
    """Which of the files of a run there are, spool aside."""
    return sorted(entry.name for entry in folder.path.iterdir() if entry.name in file_names() - {SPOOL})


def _remove(path: Path) -> None:
    """A file that a run has written, or a folder with what runs write into it."""
    if not path.is_dir() or path.is_symlink():
        path.unlink(missing_ok=True)
        return
    for entry in path.iterdir():
        if _WITHIN.fullmatch(entry.name):
            _remove(entry)
    with suppress(OSError):
        path.rmdir()


@contextmanager
def held(path: Path, patience_s: float = 0.15) -> Iterator[bool]:
    """Keep every other run out of a run folder, or from some file, for as long as the context lasts.

    The system itself lets go of it when the process ends, however that happens, and nothing is left behind. Where it
    cannot be locked, as on some network drives, nobody is kept out; yields whether anybody is.

    patience_s: who asks whether the folder is held holds it for a moment. Raises InputError where another run is at it.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        # What is wrong with it is said by whoever reads it or writes there.
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
                    f"{path}: another run is writing there; wait for its end, or give another folder to --out"
                ) from None
            time.sleep(0.05)
        except OSError:
            return False
        else:
            return True


def is_held(path: Path) -> bool:
    """Whether a run is at a folder now, see `held`; where folders cannot be locked, nobody knows, and one may be."""
    try:
        with held(path) as locked:
            return path.exists() and not locked
    except InputError:
        return True


def check_same_run(folder: RunFolder, record: Mapping[str, Any]) -> None:
    """Raises InputError where another run has taken the folder since `record` was read: nothing of this one belongs there."""
    if folder.read_json().get("recording_id") != record.get("recording_id"):
        raise InputError(f"{folder.path}: another run has taken this one's place meanwhile; start again")


def check_no_run_loses(path: Path, option: str = "--out") -> None:
    """Raises InputError where writing this file would replace what a run has made. option: what the path was given to."""
    if path.name in file_names() and (path.parent / RUN_JSON).exists():
        raise InputError(f"{path}: belongs to the run in that folder; give another place to {option}")


def make_writable(path: Path) -> None:
    """Make a folder where there is none, and try to write in it; raises OSError where that fails."""
    path.mkdir(parents=True, exist_ok=True)
    probe = path / f".writable-{os.getpid()}"
    probe.touch()
    probe.unlink()


def require_writable(path: Path, instead: str) -> None:
    """`make_writable`, with InputError where it fails. instead: what the user can do, as "give another folder to --out"."""
    try:
        make_writable(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); {instead}") from error


def clear(folder: RunFolder) -> None:
    """Remove what an earlier run has left, once everything about the new run is known to be in order."""
    for name in file_names():
        _remove(folder.path / name)
        _remove(folder.path / f"{name}.part")
    folder.spool.mkdir(exist_ok=True)


def point_latest_at(path: Path) -> None:
    """Let `latest` beside the run folder point at it; leave what is there and no link to a run, and where none can be made."""
    latest = path.parent / "latest"
    if latest.exists() and not (latest.is_symlink() and (latest / RUN_JSON).exists()):
        return
    link = path.parent / f".latest-{os.getpid()}"
    try:
        link.symlink_to(path.name, target_is_directory=True)
        link.replace(latest)
    except OSError:
        link.unlink(missing_ok=True)
