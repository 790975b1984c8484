"""The ranges that buildings are drawn from, each with its source; the defaults are the widest, the kinds narrow them.

Sources, abbreviated: DIN 18101 (door leaves), DIN 4172 and DIN 18183 (masonry, plasterboard partitions), DIN 18065 (stairs),
MBO (German model building code), IBC and IRC (International Building and Residential Code), ADA (2010 Standards for
Accessible Design), NFPA 101. "Catalogues" are makers' common ranges, where no code sets a bound.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Literal, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator


def _both_ends(value: object) -> object:
    """A single number pins a property: both ends of its range."""
    return (value, value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _in_order(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError("a range begins with its lower end")
    return ends


def _certain(value: object) -> object:
    """A single name pins a choice: all the weight is its."""
    return {value: 1.0} if isinstance(value, str) else value


def _some_weight(weights: dict[str, float]) -> dict[str, float]:
    if not weights or min(weights.values()) < 0 or not sum(weights.values()) > 0:
        raise ValueError("weights are positive")
    return weights


Range = Annotated[tuple[float, float], BeforeValidator(_both_ends), AfterValidator(_in_order)]
Share = Annotated[float, Field(ge=0, le=1)]

_LIMITS = {"lean_deg": (-50.0, 75.0), "turn_deg": (5.0, 120.0), "corridor_length_m": (5.0, 50.0)}
"""Beyond these a wall lies flat, a corridor goes back on itself, or the robot cannot turn in it."""

DoorStyle = Literal["hinged", "double", "sliding", "pocket", "opening", "arch"]
LeafPlace = Literal["flush", "flush behind", "middle", "recessed"]
WindowStyle = Literal["none", "single", "ribbon", "curtain wall"]
CeilingShape = Literal["flat", "stepped", "coffered", "beams", "sloping", "gable", "vault"]
GlassName = Literal["clear", "double", "coated", "frosted"]


ChoiceT = TypeVar("ChoiceT", bound=str)


class Ranges(BaseModel):
    """Least and most of every measure (a single number pins it), shares from 0 to 1, and weights of choices (a name pins it)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    corridor_m: Range = Field(
        (1.1, 4.0), description="clear width of the corridor (m): IRC R311.6 0.91, IBC 1020.3 1.12 to 2.44 (hospitals), halls"
    )
    corridor_length_m: Range = Field((6.0, 24.0), description="length of the corridor, all its legs (m)")
    turn_deg: Range = Field((15.0, 90.0), description="turn between two legs of the corridor (degrees)")
    legs: Annotated[dict[str, float], BeforeValidator(_certain), AfterValidator(_some_weight)] = Field(
        {"one": 0.5, "two": 0.5}, description="legs of the corridor"
    )
    room_width_m: Range = Field((2.2, 7.0), description="width of a room (m): IRC R304.2 2.13 at least; classrooms 7")
    room_depth_m: Range = Field((2.6, 8.0), description="depth of a room (m): as its width")
    skew_m: Range = Field((0.0, 1.2), description="how far a wall between rooms leans along the façade (m): none, or acute plots")
    round_share: Share = Field(0.2, description="share of rooms with a round corner")
    round_m: Range = Field((0.3, 3.0), description="radius of a round corner (m): plasterboard can be bent to 0.3 (makers)")
    bay_share: Share = Field(0.1, description="share of rooms with a round bay in the façade")

    inner_wall_m: Range = Field(
        (0.07, 0.40), description="thickness of inner walls (m): gypsum blocks 0.07, DIN 18183 0.075; DIN 4172 0.365 and plaster"
    )
    outer_wall_m: Range = Field((0.12, 0.60), description="thickness of outer walls (m): IRC R602 0.12; old masonry 0.6")
    niche_share: Share = Field(0.25, description="share of thick walls with a niche")
    niche_depth_m: Range = Field((0.05, 0.35), description="depth of a niche (m): a light switch panel to a bookcase")
    lean_share: Share = Field(0.2, description="share of rooms with a leaning wall")
    lean_deg: Range = Field(
        (-25.0, 60.0), description="lean of a wall from upright (degrees), top outward below 0; pitched roofs have 25 to 60"
    )
    half_wall_share: Share = Field(0.3, description="share of rooms over 12 m² with a half-height wall")
    half_wall_m: Range = Field(
        (0.7, 1.9), description="height of half-height walls (m): MBO section 38 parapets 0.9; shower and booth walls 1.9"
    )
    half_wall_thickness_m: Range = Field((0.07, 0.30), description="thickness of half-height walls (m): as inner walls")
    pillar_share: Share = Field(0.35, description="share of rooms over 12 m² with a pillar")
    pillar_m: Range = Field((0.12, 0.9), description="side or diameter of a pillar (m): steel sections 0.12 to clad concrete 0.9")

    ceiling_m: Range = Field(
        (2.1, 7.0), description="height of ceilings (m): IRC R305.1 2.13 for halls, MBO section 47 2.4; foyers and gyms 7"
    )
    storey_spread_m: Range = Field((0.0, 1.2), description="how much rooms of one building differ in height (m)")
    ceiling: Annotated[dict[CeilingShape, float], BeforeValidator(_certain), AfterValidator(_some_weight)] = Field(
        {"flat": 0.4, "stepped": 0.12, "coffered": 0.1, "beams": 0.14, "sloping": 0.1, "gable": 0.07, "vault": 0.07},
        description="shape of ceilings",
    )
    drop_m: Range = Field((0.08, 0.6), description="depth of beams, coffers and soffits (m): gypsum coves 0.08, girders 0.6")
    slope_deg: Range = Field((2.0, 35.0), description="slope of sloping ceilings (degrees): flat roofs 2, pitched roofs 35")
    soffit_share: Share = Field(0.25, description="share of rooms with a soffit along a wall (ducts, kitchen bulkheads)")
    skylight_share: Share = Field(0.12, description="share of rooms with a skylight")
    skylight_m: Range = Field((0.55, 2.5), description="sides of a skylight (m): roof window catalogues 0.55 to light bands")

    door: Annotated[dict[DoorStyle, float], BeforeValidator(_certain), AfterValidator(_some_weight)] = Field(
        {"hinged": 0.6, "double": 0.12, "sliding": 0.1, "pocket": 0.06, "opening": 0.07, "arch": 0.05},
        description="style of doors; opening and arch have no leaf",
    )
    door_width_m: Range = Field((0.61, 1.25), description="clear width, one leaf (m): DIN 18101 0.61 to 1.235; ADA 404.2.3 0.815")
    double_width_m: Range = Field((1.2, 2.1), description="clear width of double doors and openings (m): DIN 18101 to 2.0")
    door_head_m: Range = Field(
        (1.95, 2.5), description="height of door heads (m): DIN 18101 1.985 and 2.11, IBC 1010.1.1.1 2.03; tall doors 2.5"
    )
    full_height_share: Share = Field(0.08, description="share of doors that reach the ceiling")
    leaf: Annotated[dict[LeafPlace, float], BeforeValidator(_certain), AfterValidator(_some_weight)] = Field(
        {"flush": 0.3, "flush behind": 0.2, "middle": 0.25, "recessed": 0.25},
        description="where a closed leaf stands in its wall, seen from the corridor",
    )
    recess_m: Range = Field((0.01, 0.15), description="depth of a recessed leaf behind the wall (m): rebates 0.01 to porches")
    casing_m: Range = Field((0.0, 0.03), description="how far casings stand out of the wall (m): none, to moulded casings")
    casing_width_m: Range = Field((0.04, 0.12), description="width of casings (m): DIN 18111 steel frames 0.04, timber 0.12")
    glazed_share: Share = Field(0.2, description="share of leaves with a pane")
    alike_share: Share = Field(0.0, description="share of leaves with their wall's finish: concealed (jib) doors")
    connecting_share: Share = Field(0.2, description="share of walls between rooms with a door")
    door_sill_m: Range = Field((0.0, 0.025), description="height of door sills (m): ADA 404.2.5 0.013 and 0.019, DIN 18040 0.02")

    window: Annotated[dict[WindowStyle, float], BeforeValidator(_certain), AfterValidator(_some_weight)] = Field(
        {"none": 0.25, "single": 0.4, "ribbon": 0.2, "curtain wall": 0.15}, description="windows of a façade"
    )
    sill_m: Range = Field((0.0, 1.6), description="height of window sills (m): French windows 0, IRC R310 rescue 1.12, cellars 1.6")
    head_gap_m: Range = Field((0.0, 0.7), description="wall between a window's head and the ceiling (m)")
    pitch_m: Range = Field((1.2, 3.6), description="distance of windows (m): façade grids 1.2 to 1.35, and wide ones")
    mullion_m: Range = Field((0.04, 0.12), description="width of mullions and frames (m): steel 0.04, timber 0.12")
    mullion_pitch_m: Range = Field((0.6, 1.8), description="distance of mullions (m): curtain wall catalogues")
    glass: Annotated[dict[GlassName, float], BeforeValidator(_certain), AfterValidator(_some_weight)] = Field(
        {"clear": 0.25, "double": 0.4, "coated": 0.25, "frosted": 0.1}, description="glass of windows and doors (see glass.py)"
    )
    partition_share: Share = Field(0.2, description="share of rooms with a glazed wall to the corridor")
    blind_share: Share = Field(0.3, description="share of windows with a blind")
    blind_drop: Range = Field((0.1, 0.9), description="share of a window that a blind covers, from its head down")
    curtain_share: Share = Field(0.25, description="share of windows with curtains")

    stairs_share: Share = Field(0.5, description="share of buildings with a flight of stairs in a room that has the space")
    riser_m: Range = Field((0.13, 0.20), description="rise of a step (m): ADA 504.2 0.10 to 0.18, DIN 18065 0.14 to 0.20")
    going_m: Range = Field((0.23, 0.35), description="going of a step (m): DIN 18065 0.23 to 0.37, ADA 504.2 0.28 at least")
    flight_m: Range = Field((0.6, 1.3), description="width of a flight of stairs (m): DIN 18065 0.5 (side stairs), 0.8, 1.0")
    platform_share: Share = Field(0.3, description="share of buildings with a platform in a room")
    platform_m: Range = Field((0.1, 1.0), description="height of a platform (m): computer floors 0.1, stages 1.0")
    ramp_share: Share = Field(0.15, description="share of buildings with a ramp in the corridor")
    ramp_m: Range = Field((0.1, 0.7), description="rise of a ramp (m): ADA 405.6 0.76 at most in one run")
    ramp_gradient: Range = Field((0.04, 0.125), description="gradient of a ramp: ADA 405.2 1:12, in existing buildings 1:8")

    off_wall_m: Range = Field((0.0, 0.15), description="gap between furniture and wall (m): none, to skirting and pipes")
    picture_share: Share = Field(0.6, description="how densely pictures, posters, boards and mirrors hang")

    @model_validator(mode="after")
    def _is_of_a_building(self) -> Self:
        """No measure is under half the least, or over twice the most, that codes and catalogues know, or has no building."""
        for name in self.model_fields_set:
            known, own = type(self).model_fields[name].default, getattr(self, name)
            if isinstance(known, tuple):
                low, high = _LIMITS.get(name, (known[0] / 2, 2 * known[1]))
                if own[0] < low or own[1] > high:
                    raise ValueError(f"{name} lies between {low:g} and {high:g}")
        return self


