"""The rig file, in which a user says where the lidars sit if the bag has no transforms; those of public data sets are built in.

    description = "our robot"                 # optional, as are source and the lidars' sensor: words for people
    with_topics = ["/odometry/filtered"]      # optional: topics without which a built-in rig is not chosen by itself
    base = "base_link"                        # the frame of the trajectory; x forward, z up

    [[lidar]]
    topic = "/horizontal/velodyne_points"     # topic or frame; where both are given, the frame where the bag lacks the topic
    frame = "velodyne_h"
    sensor = "Velodyne HDL-32E"
    role = "horizontal"                       # optional: "horizontal" (one), "vertical" (any number) or "both"
    translation = [0.12, 0.01, 0.568]         # where the lidar is in base, metres
    quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]    # how it is turned there, T_base_lidar, or
    rpy_deg = [0.0, 0.0, -90.0]               # roll, pitch, yaw about base's fixed axes x, y, z
    clock_s = -0.015                          # optional: what is added to its times, where its clock is off

The horizontal lidar gives the poses, the vertical ones are labelled. A lidar without translation and rotation takes them from
the bag's transforms.
"""

import difflib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.errors import InputError
from ffmap.loaders.text_files import read_toml

Role = Literal["horizontal", "vertical"]
_ROLES: dict[str | None, tuple[Role, ...]] = {
    None: (),
    "horizontal": ("horizontal",),
    "vertical": ("vertical",),
    "both": ("horizontal", "vertical"),
}

_KEYS = ("topic", "frame", "role", "translation", "quaternion_xyzw", "rpy_deg", "clock_s", "sensor")
_FILE_KEYS = ("description", "source", "with_topics", "base", "lidar")

BUILT_IN = Path(__file__).parent / "rigs"
"""The folder of the rigs of public data sets, a file each."""

_CLOCK_MAX_S = 10.0


@dataclass(frozen=True, eq=False)
class RigEntry:
    """A lidar of a rig file; T_base_sensor is None where the bag's transforms are to tell. clock_s: added to its times.
    sensor: its model, for people.
    """

    topic: str | None
    frame: str | None
    roles: tuple[Role, ...]
    T_base_sensor: FloatArray | None
    clock_s: float = 0.0
    sensor: str | None = None


@dataclass(frozen=True, eq=False)
class RigFile:
    """A rig file, as the module's docstring describes it."""

    path: Path
    base: str | None
    lidars: tuple[RigEntry, ...]
    description: str = ""
    source: str = ""
    with_topics: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name of a built-in rig; of another the file's, without its ending."""
        return self.path.stem

    @property
    def said(self) -> str:
        """What it is called in a sentence."""
        return f"the built-in rig {self.name}" if self.path.parent == BUILT_IN else f"the rig file {self.path}"


def built_in_rigs() -> tuple[RigFile, ...]:
    """The rigs of public data sets, by name."""
    return tuple(read_rig_file(path) for path in sorted(BUILT_IN.glob("*.toml")))


def rig_path(word: Path) -> Path:
    """The file that a user means: one that is there, else the built-in rig of that name.

    Raises InputError where it is neither; a path with a folder or an ending is never taken for a name.
    """
    if word.exists() or word.name != str(word) or word.suffix:
        return word
    return built_in_path(str(word))


def built_in_path(name: str) -> Path:
    """The file of a built-in rig. Raises InputError that lists the names where there is none of this one."""
    known = {path.stem: path for path in sorted(BUILT_IN.glob("*.toml"))}
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise InputError(f"{name}: no built-in rig; {hint}The built-in ones are {', '.join(known)}")
    return known[name]


