"""All settings of a run: one frozen model for each step; defaults, then a TOML file, then --set."""

import difflib
import hashlib
import json
import math
import reprlib
import tomllib
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field, ValidationError

from ffmap.algorithms.base.scan import ScanSettings
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.base.trajectory import TrajectorySettings
from ffmap.algorithms.building.blinds import BlindsSettings
from ffmap.algorithms.building.door_casings import DoorCasingsSettings
from ffmap.algorithms.building.door_contrasts import DoorContrastsSettings
from ffmap.algorithms.building.door_frames import DoorFramesSettings
from ffmap.algorithms.building.door_outlines import DoorOutlinesSettings
from ffmap.algorithms.building.face_alignment import FaceAlignmentSettings
from ffmap.algorithms.building.face_columns import FaceColumnsSettings
from ffmap.algorithms.building.face_foreground import ForegroundSettings
from ffmap.algorithms.building.face_steps import FaceStepsSettings
from ffmap.algorithms.building.face_verdicts import StandingWallsSettings
from ffmap.algorithms.building.final_labels import RelabellingSettings
from ffmap.algorithms.building.folds import FoldsSettings
from ffmap.algorithms.building.fusion import FusionSettings
from ffmap.algorithms.building.glass_fronts import GlassFrontsSettings
from ffmap.algorithms.building.halo import HaloSettings
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.low_walls import LowWallsSettings
from ffmap.algorithms.building.missed_walls import MissedWallsSettings
from ffmap.algorithms.building.model import BuildingSettings
from ffmap.algorithms.building.openings import OpeningsSettings
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.building.windows import WindowsSettings
from ffmap.algorithms.maps.all_maps import MapsSettings
from ffmap.algorithms.maps.area_graph import AreaGraphSettings
from ffmap.algorithms.maps.grid import GridMapSettings
from ffmap.algorithms.poses.odometry import OdometrySettings
from ffmap.algorithms.poses.pose_graph import PoseGraphSettings
from ffmap.algorithms.poses.refinement import RefinementSettings
from ffmap.algorithms.scan.doors import DoorsSettings
from ffmap.algorithms.scan.labelling import LabellingSettings, MethodSettings
from ffmap.algorithms.scan.rearrangement import RearrangementSettings
from ffmap.algorithms.scan.smoothing import SmoothingSettings
from ffmap.algorithms.scan.vertical_structures import VerticalStructuresSettings
from ffmap.algorithms.scan.wall_candidates import WallPlanesSettings
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.text_files import SETTINGS_LINE_MAX, dotted_keys, read_toml

Steps = TypeVar("Steps", MethodSettings, FusionSettings, MapsSettings)


class Settings(StepSettings):
    """Settings by step, in the order of the paper."""

    seed: int = Field(0, ge=0, description="Seed of all random numbers; a scan's depend on it and on the scan's index.")
    odometry: OdometrySettings = OdometrySettings()
    refinement: RefinementSettings = RefinementSettings()
    pose_graph: PoseGraphSettings = PoseGraphSettings()
    trajectory: TrajectorySettings = TrajectorySettings()
    scan: ScanSettings = ScanSettings()
    smoothing: SmoothingSettings = SmoothingSettings()
    rearrangement: RearrangementSettings = RearrangementSettings()
    vertical_structures: VerticalStructuresSettings = VerticalStructuresSettings()
    wall_planes: WallPlanesSettings = WallPlanesSettings()
    doors: DoorsSettings = DoorsSettings()
    labelling: LabellingSettings = LabellingSettings()
    building: BuildingSettings = BuildingSettings()
    levels: LevelsSettings = LevelsSettings()
    face_columns: FaceColumnsSettings = FaceColumnsSettings()
    face_alignment: FaceAlignmentSettings = FaceAlignmentSettings()
    face_steps: FaceStepsSettings = FaceStepsSettings()
    standing_walls: StandingWallsSettings = StandingWallsSettings()
    folds: FoldsSettings = FoldsSettings()
    missed_walls: MissedWallsSettings = MissedWallsSettings()
    low_walls: LowWallsSettings = LowWallsSettings()
    foreground: ForegroundSettings = ForegroundSettings()
    openings: OpeningsSettings = OpeningsSettings()
    windows: WindowsSettings = WindowsSettings()
    blinds: BlindsSettings = BlindsSettings()
    glass_fronts: GlassFrontsSettings = GlassFrontsSettings()
    door_casings: DoorCasingsSettings = DoorCasingsSettings()
    door_contrasts: DoorContrastsSettings = DoorContrastsSettings()
    door_outlines: DoorOutlinesSettings = DoorOutlinesSettings()
    door_frames: DoorFramesSettings = DoorFramesSettings()
    wall_thickness: WallThicknessSettings = WallThicknessSettings()
    grid_map: GridMapSettings = GridMapSettings()
    area_graph: AreaGraphSettings = AreaGraphSettings()
    halo: HaloSettings = HaloSettings()
    relabelling: RelabellingSettings = RelabellingSettings()

    @property
    def method(self) -> MethodSettings:
        """What labels a single scan."""
        return self._of(MethodSettings)

    @property
    def fusion(self) -> FusionSettings:
        """What makes the building of all scans."""
        return self._of(FusionSettings)

    @property
    def maps(self) -> MapsSettings:
        """What draws its maps."""
        return self._of(MapsSettings)

    def _of(self, steps: type[Steps]) -> Steps:
        """The settings of several steps, which a dataclass names."""
        return steps(**{step.name: getattr(self, step.name) for step in fields(steps)})

    def flat(self) -> dict[str, Any]:
        """Every setting by its dotted name."""
        return dotted_keys(self.model_dump(mode="json"))

    def short_hash(self, *steps: str) -> str:
        """Eight hexadecimal digits that name these settings, or those of some steps."""
        chosen = self.model_dump(mode="json", include=set(steps) if steps else None)
        return hashlib.sha256(json.dumps(chosen, sort_keys=True).encode()).hexdigest()[:8]


