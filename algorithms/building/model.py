"""The immobile building: faces of walls, doors, windows; lengths that tell what is of a face."""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import stretches as stretches
from ffmap.algorithms.base.settings import StepSettings

CELL_M = 0.05
"""Edge of the cells that a wall face is told apart by."""
AT_FACE_M = 0.06
"""A return closer to a face may be its own, displaced by noise along the ray and by the pose's
error."""
ON_FACE_M = 0.03
"""A return farther behind the face is within the opening: on a reveal, on the lintel's underside,
or beyond."""


class BuildingSettings(StepSettings):
    """Fusing scans' planes into faces, counting rays against these, and how large doors are."""

    angle_deg: float = Field(
        8.0, gt=0, le=45, description="Planes of one wall differ by at most this many degrees."
    )
    distance_m: float = Field(
        0.10, gt=0, description="Planes of one wall lie at most this many metres apart."
    )
    own_plane_m: float = Field(
        0.03, ge=0, description="Maximum distance (m) from a face of a scan's own plane of it."
    )
    own_plane_margin_m: float = Field(
        0.2,
        ge=0,
        description="A scan's own plane of a wall holds this far (m) beyond what it saw.",
    )
    gap_m: float = Field(
        0.6,
        ge=0,
        description="Longest gap (m) between a wall's planes, or between its returns.",
    )
    scans_min: int = Field(
        3, ge=1, description="Fewest scans that make a wall, and that bear out each part of it."
    )
    length_min_m: float = Field(0.25, ge=0, description="Shortest wall face in metres.")
    range_m: float = Field(
        25.0, gt=0, description="Rays from farther (m) tell nothing of walls, seen through doors."
    )
    recess_min_m: float = Field(
        0.015,
        gt=0,
        description="Least depth (m) of a closed leaf behind its wall, by DIN 18101.",
    )
    door_width_min_m: float = Field(0.6, gt=0, description="Narrowest door in metres.")
    door_width_max_m: float = Field(2.6, gt=0, description="Widest door in metres, of two leaves.")
    door_height_min_m: float = Field(1.9, gt=0, description="Lowest door head in metres.")
    door_height_max_m: float = Field(2.65, gt=0, description="Highest door head in metres.")
    knee_m: float = Field(
        0.7,
        gt=0,
        description="Height above the floor (m) up to which rays that pass a wall prove a doorway: "
        "a window's sill is higher.",
    )
    robot_m: float = Field(
        0.1, ge=0, description="Half the width (m) of the narrowest robot: no wall is nearer."
    )
    reveal_m: float = Field(
        0.3,
        ge=0,
        description="Depth (m) of a door's reveals where nothing in the building tells.",
    )
    opaque_min: float = Field(
        0.9,
        ge=0,
        le=1,
        description="Share of a closed leaf's rays that end on it; a pane lets more pass.",
    )
    confidence_min: float = Field(
        0.2, ge=0, le=1, description="What is less sure than this to be a door is none."
    )
    rays_min: int = Field(
        6, ge=1, description="Fewest rays that decide on a column of a wall, 5 cm wide."
    )


