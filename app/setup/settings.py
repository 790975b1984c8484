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
from ffmap.algorithms.building.face_foreground import ForegroundSettings
from ffmap.algorithms.building.final_labels import RelabellingSettings
from ffmap.algorithms.building.fusion import FusionSettings
from ffmap.algorithms.building.levels import LevelsSettings
from ffmap.algorithms.building.low_walls import LowWallsSettings
from ffmap.algorithms.building.model import BuildingSettings
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.building.unseen_walls import UnseenWallsSettings
from ffmap.algorithms.building.verdicts import StandingWallsSettings
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

SCAN_LABELS = "scan labels"
_ACTS_ON = {
    "poses": "poses, and so on everything",
    "base": SCAN_LABELS,
    "scan": SCAN_LABELS,
    "building": "final labels and maps",
    "maps": "maps and rooms",
}
"""What the settings of a step act on, by its folder in `algorithms`.

The building is made of the scans' labels and wall planes, and decides on the final labels.
"""
MAIN: dict[str, tuple[str, str]] = {
    "scan.range_max_m": (
        "far walls of large halls are missing",
        "far returns are errors, as behind glass",
    ),
    "rearrangement.floor_height_m": (
        "an uneven floor becomes clutter",
        "skirting, cables or low objects become floor",
    ),
    "rearrangement.ceiling_distance_m": (
        "an uneven ceiling becomes clutter",
        "lamps or ducts become ceiling",
    ),
    "wall_planes.similarity_m": (
        "uneven walls are missing",
        "walls blend with the furniture in front of them",
    ),
    "building.length_min_m": (
        "furniture makes short false walls",
        "pillars and short walls are missing",
    ),
    "building.recess_min_m": (
        "steps in walls become closed doors",
        "closed doors that are almost flush with the wall are missing",
    ),
    "building.door_width_min_m": (
        "gaps between furniture become doors",
        "narrow doors are missing",
    ),
    "building.door_width_max_m": (
        "wide doors are missing",
        "wide passages or recesses become doors",
    ),
    "relabelling.range_noise_m": (
        "walls keep a fringe of clutter",
        "flat objects on walls become wall",
    ),
    "foreground.relief_m": (
        "uneven walls become clutter",
        "flat furniture against a wall becomes wall",
    ),
}
"""The settings that changed figures most on simulated drives, with the reasons to raise and to
lower them."""
_HEADING = """\
# The settings that change figures most. 'ffmap settings WORD' prints those with WORD in their text,
# 'ffmap settings --all' all. Scan labels reach the final labels only through the building."""
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
    standing_walls: StandingWallsSettings = StandingWallsSettings()
    parse: ParseSettings = ParseSettings()
    unseen_walls: UnseenWallsSettings = UnseenWallsSettings()
    low_walls: LowWallsSettings = LowWallsSettings()
    foreground: ForegroundSettings = ForegroundSettings()
    wall_thickness: WallThicknessSettings = WallThicknessSettings()
    grid_map: GridMapSettings = GridMapSettings()
    area_graph: AreaGraphSettings = AreaGraphSettings()
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
                "relabelling.range_noise_m=0.03"
            )
        put(values, name.strip(), parse_value(text.strip()), f"--set {override}")
    return validate(values, source)


def put(values: dict[str, Any], name: str, value: Any, source: str) -> None:  # noqa: ANN401
    """Put a setting into nested values by its dotted name.

    Raises InputError, which begins with `source`, where a part of the name has a value already.
    """
    *steps, last = name.split(".")
    for step in steps:
        values = values.setdefault(step, {})
        if not isinstance(values, dict):
            raise InputError(f"{source}: {step!r} is no step; {_suggestion(name)}")
    values[last] = value


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


_LIST = "'ffmap settings --all' lists them all"


def _suggestion(name: str) -> str:
    """Suggest a setting whose own name is alike, in whatever step."""
    own_names = {known: known.rpartition(".")[2] for known in Settings().flat()}
    own = difflib.get_close_matches(name.rpartition(".")[2], own_names.values(), n=10)
    alike = [known for known, own_name in own_names.items() if own_name in own]
    if not alike:
        return _LIST
    (best,) = difflib.get_close_matches(name, alike, n=1, cutoff=0.0)
    decides = f"; {deciding} acts on final labels" if (deciding := decides_finally(best)) else ""
    return f"did you mean {best!r}? It acts on {acts_on(best)}{decides}; {_LIST}"


def acts_on(name: str) -> str | None:
    """Return what a setting acts on, by the folder of its step; None for an unknown setting."""
    step, _, own = name.partition(".")
    if name == "seed":
        return SCAN_LABELS
    field = Settings.model_fields.get(step)
    kind = field.annotation if field is not None else None
    if kind is None or own not in getattr(kind, "model_fields", {}):
        return None
    return _ACTS_ON[kind.__module__.split(".")[2]]


def decides_finally(name: str) -> str | None:
    """Return the setting of the building that is the counterpart of a scan's; None without one.

    doors.recess_min_m has building.recess_min_m, wall_planes.distance_m has
    relabelling.range_noise_m.
    """
    if acts_on(name) != SCAN_LABELS:
        return None
    step, _, own = name.partition(".")
    prefixed = f"{step.partition('_')[0].removesuffix('s')}_{own}"
    known = Settings().flat()
    candidates = (f"{of}.{own}" for own in (prefixed, own) for of in ("building", "relabelling"))
    return next((each for each in candidates if each in known), None)


def parse_value(text: str) -> Any:  # noqa: ANN401 - a TOML value
    """Parse a TOML value; other text is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def _description(name: str) -> str:
    step, _, last = name.rpartition(".")
    model = Settings.model_fields[step].annotation if step else Settings
    return str(model.model_fields[last].description)  # type: ignore[union-attr]


def _words(name: str) -> str:
    """Return what a setting is found by: its name, its description, and when to change it."""
    return " ".join((name, _description(name), *MAIN.get(name, ()))).lower()


def as_toml(settings: Settings, name: str | None = None, every: bool = False) -> str:
    """Format settings as TOML, each with its description and what it acts on.

    By default those of `MAIN` and those that are not at their defaults.

    Args:
        name: those whose names or descriptions contain it. every: all.

    Raises InputError if no setting is called like this.
    """
    values, usual = settings.flat(), Settings().flat()
    changed = [own for own, value in values.items() if value != usual[own]]
    names, lines = list(dict.fromkeys([*MAIN, *changed])), [_HEADING]
    if name is not None or every:
        wanted = (name or "").lower()
        names, lines = [own for own in values if every or wanted in _words(own)], []
    if not names:
        raise InputError(f"no setting {shortened(name or '')!r}; {_suggestion(name or '')}")
    group = None
    for own in names:
        step = own.rpartition(".")[0]
        model = type(getattr(settings, step)) if step else Settings
        acts = f"Acts on {acts_on(own)}."
        if every and step != group:
            heading = (model.__doc__ or "").strip().splitlines()[0] if step else "Random numbers."
            lines += ["", f"# --- {heading} {acts}"]
        group, description = step, _description(own)
        lines += [f"# {description}"] if every else ["", f"# {description} {acts}"]
        if own in MAIN:
            higher, lower = MAIN[own]
            lines.append(f"# Raise it if {higher}. Lower it if {lower}.")
        lines.append(f"{own} = {json.dumps(values[own])}")
    return "\n".join(lines).lstrip("\n") + "\n"
