"""All settings of a run: defaults, then a TOML file, then --set."""

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
from ffmap.algorithms.scan.labelling import MethodSettings
from ffmap.algorithms.scan.rearrangement import RearrangementSettings
from ffmap.algorithms.scan.smoothing import SmoothingSettings
from ffmap.algorithms.scan.vertical_structures import VerticalStructuresSettings
from ffmap.algorithms.scan.wall_candidates import WallPlanesSettings
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.text_files import SETTINGS_LINE_MAX, dotted_keys, read_toml

Steps = TypeVar("Steps", MethodSettings, FusionSettings, MapsSettings)


class Settings(StepSettings):
    """Settings by step, in the order of the paper."""

    seed: int = Field(
        0, ge=0, description="Seed of random numbers, together with the number of the scan."
    )
    odometry: OdometrySettings = OdometrySettings()
    refinement: RefinementSettings = RefinementSettings()
    pose_graph: PoseGraphSettings = PoseGraphSettings()
    scan: ScanSettings = ScanSettings()
    smoothing: SmoothingSettings = SmoothingSettings()
    rearrangement: RearrangementSettings = RearrangementSettings()
    vertical_structures: VerticalStructuresSettings = VerticalStructuresSettings()
    wall_planes: WallPlanesSettings = WallPlanesSettings()
    doors: DoorsSettings = DoorsSettings()
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
        """Settings that label a single scan."""
        return self._of(MethodSettings)

    @property
    def fusion(self) -> FusionSettings:
        """Settings that fuse the building of all scans."""
        return self._of(FusionSettings)

    @property
    def maps(self) -> MapsSettings:
        """Settings that draw its maps."""
        return self._of(MapsSettings)

    def _of(self, steps: type[Steps]) -> Steps:
        return steps(**{step.name: getattr(self, step.name) for step in fields(steps)})

    def flat(self) -> dict[str, Any]:
        """Return every setting by its dotted name."""
        return dotted_keys(self.model_dump(mode="json"))

    def short_hash(self) -> str:
        """Hash the settings to eight hexadecimal digits."""
        content = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:8]


def load_settings(config: Path | None, overrides: Sequence[str]) -> Settings:
    """Apply `config` (TOML) to the defaults, then each override `step.name=value`.

    Raises InputError that names the file or the setting, and suggests a name.
    """
    values: dict[str, Any] = {}
    source = "--set"
    if config is not None:
        source = f"{config} or --set" if overrides else str(config)
        values = read_toml(config, "give a TOML file, as 'ffmap settings' prints one")
    for override in overrides:
        if len(override) > SETTINGS_LINE_MAX:
            raise InputError(
                f"--set {shortened(override)}: has more than {SETTINGS_LINE_MAX} characters; give "
                "one setting and its value"
            )
        name, equals, text = override.partition("=")
        if not equals or not name:
            raise InputError(
                f"--set {override}: write it as step.name=value, as in "
                "wall_planes.similarity_m=0.05"
            )
        *steps, last = name.strip().split(".")
        target = values
        for step in steps:
            target = target.setdefault(step, {})
            if not isinstance(target, dict):
                raise InputError(f"--set {override}: {step!r} is no step; {_suggestion(name)}")
        target[last] = parse_value(text.strip())
    return validate(values, source)


def validate(values: dict[str, Any], source: str) -> Settings:
    """Create settings from nested values. Raises InputError with the first problem."""
    try:
        return Settings.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{source}: {_problem(error)}") from None


def _problem(error: ValidationError) -> str:
    first = error.errors()[0]
    name, value = ".".join(str(part) for part in first["loc"]), first["input"]
    if first["type"] == "extra_forbidden":
        if isinstance(value, dict) and value:
            name = f"{name}.{next(iter(value))}"
        return f"there is no setting {name!r}; {_suggestion(name)}"
    if first["type"] == "model_type":
        own = (known for known in Settings().flat() if known.startswith(f"{name}."))
        return (
            f"{name!r} is a group of settings and has no value itself; name one in it, as "
            f"{next(own, 'doors.lines_min')!r}; {_LIST}"
        )
    wrong = first["msg"].removeprefix("Value error, ")
    if isinstance(value, float) and not math.isfinite(value):
        wrong = "is no finite number"
    if isinstance(value, int) and abs(value) > 10**100:
        return f"setting {name} = an integer of {value.bit_length()} bits: {wrong}; {_LIST}"
    return f"setting {name} = {reprlib.repr(value)}: {wrong}; {_LIST}"


_LIST = "'ffmap settings' lists them all"


def _suggestion(name: str) -> str:
    """Suggest a setting whose own name is alike, in whatever step."""
    own_names = {known: known.rpartition(".")[2] for known in Settings().flat()}
    own = difflib.get_close_matches(name.rpartition(".")[2], own_names.values(), n=10)
    alike = [known for known, own_name in own_names.items() if own_name in own]
    if not alike:
        return _LIST
    (best,) = difflib.get_close_matches(name, alike, n=1, cutoff=0.0)
    return f"did you mean {best!r}? {_LIST}"


def parse_value(text: str) -> Any:  # noqa: ANN401 - a TOML value
    """Parse a TOML value; other text is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def as_toml(settings: Settings) -> str:
    """Format the settings as a TOML file, each with its description as a comment."""
    lines = [f"# {Settings.model_fields['seed'].description}", f"seed = {settings.seed}"]
    for step, model in settings:
        if isinstance(model, StepSettings):
            kind = type(model)
            lines += ["", f"# {(kind.__doc__ or '').strip().splitlines()[0]}", f"[{step}]"]
            for name, value in model:
                description = kind.model_fields[name].description
                lines += [f"# {description}", f"{name} = {json.dumps(value)}"]
    return "\n".join(lines) + "\n"
