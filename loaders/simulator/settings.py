"""Settings of a simulated drive: sensors, motion, and the ranges that the building is drawn from.

Sources, abbreviated: DIN 18101 (door leaves), DIN 4172 and DIN 18183 (masonry, partitions), IBC and
IRC (International Building and Residential Code), ADA (2010 Standards for Accessible Design).
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from ffmap.loaders.simulator.mesh import Rng, Span

Building = Literal[
    "office", "ell", "angled", "lab", "small", "dwelling", "workplace", "institution"
]
Sensor = Literal["hdl32e", "vlp16", "os1-16", "os0-128", "qt64", "xt32", "mid360"]
Layout = Literal[
    "plain", "mars", "backpack_3d", "ntu_viral", "newer_college", "oxford_spires", "hilti_2022"
]
Container = Literal["bag", "mcap", "db3"]
BuiltIn = Literal[
    "nothing", "round corner", "niche", "pillar", "half wall", "leaning wall", "steps"
]
CeilingShape = Literal["flat", "soffit", "beams", "coffered", "sloping", "gable", "vault"]
DoorStyle = Literal["hinged", "double", "sliding", "opening"]
LeafPlace = Literal["flush", "middle", "recessed", "flush behind"]
WindowStyle = Literal["none", "single", "ribbon", "curtain wall"]
GlassName = Literal["clear", "double", "coated", "frosted"]

T = TypeVar("T")


def _pinned(value: object) -> object:
    return (value, value) if isinstance(value, int | float) else value


def _in_order(ends: Span) -> Span:
    if ends[0] > ends[1]:
        raise ValueError("the lower end of a range comes first")
    return ends


def _listed(value: object) -> object:
    return (value,) if isinstance(value, str) else value


Range = Annotated[Span, BeforeValidator(_pinned), AfterValidator(_in_order)]
"""The lowest and the highest value; a single number sets both."""
_Names = (BeforeValidator(_listed), Field(min_length=1))
Share = Annotated[float, Field(ge=0, le=1)]


class SimulationSettings(BaseModel):
    """A drive through a building. `building` names a preset; the other settings replace its values.

    Ranges are drawn from uniformly, as are the names of a choice: a name listed twice is drawn
    twice as often. The defaults here are the widest ranges; `PRESETS` narrows them.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    building: Building = Field("office", description="kind of building")
    seed: int = Field(0, ge=0, description="seed of every random choice")
    duration_s: float = Field(60.0, gt=0.3, le=3600, description="duration (s); 1 s at rest first")
    format: Container = Field("bag", description="ROS 1 bag, or ROS 2 folder (mcap, db3)")

    sensor: Sensor = Field("hdl32e", description="model of the lidars")
    lidars: Literal["two", "one", "three", "upright"] = Field(
        "two",
        description="one upright and one on its side; one upright; one upright and two on their "
        "sides; two upright, front and rear",
    )
    layout: Layout = Field("plain", description="topics, frames and sensors of a public data set")
    mount_tilt_deg: float = Field(0.0, ge=-15, le=15, description="vertical lidar: tilt down (deg)")
    noise_m: float | None = Field(
        None, ge=0, le=0.1, description="range noise, sigma (m); 0: exact; default: the sensor's"
    )
    intensity_half_m: float | None = Field(
        None, gt=0, description="distance (m) that halves an intensity; default: calibrated"
    )
    speed_mps: float = Field(0.6, gt=0, le=2, description="speed (m/s)")
    sway_deg: float = Field(0.3, ge=0, le=3, description="amplitude of roll and pitch (deg)")

    corridor_m: Range = Field((1.1, 4.0), description="corridor width (m): IRC 0.91, IBC 1.12–2.44")
    corridor_length_m: Range = Field((6.0, 24.0), description="corridor length, all legs (m)")
    legs: Range = Field((1, 2), description="number of legs of the corridor")
    turn_deg: Range = Field((15.0, 90.0), description="turn between two legs (deg)")
    hall_m: Range = Field((0.0, 0.0), description="depth of a hall at the corridor's end (m)")
    room_width_m: Range = Field((2.2, 7.0), description="room width (m): IRC R304.2 2.13")
    room_depth_m: Range = Field((2.6, 8.0), description="room depth (m)")
    wall_thickness_m: Range = Field(
        (0.07, 0.40), description="thickness of inner walls (m): DIN 18183 0.075, DIN 4172 0.365"
    )
    built: Annotated[tuple[BuiltIn, ...], *_Names] = Field(
        ("nothing", *get_args(BuiltIn)), description="parts built into rooms, two drawn for each"
    )
    step_m: float = Field(0.0, ge=0, le=1, description="height of a platform in one room (m)")
    ramp_rise_m: float = Field(0.0, ge=0, le=1, description="rise of a ramp in the corridor (m)")
    floor_slope_deg: float = Field(0.0, ge=0, le=2, description="slope of the whole floor (deg)")

    ceiling_m: Range = Field((2.1, 7.0), description="ceiling height (m): IRC R305.1 2.13")
    ceiling: Annotated[tuple[CeilingShape, ...], *_Names] = Field(
        ("flat", "flat", "flat", "soffit", "beams", "coffered", "sloping", "gable", "vault"),
        description="shape of ceilings",
    )
    door: Annotated[tuple[DoorStyle, ...], *_Names] = Field(
        ("hinged", "hinged", "hinged", "hinged", "hinged", "double", "sliding", "opening"),
        description="style of doors; an opening has no leaf",
    )
    door_width_m: Range = Field((0.75, 1.25), description="width per leaf (m): ADA 404.2.3 0.815")
    door_head_m: Range = Field((1.95, 2.5), description="door height (m): DIN 18101 1.985, 2.11")
    leaf: Annotated[tuple[LeafPlace, ...], *_Names] = Field(
        ("flush", "flush behind", "middle", "recessed"),
        description="place of a closed leaf in the wall, seen from the corridor",
    )
    recess_m: Range = Field((0.01, 0.15), description="depth of a recessed leaf (m)")
    casing_m: Range = Field((0.0, 0.03), description="depth of door casings on the wall (m)")
    door_sills_m: Range = Field((0.0, 0.025), description="height of door sills (m): ADA 0.019")
    closed_share: Share = Field(0.4, description="share of closed doors")
    window: Annotated[tuple[WindowStyle, ...], *_Names] = Field(
        ("none", "single", "single", "ribbon", "curtain wall"), description="windows of a façade"
    )
    sill_m: Range = Field((0.0, 1.3), description="height of window sills (m): IRC R310 1.12")
    glass: Annotated[tuple[GlassName, ...], *_Names] = Field(
        ("clear", "double", "double", "coated", "frosted"), description="panes (see glass.py)"
    )
    glazed_share: Share = Field(0.2, description="share of leaves and corridor walls with panes")
    clutter: Share = Field(0.5, description="furniture, from empty (0) to crammed (1)")
    walking_people: int = Field(0, ge=0, le=20, description="number of people who walk around")

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, given: Mapping[str, Any]) -> dict[str, Any]:
        building = given.get("building", "office")
        return {**(PRESETS.get(building, {}) if isinstance(building, str) else {}), **given}

    @model_validator(mode="after")
    def _is_plausible(self) -> Self:
        """Reject what a layout decides, and ranges below half or above twice the widest range."""
        decided = self.model_fields_set & {"sensor", "lidars", "mount_tilt_deg"}
        if decided and self.layout != "plain":
            raise ValueError(f"layout {self.layout} decides {' and '.join(sorted(decided))} itself")
        for name in self.model_fields_set:
            widest, own = type(self).model_fields[name].default, getattr(self, name)
            if isinstance(widest, tuple) and isinstance(widest[0], int | float):
                low, high = _LIMITS.get(name, (widest[0] / 2, 2 * widest[1]))
                if own[0] < low or own[1] > high:
                    raise ValueError(f"{name} must be between {low:g} and {high:g}")
        return self