@dataclass(frozen=True)
class Rows:
    """Things of one kind: each field is an array with a row for each of them."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def select(self, chosen: IntArray | BoolArray | slice) -> Self:
        """Some of them, by index, by flag or in a row."""
        return replace(
            self, **{field.name: getattr(self, field.name)[chosen] for field in fields(self)}
        )

    __getitem__ = select

    def one(self, k: int | np.intp) -> Self:
        """The k-th alone."""
        return self.select(np.array([k]))

    def append(self, more: Self) -> Self:
        """These and more."""
        pairs = {f.name: (getattr(self, f.name), getattr(more, f.name)) for f in fields(self)}
        rows = {
            name: own.append(other) if isinstance(own, Rows) else np.concatenate([own, other])
            for name, (own, other) in pairs.items()
        }
        return replace(self, **rows)


@dataclass(frozen=True)
class Support(Rows):
    """Evidence for parts of parsed faces. NaN, -1 or 0 where it is unknown.

    kind, second: (n,) what it is, and the next best kind, see `parse.Kind`.
    odds: (n,) log odds (nats) between them; of a wall, the sum over it and its windows.
    face, first, after: (n,) of walls and refused faces: the number of the parsed face, the first
        column and the one after the last.
    on, behind: (n,) rays that ended on the face or in its recess, and farther behind.
    seen: (n,) share of its cells that rays crossed.
    sheet_m, sheet_share, sheet_patches: (n,) depth of the sheet in an opening, share of its rays
        that ended there, and share of its 20 cm patches that returned any.
    contrast: (n,) step of intensity between a flush leaf and its wall, as a share of the wall's.
    """

    kind: IntArray
    second: IntArray
    odds: FloatArray
    face: IntArray
    first: IntArray
    after: IntArray
    on: FloatArray
    behind: FloatArray
    seen: FloatArray
    sheet_m: FloatArray
    sheet_share: FloatArray
    sheet_patches: FloatArray
    contrast: FloatArray

    @property
    def runs(self) -> list[tuple[int, int, int]]:
        """Faces and columns of those that are known."""
        rows = np.column_stack([self.face, self.first, self.after])[self.face >= 0]
        return [(w, first, after) for w, first, after in rows.tolist()]


def unknown_support(count: int) -> Support:
    """Return the support of parts of faces that were not parsed."""
    unknown, none, no_rays = np.full(count, np.nan), np.full(count, -1), np.zeros(count)
    rays = no_rays, no_rays, unknown
    return Support(none, none, unknown, none, none, none, *rays, *(unknown,) * 4)


@dataclass(frozen=True)
class Walls(Rows):
    """Wall faces in the map: straight, upright, each seen from the side that its normal points to.

    ends: (W, 2, 2) x and y, metres.
    normal: (W, 2) unit vectors towards the room.
    bottom_m, top_m: (W,) heights above the floor between which it was seen.
    scan_count: (W,) scans that saw a plane of it; 0 for one that only the returns of all scans
        together show.
    rms_m: (W,) spread about it of the planes' samples, or of the returns.
    sample_count: (W,) how many of these it rests on.
    support: (W,) of its parse.
    """

    ends: FloatArray
    normal: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray
    scan_count: IntArray
    rms_m: FloatArray
    sample_count: IntArray
    support: Support


NO_WALLS = Walls(
    ends=np.zeros((0, 2, 2)),
    normal=np.zeros((0, 2)),
    bottom_m=np.zeros(0),
    top_m=np.zeros(0),
    scan_count=np.zeros(0, np.int32),
    rms_m=np.zeros(0),
    sample_count=np.zeros(0, np.int64),
    support=unknown_support(0),
)


@dataclass(frozen=True)
class Windows(Rows):
    """Stretches of wall that rays pass through glass: what lies behind is seen through it.

    ends: (N, 2, 2) x and y, on the wall's face. normal: (N, 2) towards the room.
    bottom_m, top_m: (N,) heights between which most rays pass.
    pane_m: (N,) how far the pane stands behind the face; NaN where it returned nothing, or hangs
        before it.
    support: (N,) of its parse.
    """

    ends: FloatArray
    normal: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray
    pane_m: FloatArray
    support: Support


NO_WINDOWS = Windows(
    np.zeros((0, 2, 2)),
    np.zeros((0, 2)),
    np.zeros(0),
    np.zeros(0),
    np.zeros(0),
    unknown_support(0),
)


@dataclass(frozen=True)
class Blinds(Rows):
    """What hangs in windows and closes their upper part.

    ends: (B, 2, 2) x and y, on the wall's face. normal: (B, 2) towards the room.
    bottom_m, top_m: (B,) heights above the floor between which it hangs.
    behind_m: (B,) how far behind the wall beside its window; 0 where it is flush with that, or
        stands out.
    """

    ends: FloatArray
    normal: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray
    behind_m: FloatArray


@dataclass(frozen=True)
class Doors(Rows):
    """Doors in the map.

    ends: (D, 2, 2) x and y of the two jambs, along the sill.
    normal: (D, 2) of the wall face in which it was seen best.
    head_m: (D,) height of the lintel's underside above the floor.
    depth_m: (D,) depth of the leaf behind the wall's face, negative of one that hangs before it;
        NaN for open doors.
    state: (D,) uint8, see `algorithms.scan.doors.DoorState`.
    agreement: (D,) share of the rays between foot and head that say the same: that it is open, or
        closed.
    coverage: (D,) share of its columns that are decided so by themselves, or that an open door's
        leaf covers.
    lintel: (D,) share of its columns above which its wall was seen; a duct may hide that.
    ajar: (D,) whether it is open because its leaf, which rays end on, stands aslant.
    ray_count: (D,) rays that decided.
    scan_count, first_scan, last_scan: (D,) the scans whose rays met it or passed it close by; -1
        where none is known.
    crossed: (D,) whether the robot drove through.
    wall: (D,) the wall face in which it was seen best.
    reveal_m: (D,) how far its reveals and the underside of its lintel reach behind the wall's face;
        NaN where unknown.
    glazed: (D,) whether its leaf is a pane.
    support: (D,) of its parse.
    """

    ends: FloatArray
    normal: FloatArray
    head_m: FloatArray
    depth_m: FloatArray
    state: UInt8Array
    agreement: FloatArray
    coverage: FloatArray
    lintel: FloatArray
    ajar: BoolArray
    ray_count: IntArray
    scan_count: IntArray
    first_scan: IntArray
    last_scan: IntArray
    crossed: BoolArray
    wall: IntArray
    reveal_m: FloatArray
    glazed: BoolArray
    support: Support

    @property
    def confidence(self) -> FloatArray:
        """(D,) 0 to 1: `agreement` times `coverage`; 1 where it was crossed."""
        return np.where(self.crossed, 1.0, self.agreement * self.coverage)


NO_DOORS = Doors(
    ends=np.zeros((0, 2, 2)),
    normal=np.zeros((0, 2)),
    head_m=np.zeros(0),
    depth_m=np.zeros(0),
    state=np.zeros(0, np.uint8),
    agreement=np.zeros(0),
    coverage=np.zeros(0),
    lintel=np.zeros(0),
    ajar=np.zeros(0, bool),
    ray_count=np.zeros(0, np.int32),
    scan_count=np.zeros(0, np.int32),
    first_scan=np.zeros(0, np.int64),
    last_scan=np.zeros(0, np.int64),
    crossed=np.zeros(0, bool),
    wall=np.zeros(0, np.int32),
    reveal_m=np.zeros(0),
    glazed=np.zeros(0, bool),
    support=unknown_support(0),
)

_NOT_TOLD = {
    "depth_m": np.nan,
    "lintel": 1.0,
    "ajar": False,
    "scan_count": 0,
    "first_scan": -1,
    "last_scan": -1,
    "crossed": False,
    "reveal_m": np.nan,
    "glazed": False,
}


def one_door(support: Support | None = None, **told: ArrayLike) -> Doors:
    """A single door by what is told of it, named as in `Doors`; without what is unknown."""
    rows = {
        name: np.array([value], getattr(NO_DOORS, name).dtype)
        for name, value in (_NOT_TOLD | told).items()
    }
    return Doors(**rows, support=support or unknown_support(1))


def cells_in(distance_m: float) -> int:
    """How many cells a distance is, to the nearest whole one."""
    return round(distance_m / CELL_M)
