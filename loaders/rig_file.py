"""Rig files: the extrinsics and roles of lidars, for bags without transforms.

    description = "our robot"                 # optional, as are source and the lidars' sensor
    with_topics = ["/odometry/filtered"]      # optional: a built-in rig requires these topics too
    base = "base_link"                        # the frame of the trajectory; x forward, z up

    [[lidar]]
    topic = "/horizontal/velodyne_points"     # topic or frame; with both, the frame is used
    frame = "velodyne_h"                      #     where the bag lacks the topic
    sensor = "Velodyne HDL-32E"
    role = "horizontal"                       # optional: "horizontal" (one), "vertical" or "both"
    translation = [0.12, 0.01, 0.568]         # T_base_lidar: metres
    quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]    # and rotation, or
    rpy_deg = [0.0, 0.0, -90.0]               # roll, pitch, yaw about the fixed axes of base
    clock_s = -0.015                          # optional: added to its times

The horizontal lidar gives the poses, the vertical ones are labelled. A lidar without translation
and rotation takes them from the bag's transforms. Rigs of public data sets are built in.
"""

import difflib
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    PrivateAttr,
    ValidationError,
    model_validator,
)
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.errors import InputError, first_problem
from ffmap.loaders.text_files import read_toml

BUILT_IN = Path(__file__).parent / "rigs"
"""The folder of the rigs of public data sets, a file each."""

Role = Literal["horizontal", "vertical"]
Frame = Annotated[str, AfterValidator(lambda name: name.removeprefix("/"))]
Vector = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]


class RigLidar(BaseModel):
    """A lidar of a rig file."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    topic: str | None = None
    frame: Frame | None = None
    sensor: str | None = None
    role: Literal["horizontal", "vertical", "both"] | None = None
    translation: Vector | None = None
    quaternion_xyzw: Quaternion | None = None
    rpy_deg: Vector | None = None
    clock_s: float = Field(0.0, ge=-10, le=10)

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if self.topic is None and self.frame is None:
            raise ValueError("neither topic nor frame; give one")
        if self.quaternion_xyzw and self.rpy_deg:
            raise ValueError("give quaternion_xyzw or rpy_deg, not both")
        if self.quaternion_xyzw and abs(np.linalg.norm(self.quaternion_xyzw) - 1.0) > 0.05:
            raise ValueError("quaternion_xyzw does not have length 1; give x y z w")
        return self

    @property
    def roles(self) -> tuple[Role, ...]:
        if self.role == "both":
            return ("horizontal", "vertical")
        return () if self.role is None else (self.role,)

    @cached_property
    def T_base_sensor(self) -> FloatArray | None:  # noqa: N802 - the field's notation
        """(4, 4); None where the bag's transforms are used."""
        if not (self.translation or self.quaternion_xyzw or self.rpy_deg):
            return None
        translation = self.translation or [0.0, 0.0, 0.0]
        if self.rpy_deg:
            turn = Rotation.from_euler("xyz", self.rpy_deg, degrees=True)
            return transforms.make_transform(turn, translation)
        return transforms.from_quaternion(translation, self.quaternion_xyzw or [0.0, 0.0, 0.0, 1.0])


class RigFile(BaseModel):
    """A rig file, as the module's docstring describes it."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    description: str = ""
    source: str = ""
    with_topics: list[str] = []
    base_name: Frame | None = Field(None, alias="base")
    lidars: list[RigLidar] = Field(alias="lidar", min_length=1)
    _path: Path = PrivateAttr()

    @property
    def path(self) -> Path:
        return self._path

    @property
    def base(self) -> str | None:
        """The frame of the trajectory; None to choose it by the bag's transforms."""
        placed = any(lidar.T_base_sensor is not None for lidar in self.lidars)
        return self.base_name or ("base_link" if placed else None)

    @property
    def name(self) -> str:
        return self.path.stem

    @property
    def label(self) -> str:
        """Its name in a sentence."""
        built_in = self.path.parent == BUILT_IN
        return f"the built-in rig {self.name}" if built_in else f"the rig file {self.path}"


def built_in_rigs() -> tuple[RigFile, ...]:
    """Read the rigs of public data sets, by name."""
    return tuple(read_rig_file(path) for path in sorted(BUILT_IN.glob("*.toml")))


def rig_path(name: Path) -> Path:
    """Find the file of a rig: an existing file, else the built-in rig of that name.

    Raises InputError where it is neither; a path with a folder or a suffix is never a name.
    """
    if name.exists() or name.name != str(name) or name.suffix:
        return name
    return built_in_path(str(name))


def built_in_path(name: str) -> Path:
    """Find the file of a built-in rig. Raises InputError with the known names."""
    known = {path.stem: path for path in sorted(BUILT_IN.glob("*.toml"))}
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise InputError(f"{name}: no built-in rig; {hint}The built-in ones are {', '.join(known)}")
    return known[name]


def read_rig_file(path: Path) -> RigFile:
    """Read a rig file. Raises InputError with the file and the key."""
    advice = "give a rig file to --rig, or the name of a built-in rig ('ffmap rigs' lists them)"
    content = read_toml(path, advice)
    try:
        rig = RigFile.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {_problem(error)}; {advice}") from None
    rig._path = path
    return rig


def _problem(error: ValidationError) -> str:
    unknown = [each["loc"] for each in error.errors() if each["type"] == "extra_forbidden"]
    if not unknown:
        return first_problem(error)
    *place, key = unknown[0]
    fields = (RigLidar if place else RigFile).model_fields
    known = [field.alias or name for name, field in fields.items()]
    close = difflib.get_close_matches(str(key), known, n=1)
    hint = f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"
    return f"unknown key {key}; {hint}"