_LIMITS = {
    "legs": (1, 4), "turn_deg": (5, 120), "corridor_length_m": (5, 50), "hall_m": (0, 20),
    "ceiling_m": (2.1, 10),
}  # fmt: skip

_OFFICE: dict[str, Any] = {
    "corridor_m": (1.9, 2.6), "corridor_length_m": (18, 23), "legs": 1, "room_width_m": (3.0, 4.4),
    "room_depth_m": (4.2, 5.5), "wall_thickness_m": (0.12, 0.28),
    "built": ("nothing", "pillar"), "ceiling_m": (2.55, 3.2), "ceiling": "flat",
    "door": ("hinged",) * 7 + ("double",), "door_width_m": (0.82, 1.0), "door_head_m": (2.0, 2.12),
    "leaf": "recessed", "recess_m": (0.03, 0.06), "casing_m": 0, "door_sills_m": 0,
    "window": ("none", "single"), "sill_m": (0.7, 1.0), "glass": ("clear", "double"),
    "glazed_share": 0.05,
}  # fmt: skip
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "office": _OFFICE,
    "ell": _OFFICE | {"corridor_length_m": (23, 27), "legs": 2, "turn_deg": 90},
    "angled": _OFFICE | {"corridor_length_m": (19, 23), "legs": 3, "turn_deg": (22, 48)},
    "lab": _OFFICE | {"corridor_length_m": (11, 14), "hall_m": (8, 11)},
    "small": _OFFICE | {"corridor_length_m": 8, "corridor_m": 2.1, "room_depth_m": 4.2},
    "dwelling": {
        "corridor_m": (1.15, 2.0), "corridor_length_m": (7, 12), "room_width_m": (2.3, 4.8),
        "room_depth_m": (2.8, 5.0), "turn_deg": (60, 90), "ceiling_m": (2.1, 3.4),
        "window": ("none", "single", "single", "single", "single", "single", "ribbon"),
        "glass": ("clear", "double", "double"), "glazed_share": 0.1,
    },
    "workplace": {
        "corridor_m": (1.3, 3.0), "corridor_length_m": (12, 20), "room_width_m": (2.4, 6.0),
        "room_depth_m": (3.5, 7.0), "ceiling_m": (2.4, 4.2), "wall_thickness_m": (0.07, 0.25),
        "window": ("none", "single", "single", "ribbon", "ribbon", "curtain wall"),
        "glass": ("clear", "double", "double", "coated", "coated", "frosted"), "glazed_share": 0.35,
    },
    "institution": {
        "corridor_m": (1.8, 4.0), "corridor_length_m": (12, 22), "room_width_m": (3.0, 7.0),
        "room_depth_m": (4.0, 8.0), "ceiling_m": (2.8, 7.0), "wall_thickness_m": (0.11, 0.40),
        "door": ("hinged", "hinged", "hinged", "double", "double", "sliding", "opening"),
        "glazed_share": 0.15,
    },
}  # fmt: skip
"""The buildings: a straight corridor; one that turns a right angle, or at odd angles; one that ends
in a hall; three rooms or four; homes; offices and shops; schools, hospitals, museums."""


def choose(names: tuple[T, ...], rng: Rng) -> T:
    return names[int(rng.integers(len(names)))]


def draw(ends: Span, rng: Rng) -> float:
    return float(rng.uniform(*ends))