KINDS: Mapping[str, Ranges] = MappingProxyType(
    {
        "dwelling": Ranges(
            corridor_m=(1.15, 2.0), corridor_length_m=(7.0, 12.0), room_width_m=(2.3, 4.8), room_depth_m=(2.8, 5.0),
            ceiling_m=(2.1, 3.4), storey_spread_m=(0.0, 0.3), legs={"one": 0.6, "two": 0.4}, turn_deg=(60.0, 90.0),
            drop_m=(0.08, 0.3), pillar_m=(0.12, 0.4), pillar_share=0.15, round_m=(0.3, 1.2),
            window={"none": 0.15, "single": 0.75, "ribbon": 0.05, "curtain wall": 0.05},
            glass={"clear": 0.3, "double": 0.6, "coated": 0.1}, partition_share=0.03, curtain_share=0.5, ramp_share=0.0
        ),
        "workplace": Ranges(
            corridor_m=(1.3, 3.0), corridor_length_m=(12.0, 20.0), ceiling_m=(2.4, 4.2), inner_wall_m=(0.07, 0.25),
            room_width_m=(2.4, 6.0), room_depth_m=(3.5, 7.0),
            window={"none": 0.1, "single": 0.3, "ribbon": 0.35, "curtain wall": 0.25},
            glass={"clear": 0.1, "double": 0.4, "coated": 0.4, "frosted": 0.1}, glazed_share=0.35, partition_share=0.35,
            curtain_share=0.1, blind_share=0.5
        ),
        "institution": Ranges(
            corridor_m=(1.8, 4.0), corridor_length_m=(12.0, 22.0), ceiling_m=(2.8, 7.0), inner_wall_m=(0.11, 0.40),
            outer_wall_m=(0.3, 0.6), room_width_m=(3.0, 7.0), room_depth_m=(4.0, 8.0), door_width_m=(0.82, 1.25),
            door={"hinged": 0.45, "double": 0.3, "sliding": 0.08, "pocket": 0.02, "opening": 0.07, "arch": 0.08}
        ),
    }
)  # fmt: skip
"""What each kind narrows: homes; offices, shops and laboratories; schools, hospitals, museums."""


def choose(weights: Mapping[ChoiceT, float], rng: np.random.Generator) -> ChoiceT:
    """One of the names, each as often as its weight says."""
    values = np.array(list(weights.values()))
    return list(weights)[int(rng.choice(len(values), p=values / values.sum()))]


def ranges_of(kind: str, said: Ranges) -> Ranges:
    """A kind's ranges, with what was said in their place."""
    return KINDS[kind].model_copy(update={name: getattr(said, name) for name in said.model_fields_set})
