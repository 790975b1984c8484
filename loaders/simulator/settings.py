"""What a simulated drive is made of; everything that is not said here is drawn from the seed."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from ffmap.loaders.simulator.drawn.ranges import Ranges

Sensor = Literal["hdl32e", "vlp16", "os1-16", "os0-128", "qt64", "xt32", "mid360"]
Container = Literal["bag", "mcap", "db3"]


class SimulationSettings(BaseModel):
    """A building, its contents, a robot's lidars and one drive through it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    building: str = Field("office", description="which plan is drawn (see BUILDINGS)")
    seed: int = Field(0, ge=0, description="every random choice follows from it")
    sensor: Sensor = Field("hdl32e", description="the model of the lidars")
    lidars: Literal["two", "one", "three", "upright"] = Field(
        "two",
        description="one upright and one on its side; an upright one alone; one upright and two on their sides, left and right; or "
        "two upright ones, front and rear",
    )
    layout: str = Field(
        "plain", description="the bag is laid out as that of a public data set (see LAYOUTS), or plainly"
    )
    format: Container = Field("bag", description="ROS 1 bag, or ROS 2 folder with MCAP (mcap) or SQLite (db3) inside")
    duration_s: float = Field(
        60.0, gt=0.3, le=3600, description="length of the drive (s); at rest for the first second"
    )
    workers: int = Field(2, ge=1, description="threads that trace rays; the bag does not depend on it")

    speed_mps: float = Field(0.6, gt=0, le=2, description="speed on straight lines, metres a second")
    turn_radps: float = Field(0.6, gt=0, le=2, description="fastest turn, radians a second")
    sway_deg: float = Field(0.3, ge=0, le=3, description="amplitude of roll and pitch while driving, degrees")

    ceiling_m: float | None = Field(None, ge=2.4, le=4.0, description="ceiling height in metres; drawn if not given")
    wall_thickness_m: float | None = Field(
        None, ge=0.1, le=0.5, description="thickness of inner walls (m); drawn if not given"
    )
    recess_min_m: float = Field(0.03, ge=0, le=0.1, description="minimum recess of a closed leaf behind its wall (m)")
    recess_max_m: float = Field(0.06, ge=0, le=0.1, description="maximum recess of a closed leaf behind its wall (m)")
    closed_share: float = Field(0.4, ge=0, le=1, description="share of doors that are closed")
    double_share: float = Field(0.12, ge=0, le=1, description="share of doors with two leaves")
    clutter: float = Field(0.5, ge=0, le=1, description="furniture, from empty (0) to crammed (1)")
    glass: float = Field(0.5, ge=0, le=1, description="share of glass in outer walls, and of glazed partitions inside")
    walking_people: int = Field(0, ge=0, le=20, description="people who walk back and forth in the corridor")
    floor_slope_deg: float = Field(0.0, ge=0, le=2, description="slope of the whole floor, degrees")
    ramp_rise_m: float = Field(0.0, ge=0, le=1, description="rise of a ramp halfway along the corridor, metres")
    door_sills_m: float = Field(0.0, ge=0, le=0.03, description="height of the sills in doorways, metres")
    step_m: float = Field(0.0, ge=0, le=0.3, description="height of a podium in one room, metres")

    drawn: Ranges = Field(Ranges(), description="what dwelling, workplace and institution are drawn from (see Ranges)")
    intensity_half_m: float | None = Field(
        None, gt=0, description="distance at which the intensity of a surface halves (m); calibrated for range if not given"
    )

    intensity_noise: float = Field(0.05, ge=0, le=1, description="scatter of an intensity, as a share of it")
    ring_gain: float = Field(0.05, ge=0, le=0.3, description="how unlike the emitters count intensities, sigma as a share")

    mount_tilt_deg: float = Field(0.0, ge=-15, le=15, description="how far the vertical spin axis points down, degrees")
    noise_m: float | None = Field(None, ge=0, le=0.1, description="range noise, sigma (m); the sensor's if not given")
    ring_bias_m: float = Field(0.003, ge=0, le=0.05, description="range offset of each emitter, sigma in metres")
    mixed_share: float = Field(
        0.2, ge=0, le=1, description="share of firings at an edge that measure between both surfaces"
    )
    dropout: float = Field(0.002, ge=0, le=0.5, description="share of firings lost for no reason")
    min_range_m: float = Field(0.6, ge=0.1, le=2, description="nearest return, metres")