def load_settings(config: Path | None, overrides: Sequence[str]) -> Settings:
    """Defaults, then `config` (TOML), then each override `step.name=value`.

    Raises InputError that names the file or the setting, and suggests the right name.
    """
    values: dict[str, Any] = {}
    source = "--set"
    if config is not None:
        source = f"{config} or --set" if overrides else str(config)
        values = read_toml(config, "give a TOML file, as 'ffmap settings' prints one")
    for override in overrides:
        if len(override) > SETTINGS_LINE_MAX:
            raise InputError(
                f"--set {shortened(override)}: has more than {SETTINGS_LINE_MAX} characters; give one setting and its value"
            )
        name, equals, text = override.partition("=")
        if not equals or not name:
            raise InputError(f"--set {override}: write it as step.name=value, as in wall_planes.similarity_m=0.05")
        *steps, last = name.strip().split(".")
        target = values
        for step in steps:
            target = target.setdefault(step, {})
            if not isinstance(target, dict):
                raise InputError(f"--set {override}: {step!r} is no step; {_suggestion(name)}")
        target[last] = parse_value(text.strip())
    return validate(values, source)


def validate(values: dict[str, Any], source: str) -> Settings:
    """Settings from nested values; raises InputError with the first thing that is wrong."""
    try:
        return Settings.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            if isinstance(first["input"], dict) and first["input"]:
                name = f"{name}.{next(iter(first['input']))}"
            raise InputError(f"{source}: there is no setting {name!r}; {_suggestion(name)}") from None
        if first["type"] == "model_type":
            own = next((known for known in Settings().flat() if known.startswith(f"{name}.")), "doors.lines_min")
            raise InputError(
                f"{source}: {name!r} is a group of settings and has no value itself; name one in it, as {own!r}; 'ffmap "
                "settings' lists them all"
            ) from None
        value = first["input"]
        wrong = first["msg"].removeprefix("Value error, ")
        if isinstance(value, float) and not math.isfinite(value):
            wrong = "is no finite number"  # a bound that not-a-number is said to be beyond is no help
        raise InputError(
            f"{source}: setting {name} = {_shortened(value)}: {wrong}; 'ffmap settings' lists them all"
        ) from None


def _shortened(value: object) -> str:
    """A value as it is written, without the middle of a long one; of an integer with thousands of digits their number."""
    if isinstance(value, int) and abs(value) > 10**100:
        return f"an integer of {value.bit_length()} bits"
    return reprlib.repr(value)


def _suggestion(name: str) -> str:
    """The setting that may be meant: one whose own name is alike, under whatever step it stands."""
    alike = [
        known for known in Settings().flat() if _likeness(*(n.rpartition(".")[2] for n in (name, known))) >= _ALIKE
    ]
    if not alike:
        return "'ffmap settings' lists them all"
    return f"did you mean {max(alike, key=lambda known: _likeness(name, known))!r}? 'ffmap settings' lists them all"


_ALIKE = 0.6


def _likeness(name: str, other: str) -> float:
    return difflib.SequenceMatcher(None, name, other).ratio()


def parse_value(text: str) -> Any:  # noqa: ANN401 - a TOML value
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def as_toml(settings: Settings) -> str:
    """The settings as a TOML file, each with its description as a comment."""
    lines = [f"# {Settings.model_fields['seed'].description}", f"seed = {settings.seed}"]
    for step, model in settings:
        if not isinstance(model, StepSettings):
            continue
        lines += ["", f"# {(type(model).__doc__ or '').strip().splitlines()[0]}", f"[{step}]"]
        for name, value in model:
            lines += [f"# {type(model).model_fields[name].description}", f"{name} = {json.dumps(value)}"]
    return "\n".join(lines) + "\n"