def read_rig_file(path: Path) -> RigFile:
    """A rig file. Raises InputError that names the file and the key."""
    content = read_toml(
        path, "give a rig file to --rig, as README.md shows one, or the name of a built-in one ('ffmap rigs')"
    )
    _check_keys(path, content, _FILE_KEYS, "")
    lidars = content.get("lidar", [])
    if not isinstance(lidars, list) or not lidars or not all(isinstance(entry, dict) for entry in lidars):
        raise InputError(f"{path}: no [[lidar]] in the rig file; give one for each lidar, with topic or frame")
    base = content.get("base")
    if base is not None and not isinstance(base, str):
        raise InputError(f"{path}: base must be the name of a frame")
    entries = tuple(_rig_entry(path, entry, i + 1) for i, entry in enumerate(lidars))
    if base is None and any(entry.T_base_sensor is not None for entry in entries):
        base = "base_link"
    description, source = (_words(path, content, key, "") or "" for key in ("description", "source"))
    with_topics = content.get("with_topics", [])
    if not isinstance(with_topics, list) or not all(isinstance(topic, str) for topic in with_topics):
        raise InputError(f"{path}: with_topics must be a list of names of topics")
    return RigFile(path, base.removeprefix("/") if base else None, entries, description, source, tuple(with_topics))


def _words(path: Path, content: dict[str, Any], key: str, where: str) -> str | None:
    words = content.get(key)
    if words is not None and not isinstance(words, str):
        raise InputError(f"{path}: {where}{key} must be text")
    return words


def _rig_entry(path: Path, entry: dict[str, Any], number: int) -> RigEntry:
    where = f"[[lidar]] {number}: "
    _check_keys(path, entry, _KEYS, where)
    topic, frame, role = entry.get("topic"), entry.get("frame"), entry.get("role")
    for key, value in (("topic", topic), ("frame", frame)):
        if value is not None and not isinstance(value, str):
            raise InputError(f"{path}: {where}{key} must be a name")
    if topic is None and frame is None:
        raise InputError(f"{path}: {where}neither topic nor frame says which lidar is meant; give one")
    if not isinstance(role, str | None) or role not in _ROLES:
        raise InputError(f'{path}: {where}role {role!r} must be "horizontal", "vertical" or "both"')
    if "quaternion_xyzw" in entry and "rpy_deg" in entry:
        raise InputError(f"{path}: {where}give quaternion_xyzw or rpy_deg, not both")
    if not {"translation", "quaternion_xyzw", "rpy_deg"} & set(entry):
        T = None
    else:
        translation = _numbers(path, entry, "translation", 3, [0.0, 0.0, 0.0], where)
        if "rpy_deg" in entry:
            angles = _numbers(path, entry, "rpy_deg", 3, [0.0, 0.0, 0.0], where)
            T = transforms.make_transform(Rotation.from_euler("xyz", angles, degrees=True), translation)
        else:
            quaternion = _numbers(path, entry, "quaternion_xyzw", 4, [0.0, 0.0, 0.0, 1.0], where)
            if abs(float(np.linalg.norm(quaternion)) - 1.0) > 0.05:
                raise InputError(f"{path}: {where}quaternion_xyzw has not the length 1; give x y z w")
            T = transforms.from_quaternion(translation, quaternion)
    clock_s = entry.get("clock_s", 0.0)
    if isinstance(clock_s, bool) or not isinstance(clock_s, int | float) or not abs(clock_s) <= _CLOCK_MAX_S:
        raise InputError(f"{path}: {where}clock_s must be a number of seconds, at most {_CLOCK_MAX_S:g} either way")
    sensor = _words(path, entry, "sensor", where)
    return RigEntry(topic, frame.removeprefix("/") if frame else None, _ROLES[role], T, float(clock_s), sensor)


def _numbers(path: Path, entry: dict[str, Any], key: str, count: int, default: list[float], where: str) -> list[float]:
    values = entry.get(key, default)
    sound = isinstance(values, list) and len(values) == count
    if not sound or not all(isinstance(v, int | float) and np.isfinite(v) for v in values):
        raise InputError(f"{path}: {where}{key} must be {count} numbers")
    return [float(v) for v in values]


def _check_keys(path: Path, content: dict[str, Any], known: tuple[str, ...], where: str) -> None:
    for key in content:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"
            raise InputError(f"{path}: {where}unknown key {key}; {hint}")
