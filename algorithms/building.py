"""From the features of all scans to the building: fused wall faces, and doors by tracing rays through them.

The paper puts its labelled scans together and leaves it at that (Fig. 8); Nikoohemat et al. (2018) tell a wall's cells
apart as filled, empty and occluded by the rays that passed them, which is what finds the openings here.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numba
import numpy as np
from pydantic import Field

from algorithms.doors import DoorState
from algorithms.features import Features
from algorithms.labels import Label
from algorithms.scan import BoolArray, FloatArray, IntArray, UInt8Array
from algorithms.settings import StepSettings
from algorithms.wall_planes import fit_upright_plane

CELL_M = 0.05
"""Edge of the cells that a wall face is told apart by."""

AT_FACE_M = 0.06
"""A return so close to a face may be its own, displaced by noise along the ray and by the pose's error."""

_FILLED, _SUM, _SQUARES, _THROUGH = range(4)
_FLOOR, _CEILING = int(Label.FLOOR), int(Label.CEILING)

_OWN_MARGIN_M = 0.2
"""A scan's own plane of a wall holds so many metres beyond what the scan saw of it."""
_FOOT_M = 0.15
"""Below it lie sills, and the floor's own returns."""
_KNEE_M = 0.5
"""A window's sill is higher."""
_WINDOW_MIN_M = 0.3
_SILL_COLUMNS = 4
_JAMB_COLUMNS = 2

_SHEET_M = 0.02
"""A pane's returns lie so close to its sheet."""
_BESIDE_COLUMNS = 8
_JAMB_WALL_COLUMNS = 2
"""Of so many columns beside a door at least so many show its wall, on one side of it."""
_HIDDEN_JAMBS = 0.5
"""Where fewer of them are seen, nothing is known of an open doorway's jambs."""
_NEXT_WALL_M, _LEADS_M = 0.2, 0.9
_PARALLEL_DEG, _HIDDEN_SHARE = 5.0, 0.8
"""Another wall that faces the same way, so close behind an opening and all of it, leaves no room that it could lead to."""

_REVEAL_MIN_M = 0.03
_LEAF_COLUMNS = 30
"""A leaf that is ajar, or the closed one of two, covers at most so many columns beside the open ones."""
_EMPTY_COLUMNS, _EMPTY_SHARE = 20, 0.2
"""So far a window goes on where so small a share returns of what returns below it."""
_REVEAL_COLUMNS = 3
"""A reveal that is seen at a slant hides so many columns of an opening at most."""
_FRAME_BIN_M = 0.01
_FRAME_REACH_M = 0.2
_FRAME_BINS = 41
_HEAD_MIN_M = 1.7
_HEAD_BINS = 100
_HEAD_SLACK_M = 0.05
_ON_FACE_M = 0.03
"""A return farther behind the face is within the opening: on a reveal, on the lintel's underside, or beyond."""
_BEYOND_M = 0.1
"""Of an open door's rays it does not matter how much farther behind the face they ended."""
_FRAME_RAYS = 30
"""Fewest rays on the face, and behind it, that move a jamb or a head."""
_REVEAL_BIN_M = 0.01
_REVEAL_MAX_M = 0.7
_UNDERSIDE_PARTS = 8
"""A lintel's underside shows over most of so many parts of the door's width; the edge of a leaf that is ajar does not."""


class BuildingSettings(StepSettings):
    """Fusing scans into walls and doors."""

    angle_deg: float = Field(8.0, gt=0, le=45, description="Planes of one wall differ by at most so many degrees.")
    distance_m: float = Field(0.10, gt=0, description="Planes of one wall lie at most so many metres apart.")
    gap_m: float = Field(0.6, ge=0, description="A wall has no gap longer than so many metres between its planes.")
    scans_min: int = Field(3, ge=1, description="Fewest scans that make a wall, and that bear out each part of it.")
    length_min_m: float = Field(0.25, ge=0, description="Shortest wall face in metres.")
    near_m: float = Field(
        0.35,
        gt=0,
        description="A return at most so many metres behind a wall's face is a leaf; deeper, it went through.",
    )
    range_m: float = Field(
        12.0, gt=0, description="Rays from farther away than so many metres tell nothing of doors and windows."
    )
    far_m: float = Field(
        25.0,
        gt=0,
        description="Rays from farther away than so many metres tell nothing of walls either, which show through doors.",
    )
    recess_min_m: float = Field(
        0.016,
        gt=0,
        description="Least depth in metres of a closed leaf behind the wall: III.C's 2 cm, less what poses are off.",
    )
    door_width_min_m: float = Field(0.6, gt=0, description="Narrowest door in metres.")
    door_width_max_m: float = Field(2.6, gt=0, description="Widest door in metres.")
    door_height_min_m: float = Field(1.8, gt=0, description="Lowest door head in metres. III.C, condition 3.")
    door_height_max_m: float = Field(2.4, gt=0, description="Above so many metres the wall over a door is looked for.")
    reveal_m: float = Field(
        0.3,
        ge=0,
        description="A door's reveals reach so many metres behind the wall's face where its lintel does not tell.",
    )
    pane_share_min: float = Field(
        0.005, gt=0, le=1, description="An opening that returns this share of its rays from one sheet holds a pane."
    )
    pane_spread_m: float = Field(0.03, gt=0, description="Largest spread in metres of what a pane returns.")
    agreement_min: float = Field(
        0.6, ge=0, le=1, description="Share of a column's rays that must agree on its being a door's."
    )
    opaque_min: float = Field(
        0.9, ge=0, le=1, description="Share of a closed leaf's rays that end on it; a pane lets more of them through."
    )
    confidence_min: float = Field(0.2, ge=0, le=1, description="What is less sure than this to be a door is none.")
    rays_min: int = Field(6, ge=1, description="Fewest rays that decide on a column of a wall, 5 cm wide.")


@dataclass(frozen=True)
class Walls:
    """Wall faces in the map: straight, upright, each seen from the side that its normal points to.

    ends: (W, 2, 2) x and y, metres.
    normal: (W, 2) unit vectors towards the room.
    bottom_m, top_m: (W,) heights that were seen.
    scan_count: (W,) scans that saw it.
    rms_m: (W,) spread of the scans' samples about it.
    """

    ends: FloatArray
    normal: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray
    scan_count: IntArray
    rms_m: FloatArray

    def __len__(self) -> int:
        return len(self.ends)

    def select(self, chosen: IntArray | BoolArray) -> "Walls":
        """Some of the faces, by index or by flag."""
        return Walls(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def append(self, more: "Walls") -> "Walls":
        """These faces and more."""
        return Walls(*(np.concatenate([getattr(w, field.name) for w in (self, more)]) for field in fields(self)))


NO_WALLS = Walls(np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, np.int32), np.zeros(0))


@dataclass(frozen=True)
class WallCells:
    """What the rays found in each cell of each wall face: columns along it, rows from the floor up, 5 cm each.

    first: (W + 1,) the column at which each wall begins. rows: how many.
    counts: (columns, rows, 4) float32: returns near the face, the sum and the sum of squares of their distances before
    it (metres, negative behind), rays that went through.
    """

    first: IntArray
    rows: int
    counts: FloatArray


@dataclass(frozen=True)
class Windows:
    """Stretches of wall that rays pass through glass: what lies behind is seen through it.

    ends: (N, 2, 2) x and y, on the wall's face. normal: (N, 2) towards the room.
    bottom_m, top_m: (N,) heights between which most rays pass.
    pane_m: (N,) how far the pane stands behind the face; NaN where it returned nothing.
    """

    ends: FloatArray
    normal: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray
    pane_m: FloatArray

    def __len__(self) -> int:
        return len(self.ends)


NO_WINDOWS = Windows(np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class Doors:
    """Doors in the map.

    ends: (D, 2, 2) x and y of the two jambs, along the sill.
    normal: (D, 2) of the wall face in which it was seen best.
    head_m: (D,) height of the lintel's underside above the floor.
    depth_m: (D,) depth of the leaf behind the wall's face; NaN for open doors.
    state: (D,) uint8, see `algorithms.doors.DoorState`.
    confidence: (D,) 0 to 1: `agreement` times `coverage`; 1 where it was crossed.
    agreement: (D,) share of the rays between foot and head that say the same: that it is open, or closed.
    coverage: (D,) share of its columns that are decided so by themselves.
    ray_count: (D,) rays that decided.
    scan_count, first_scan, last_scan: (D,) the scans whose rays met it or passed it close by; -1 where none is known.
    crossed: (D,) whether the robot drove through.
    wall: (D,) the wall face in which it was seen best.
    reveal_m: (D,) how far its reveals and the underside of its lintel reach behind the wall's face.
    """

    ends: FloatArray
    normal: FloatArray
    head_m: FloatArray
    depth_m: FloatArray
    state: UInt8Array
    confidence: FloatArray
    agreement: FloatArray
    coverage: FloatArray
    ray_count: IntArray
    scan_count: IntArray
    first_scan: IntArray
    last_scan: IntArray
    crossed: BoolArray
    wall: IntArray
    reveal_m: FloatArray

    def __len__(self) -> int:
        return len(self.ends)

    def select(self, chosen: IntArray | BoolArray) -> "Doors":
        """Some of the doors, by index or by flag."""
        return Doors(*(getattr(self, field.name)[chosen] for field in fields(self)))


NO_DOORS = Doors(
    ends=np.zeros((0, 2, 2)),
    normal=np.zeros((0, 2)),
    head_m=np.zeros(0),
    depth_m=np.zeros(0),
    state=np.zeros(0, np.uint8),
    confidence=np.zeros(0),
    agreement=np.zeros(0),
    coverage=np.zeros(0),
    ray_count=np.zeros(0, np.int32),
    scan_count=np.zeros(0, np.int32),
    first_scan=np.zeros(0, np.int64),
    last_scan=np.zeros(0, np.int64),
    crossed=np.zeros(0, bool),
    wall=np.zeros(0, np.int32),
    reveal_m=np.zeros(0),
)


def fuse_walls(features: Features, settings: BuildingSettings) -> Walls:
    """Wall faces from the wall planes of all scans.

    The planes join largest first, each the wall face of the same side that it fits; moments add up, so that a wall's
    place is the least-squares one over all its scans. A part that fewer than `scans_min` scans bear out is dropped,
    and a wall with a long gap becomes two.

    features: the planes of all scans; their rays are not looked at.
    """
    scan = np.repeat(np.arange(len(features.scan)), features.plane_count.astype(np.int64))
    length_m = np.linalg.norm(features.plane_ends_map[:, 1] - features.plane_ends_map[:, 0], axis=1)
    largest_first = np.argsort(-length_m * features.plane_lines, kind="stable")
    wall = _join(
        np.ascontiguousarray(features.plane_moments, np.float64),
        np.ascontiguousarray(features.plane_normal, np.float64),
        np.ascontiguousarray(features.plane_ends_map, np.float64),
        largest_first,
        float(np.cos(np.radians(settings.angle_deg))),
        settings.distance_m,
        settings.gap_m,
    )
    faces: list[tuple[FloatArray, FloatArray, float, float, int, float]] = []
    for w in range(int(wall.max(initial=-1)) + 1):
        faces.extend(_faces_of(features, np.flatnonzero(wall == w), scan, settings))
    if not faces:
        return NO_WALLS
    ends, normal, bottom, top, count, rms = zip(*faces, strict=True)
    return Walls(
        np.array(ends), np.array(normal), np.array(bottom), np.array(top), np.array(count, np.int32), np.array(rms)
    )


def _faces_of(
    features: Features, members: IntArray, scan: IntArray, settings: BuildingSettings
) -> Iterable[tuple[FloatArray, FloatArray, float, float, int, float]]:
    """The borne-out stretches of one fused wall: ends, normal, bottom, top, scans, RMS."""
    nx, ny, offset, rms, _ = fit_upright_plane(features.plane_moments[members].sum(axis=0))
    normal = np.array([nx, ny])
    if np.sum(features.plane_normal[members] @ normal) < 0:
        normal, offset = -normal, -offset
    along = np.array([-normal[1], normal[0]])
    place = np.sort(features.plane_ends_map[members] @ along, axis=1)
    low = place.min()
    bins = np.floor((place - low) / CELL_M).astype(np.int64)
    cover = np.zeros(bins.max() + 2)
    np.add.at(cover, bins[:, 0], 1)
    np.add.at(cover, bins[:, 1] + 1, -1)
    borne_out = np.cumsum(cover)[:-1] >= settings.scans_min
    for first, last in stretches(borne_out, int(settings.gap_m / CELL_M)):
        start, stop = low + first * CELL_M, low + (last + 1) * CELL_M
        if stop - start < settings.length_min_m:
            continue
        inside = members[(place[:, 1] > start) & (place[:, 0] < stop)]
        ends = np.stack([normal * offset + along * start, normal * offset + along * stop])
        yield (
            ends,
            normal,
            float(np.percentile(features.plane_bottom_m[inside], 10)),
            float(np.percentile(features.plane_top_m[inside], 90)),
            len(np.unique(scan[inside])),
            rms,
        )


def stretches(flags: BoolArray, bridge: int) -> list[tuple[int, int]]:
    """First and last index, inclusive, of the runs of True; gaps of at most `bridge` are bridged."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    runs: list[tuple[int, int]] = []
    for first, after in edges.reshape(-1, 2):
        if runs and first - runs[-1][1] - 1 <= bridge:
            runs[-1] = (runs[-1][0], int(after) - 1)
        else:
            runs.append((int(first), int(after) - 1))
    return runs


def trace_rays(walls: Walls, blocks: Iterable[Features], settings: BuildingSettings) -> WallCells:
    """Every ray against every wall face that looks towards its origin: what it hit there, or that it went through.

    Where the scan itself has a plane of that wall, its rays are measured against its own plane: a leaf lies centimetres
    behind its wall, and so much may the pose be off.

    blocks: features in any portions; the memory needed is the building's, not the recording's.
    """
    length_m = np.linalg.norm(walls.ends[:, 1] - walls.ends[:, 0], axis=1) if len(walls) else np.zeros(0)
    first = np.concatenate([[0], np.cumsum(np.ceil(length_m / CELL_M))]).astype(np.int64)
    rows = int(np.ceil((float(walls.top_m.max(initial=2.0)) + 0.5) / CELL_M))
    counts = np.zeros((int(first[-1]), rows, 4), np.float32)
    for block in blocks:
        _trace(
            walls.ends,
            walls.normal,
            first,
            counts,
            np.ascontiguousarray(block.origin_map, np.float64),
            np.ascontiguousarray(block.floor_map, np.float64),
            block.ray_starts,
            np.ascontiguousarray(block.ray_end_map, np.float32),
            block.ray_label,
            block.plane_starts,
            np.ascontiguousarray(block.plane_ends_map, np.float64),
            np.ascontiguousarray(block.plane_normal, np.float64),
            settings.near_m,
            settings.range_m,
            2.0 * settings.distance_m,
            float(np.cos(np.radians(settings.angle_deg))),
        )
    return WallCells(first, rows, counts)


def find_doors(walls: Walls, cells: WallCells, settings: BuildingSettings, windows: Windows = NO_WINDOWS) -> Doors:
    """Doors: columns with wall above and, below, either nothing for the rays to hit or a recessed leaf.

    Columns next to each other that agree make a door, if it is as wide as doors are. What was seen in both faces of a
    wall, or in two stretches of it, is one door: the better seen one stands.

    cells: without the rays through the windows, for what is seen through glass tells nothing of this building's doors.
    """
    found: list[_Door] = []
    for w in range(len(walls)):
        for door in _doors_in(w, walls, cells, settings):
            if _leads_somewhere(door, walls) and not _is_glazed(door, windows):
                found.append(door)
    # Where a face ends within an opening, the other face may show all of it.
    found.sort(key=lambda door: (door.is_cut, -door.agreement * door.coverage * door.ray_count))
    kept: list[_Door] = []
    for door in found:
        middle = door.ends.mean(axis=0)
        if all(
            np.linalg.norm(middle - other.ends.mean(axis=0)) > 0.6 or abs(door.normal @ other.normal) < 0.8
            for other in kept
        ):
            kept.append(door)
    if not kept:
        return NO_DOORS
    agreement, coverage = np.array([d.agreement for d in kept]), np.array([d.coverage for d in kept])
    return Doors(
        ends=np.array([d.ends for d in kept]),
        normal=np.array([d.normal for d in kept]),
        head_m=np.array([d.head_m for d in kept]),
        depth_m=np.array([d.depth_m for d in kept]),
        state=np.array([d.state for d in kept], np.uint8),
        confidence=agreement * coverage,
        agreement=agreement,
        coverage=coverage,
        ray_count=np.array([d.ray_count for d in kept], np.int32),
        scan_count=np.zeros(len(kept), np.int32),
        first_scan=np.full(len(kept), -1, np.int64),
        last_scan=np.full(len(kept), -1, np.int64),
        crossed=np.zeros(len(kept), bool),
        wall=np.array([d.wall for d in kept], np.int32),
        reveal_m=np.full(len(kept), settings.reveal_m),
    )


def _leads_somewhere(door: "_Door", walls: Walls) -> bool:
    """Whether an opening has room behind it: below a duct, and beside a cupboard under it, the next wall is close.

    What hides a part of it, or stands aslant, may be its own leaf ajar, or what the room behind it is furnished with.
    """
    if door.state == DoorState.CLOSED:
        return True
    for ends, normal in zip(walls.ends, walls.normal, strict=True):
        length_m = float(np.linalg.norm(ends[1] - ends[0]))
        place_m = np.sort((door.ends - ends[0]) @ (ends[1] - ends[0]) / length_m)
        hidden = (min(place_m[1], length_m) - max(place_m[0], 0.0)) / (place_m[1] - place_m[0])
        before_m = float((door.ends.mean(axis=0) - ends[0]) @ normal)
        parallel = door.normal @ normal > np.cos(np.radians(_PARALLEL_DEG))
        if parallel and hidden > _HIDDEN_SHARE and _NEXT_WALL_M < before_m < _LEADS_M:
            return False
    return True


def _is_glazed(door: "_Door", windows: Windows) -> bool:
    """Whether most of an opening is a window's, of whichever of its wall's faces."""
    width_m = float(np.linalg.norm(door.ends[1] - door.ends[0]))
    along = (door.ends[1] - door.ends[0]) / width_m
    for ends, normal in zip(windows.ends, windows.normal, strict=True):
        low, high = np.sort((ends - door.ends[0]) @ along)
        near = np.abs((ends - door.ends[0]) @ door.normal).max() < _FRAME_REACH_M
        if near and abs(door.normal @ normal) > 0.8 and min(high, width_m) - max(low, 0.0) > 0.5 * width_m:
            return True
    return False


@dataclass(frozen=True)
class _Door:
    """One of `Doors`, as one face shows it."""

    ends: FloatArray
    normal: FloatArray
    head_m: float
    depth_m: float
    state: DoorState
    agreement: float
    coverage: float
    ray_count: int
    wall: int
    is_cut: bool
    """Whether it reaches the end of its face: that may not be its jamb."""


def prove_crossed(doors: Doors, path_map: FloatArray) -> Doors:
    """The doors, of which those that the robot drove through are open beyond doubt, whatever rays said of them.

    path_map: (n, 2) the robot's places in their order.
    """
    crossed = np.zeros(len(doors), bool)
    for d in range(len(doors)):
        along = doors.ends[d, 1] - doors.ends[d, 0]
        length_m = float(np.linalg.norm(along))
        side = (path_map - doors.ends[d, 0]) @ doors.normal[d]
        place = (path_map - doors.ends[d, 0]) @ (along / length_m)
        change = np.flatnonzero(np.diff(side > 0))
        t = side[change] / (side[change] - side[change + 1])
        at = place[change] + t * (place[change + 1] - place[change])
        crossed[d] = bool(np.any((at > 0) & (at < length_m)))
    return replace(
        doors,
        crossed=crossed,
        state=np.where(crossed, np.uint8(DoorState.OPEN), doors.state),
        depth_m=np.where(crossed, np.nan, doors.depth_m),
        confidence=np.where(crossed, 1.0, doors.confidence),
    )


def place_frames(doors: Doors, walls: Walls, blocks: Iterable[Features], settings: BuildingSettings) -> Doors:
    """The doors with jambs and head where the rays tell them to a centimetre, and with the scans that saw these.

    Beyond a jamb or the head rays end on the wall's face, within they pass it or end on the leaf behind, or on the reveal or
    the lintel's underside. Each edge goes where rays contradict it least; one without rays on both sides stays.

    walls: those that `doors.wall` counts.
    """
    jamb_cost_m, jamb_rays = np.zeros((len(doors), 2, _FRAME_BINS)), np.zeros((len(doors), 2, 2), np.int64)
    head_cost_m, head_rays = np.zeros((len(doors), _HEAD_BINS)), np.zeros((len(doors), 2), np.int64)
    scans = np.zeros((len(doors), 3), np.int64)
    scans[:, 1:] = -1
    depth_m = np.where(np.isfinite(doors.depth_m), np.minimum(doors.depth_m, _BEYOND_M), _BEYOND_M)
    for block in blocks:
        _compare_with_frames(
            np.ascontiguousarray(doors.ends, np.float64),
            np.ascontiguousarray(doors.head_m, np.float64),
            depth_m,
            np.ascontiguousarray(walls.ends[doors.wall], np.float64),
            np.ascontiguousarray(walls.normal[doors.wall], np.float64),
            jamb_cost_m,
            jamb_rays,
            head_cost_m,
            head_rays,
            scans,
            np.ascontiguousarray(block.scan, np.int64),
            np.ascontiguousarray(block.origin_map, np.float64),
            np.ascontiguousarray(block.floor_map, np.float64),
            block.ray_starts,
            block.ray_end_map,
            block.plane_starts,
            np.ascontiguousarray(block.plane_ends_map, np.float64),
            np.ascontiguousarray(block.plane_normal, np.float64),
            2.0 * settings.distance_m,
            float(np.cos(np.radians(settings.angle_deg))),
        )
    ends, head_m = doors.ends.copy(), doors.head_m.copy()
    for d in range(len(doors)):
        along = (doors.ends[d, 1] - doors.ends[d, 0]) / np.linalg.norm(doors.ends[d, 1] - doors.ends[d, 0])
        for side, outwards in ((0, -1.0), (1, 1.0)):
            edge_m = _edge_m(jamb_cost_m[d, side], jamb_rays[d, side])
            if edge_m is not None:
                ends[d, side] += outwards * along * (edge_m - _FRAME_REACH_M)
        edge_m = _edge_m(head_cost_m[d], head_rays[d])
        head_m[d] = doors.head_m[d] if edge_m is None else _HEAD_MIN_M + edge_m
    count, first, last = scans.T
    return replace(doors, ends=ends, head_m=head_m, scan_count=count.astype(np.int32), first_scan=first, last_scan=last)


def drop_doubtful(doors: Doors, settings: BuildingSettings) -> Doors:
    """The doors without what is too narrow for one or too unsure, and without "closed" ones that are rather a wall or a pane.

    A leaf's recess of centimetres shows from nearby only: at least `scans_min` scans have to have seen it so. A leaf is
    set back by a step, as high as doors are; a wall that the poses' tilt leans back comes forward little by little, and
    its "head" is far too low or high. And no ray passes a leaf.

    doors: from `place_frames`.
    """
    width_m = np.linalg.norm(doors.ends[:, 1] - doors.ends[:, 0], axis=1)
    narrow = width_m < settings.door_width_min_m - CELL_M
    lowest_m, highest_m = settings.door_height_min_m - _HEAD_SLACK_M, settings.door_height_max_m + _HEAD_SLACK_M
    doubtful = (
        (doors.scan_count < settings.scans_min)
        | (doors.head_m < lowest_m)
        | (doors.head_m > highest_m)
        | (doors.agreement < settings.opaque_min)
    )
    unsure = narrow | (doors.confidence < settings.confidence_min)
    return doors.select(~unsure & ~(doubtful & (doors.state == DoorState.CLOSED)))


def _edge_m(cost_m: FloatArray, rays: IntArray) -> float | None:
    """How far from the first bin an opening's edge lies, where rays contradict it least; None where too few tell.

    cost_m: (bins,) by how much rays end off where they would with the edge there, from within the opening outwards, 1 cm each.
    rays: (2,) how many of them ended on the face, and behind it.
    """
    if rays.min() < _FRAME_RAYS:
        return None
    return float(np.argmin(cost_m)) * _FRAME_BIN_M


@numba.njit(cache=True, nogil=True)
def _add_costs(
    cost_m: FloatArray, first_m: float, place_m: float, outwards: float, end_m: float, depth_m: float
) -> None:  # pragma: no cover
    """Add, for an edge in each bin, by how much a ray ended off where it then should have.

    Beyond the edge a ray ends on the face; within, on the leaf or wherever, or before on the reveal or the lintel's
    underside, if it comes near enough.

    first_m: the first bin's place. place_m: where the ray meets the face; outwards: by how many metres it nears the edge for
    each behind that. end_m: how far behind the face it ended; depth_m: where it would within the opening.
    """
    for k in range(len(cost_m)):
        inside_m = first_m + k * _FRAME_BIN_M - place_m
        off_m = abs(end_m)
        if inside_m > 0.0:
            off_m = depth_m - end_m
            if outwards > 0.0:
                off_m = min(off_m, abs(end_m - inside_m / outwards))
        cost_m[k] += min(off_m, depth_m)


@numba.njit(cache=True, nogil=True)
def _compare_with_frames(
    ends: FloatArray,
    head_m: FloatArray,
    depth_m: FloatArray,
    wall_ends: FloatArray,
    wall_normal: FloatArray,
    jamb_cost_m: FloatArray,
    jamb_rays: IntArray,
    head_cost_m: FloatArray,
    head_rays: IntArray,
    scans: IntArray,
    scan: IntArray,
    origin: FloatArray,
    floor: FloatArray,
    starts: IntArray,
    ray_end: FloatArray,
    plane_starts: IntArray,
    plane_ends: FloatArray,
    plane_normal: FloatArray,
    distance_m: float,
    cos_angle: float,
) -> None:  # pragma: no cover
    for d in range(len(ends)):
        dx, dy = ends[d, 1, 0] - ends[d, 0, 0], ends[d, 1, 1] - ends[d, 0, 1]
        length = np.sqrt(dx * dx + dy * dy)
        dx, dy = dx / length, dy / length
        for s in range(len(origin)):
            ox, oy = origin[s, 0] - ends[d, 0, 0], origin[s, 1] - ends[d, 0, 1]
            reach = wall_normal[d, 0] * ox + wall_normal[d, 1] * oy
            # Seen at a slant, a leaf's recess shifts where rays pass the face.
            if reach < 0.3 or reach > 6.0 or abs(ox * dx + oy * dy - 0.5 * length) > 2.0 * reach + 0.5 * length:
                continue
            nx, ny, offset, start, stop = _own_plane(
                wall_ends[d],
                wall_normal[d],
                plane_ends,
                plane_normal,
                plane_starts[s],
                plane_starts[s + 1],
                distance_m,
                cos_angle,
            )
            middle = (
                (ends[d, 0, 0] - wall_ends[d, 0, 0]) * dx + (ends[d, 0, 1] - wall_ends[d, 0, 1]) * dy + 0.5 * length
            )
            if not start < middle < stop:
                nx, ny = wall_normal[d, 0], wall_normal[d, 1]
                offset = nx * wall_ends[d, 0, 0] + ny * wall_ends[d, 0, 1]
            offset -= nx * ends[d, 0, 0] + ny * ends[d, 0, 1]
            reach = nx * ox + ny * oy - offset
            if reach < 0.3:
                continue
            saw = False
            for r in range(starts[s], starts[s + 1]):
                x, y = ray_end[r, 0] - ends[d, 0, 0], ray_end[r, 1] - ends[d, 0, 1]
                side = nx * x + ny * y - offset
                if side > 0.06:
                    continue
                # A ray's direction is known far better than where on it it ended.
                t = reach / (reach - side)
                x, y, z = ox + t * (x - ox), oy + t * (y - oy), origin[s, 2] + t * (ray_end[r, 2] - origin[s, 2])
                u = x * dx + y * dy
                if u < -_FRAME_REACH_M or u > length + _FRAME_REACH_M:
                    continue
                height = z - (floor[s, 0] + floor[s, 1] * ray_end[r, 0] + floor[s, 2] * ray_end[r, 1])
                kind = 0 if -side < min(0.5 * depth_m[d], _ON_FACE_M) else 1
                end_m = min(max(-side, -depth_m[d]), depth_m[d])
                if 0.15 < u < length - 0.15 and _HEAD_MIN_M < height < _HEAD_MIN_M + _HEAD_BINS * _FRAME_BIN_M:
                    head_rays[d, kind] += 1
                    _add_costs(head_cost_m[d], _HEAD_MIN_M, height, (z - origin[s, 2]) / reach, end_m, depth_m[d])
                if height < 0.2 or height > head_m[d] - 0.15:
                    continue
                saw = True
                sideways = (u - (ox * dx + oy * dy)) / reach
                if u < _FRAME_REACH_M:
                    jamb_rays[d, 0, kind] += 1
                    _add_costs(jamb_cost_m[d, 0], -_FRAME_REACH_M, -u, -sideways, end_m, depth_m[d])
                if u > length - _FRAME_REACH_M:
                    jamb_rays[d, 1, kind] += 1
                    _add_costs(jamb_cost_m[d, 1], -_FRAME_REACH_M, u - length, sideways, end_m, depth_m[d])
            if saw:
                scans[d, 0] += 1
                scans[d, 1] = scan[s] if scans[d, 1] < 0 else scans[d, 1]
                scans[d, 2] = scan[s]


def measure_reveals(doors: Doors, blocks: Iterable[Features], settings: BuildingSettings) -> Doors:
    """The doors with the depth of their reveals, by the returns of the underside of each lintel.

    Nothing else hangs in a doorway at the height of its head; the leaf's edge stands beside a jamb, which is left out.
    """
    bins = int(_REVEAL_MAX_M / _REVEAL_BIN_M)
    counts = np.zeros((len(doors), bins, _UNDERSIDE_PARTS), np.int64)
    length_m = np.linalg.norm(doors.ends[:, 1] - doors.ends[:, 0], axis=1)
    for block in blocks:
        _count_undersides(
            doors.ends,
            doors.normal,
            length_m,
            doors.head_m,
            counts,
            np.ascontiguousarray(block.floor_map, np.float64),
            block.ray_starts,
            block.ray_end_map,
        )
    reveal_m = doors.reveal_m.copy()
    for d in range(len(doors)):
        # Behind the face by as far as returns follow each other without a gap, over most of the width: a leaf's upper edge
        # that is ajar is narrow. They scatter about the end, which is where half as many return as before.
        enough = np.count_nonzero(counts[d], axis=1) > 0.5 * _UNDERSIDE_PARTS
        runs = stretches(enough, 4)
        if runs and runs[0][0] * _REVEAL_BIN_M <= 0.1:
            returns = np.convolve(counts[d].sum(axis=1), np.ones(3), "same")[: runs[0][1] + 1]
            usual = np.median(returns[len(returns) // 2 :])
            reveal_m[d] = (np.flatnonzero(returns > 0.5 * usual)[-1] + 1) * _REVEAL_BIN_M
    return replace(doors, reveal_m=reveal_m)


@numba.njit(cache=True, nogil=True)
def _count_undersides(
    ends: FloatArray,
    normal: FloatArray,
    length_m: FloatArray,
    head_m: FloatArray,
    counts: IntArray,
    floor: FloatArray,
    starts: IntArray,
    ray_end: FloatArray,
) -> None:  # pragma: no cover
    bins = counts.shape[1]
    for s in range(len(floor)):
        for r in range(starts[s], starts[s + 1]):
            height = ray_end[r, 2] - (floor[s, 0] + floor[s, 1] * ray_end[r, 0] + floor[s, 2] * ray_end[r, 1])
            if height < 1.7 or height > 2.7:
                continue
            for d in range(len(ends)):
                if abs(height - head_m[d]) > 0.08:
                    continue
                x, y = ray_end[r, 0] - ends[d, 0, 0], ray_end[r, 1] - ends[d, 0, 1]
                behind = -(normal[d, 0] * x + normal[d, 1] * y)
                if behind < 0.0 or behind >= bins * _REVEAL_BIN_M:
                    continue
                u = ((ends[d, 1, 0] - ends[d, 0, 0]) * x + (ends[d, 1, 1] - ends[d, 0, 1]) * y) / length_m[d]
                inner = (u - 0.15) / (length_m[d] - 0.3)
                if 0.0 <= inner < 1.0:
                    counts[d, int(behind / _REVEAL_BIN_M), int(inner * counts.shape[2])] += 1


def seen_through(windows: Windows, features: Features) -> BoolArray:
    """(p,) whether each plane of the scans was seen through a window: it is no wall of this building."""
    scan = np.repeat(np.arange(len(features.scan)), features.plane_count.astype(np.int64))
    origin = features.origin_map[scan, :2]
    outside = np.zeros(len(scan), bool)
    for ends, normal in zip(windows.ends, windows.normal, strict=True):
        before = (origin - ends[0]) @ normal
        length_m = np.linalg.norm(ends[1] - ends[0])
        for part in (0.0, 0.5, 1.0):
            place = features.plane_ends_map[:, 0] + part * (
                features.plane_ends_map[:, 1] - features.plane_ends_map[:, 0]
            )
            behind = (place - ends[0]) @ normal
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing = origin + (before / (before - behind))[:, None] * (place - origin)
            along = (crossing - ends[0]) @ (ends[1] - ends[0]) / length_m
            outside |= (before > 0) & (behind < -CELL_M) & (along > 0) & (along < length_m)
    return outside


def without_rays_through(windows: Windows, features: Features) -> Features:
    """The same scans without the rays that ended beyond a window."""
    passed = _rays_through(
        np.ascontiguousarray(windows.ends, np.float64),
        np.ascontiguousarray(windows.normal, np.float64),
        np.ascontiguousarray(features.origin_map, np.float64),
        features.ray_starts,
        features.ray_end_map,
    )
    scan = np.repeat(np.arange(len(features.scan)), features.ray_count.astype(np.int64))
    return replace(
        features,
        ray_count=np.bincount(scan[~passed], minlength=len(features.scan)),
        ray_end_map=features.ray_end_map[~passed],
        ray_label=features.ray_label[~passed],
    )


@numba.njit(cache=True, nogil=True)
def _rays_through(
    ends: FloatArray, normal: FloatArray, origin: FloatArray, starts: IntArray, ray_end: FloatArray
) -> BoolArray:  # pragma: no cover
    passed = np.zeros(len(ray_end), np.bool_)
    for w in range(len(ends)):
        dx, dy = ends[w, 1, 0] - ends[w, 0, 0], ends[w, 1, 1] - ends[w, 0, 1]
        length = np.sqrt(dx * dx + dy * dy)
        dx, dy = dx / length, dy / length
        for s in range(len(origin)):
            ox, oy = origin[s, 0] - ends[w, 0, 0], origin[s, 1] - ends[w, 0, 1]
            reach = normal[w, 0] * ox + normal[w, 1] * oy
            if reach <= 0.0:
                continue
            for r in range(starts[s], starts[s + 1]):
                x, y = ray_end[r, 0] - ends[w, 0, 0], ray_end[r, 1] - ends[w, 0, 1]
                side = normal[w, 0] * x + normal[w, 1] * y
                if side > -0.05:
                    continue
                t = reach / (reach - side)
                u = (ox + t * (x - ox)) * dx + (oy + t * (y - oy)) * dy
                if 0.0 < u < length:
                    passed[r] = True
    return passed


def find_windows(walls: Walls, cells: WallCells, settings: BuildingSettings) -> Windows:
    """Stretches of wall that rays pass through glass: above a sill, or down to the floor where a pane shows itself."""
    found: list[tuple[FloatArray, FloatArray, float, float, float]] = []
    for w in range(len(walls)):
        counts = cells.counts[cells.first[w] : cells.first[w + 1]].astype(np.float64)
        if len(counts) < 3:
            continue
        along = _along(walls, w)
        opened = _look_for_doors(counts, walls.top_m[w], settings).is_open
        panes = [(first, last) for first, last in stretches(opened, 2) if _is_pane(counts[first : last + 1], settings)]
        may_be, is_sill = _above_sill(counts, walls.top_m[w], settings)
        sills = [
            (first, last) for first, last in stretches(may_be, 4) if is_sill[first : last + 1].sum() >= _SILL_COLUMNS
        ]
        high = counts[:, int(_KNEE_M / CELL_M) : int(settings.door_height_min_m / CELL_M)].sum(axis=1)
        for first, last in panes + sills:
            rows = counts[first : last + 1].sum(axis=0)
            clear = np.flatnonzero(rows[:, _THROUGH] > rows[:, _FILLED])
            if not len(clear):
                continue
            pane_m = _pane_m(counts[first : last + 1, clear[0] : clear[-1] + 1], settings)
            first, last = _to_jambs(high, first, last, _REVEAL_COLUMNS)
            first, last = _over_empty_columns(counts, clear[0], clear[-1] + 1, first, last)
            ends = walls.ends[w, 0] + along * CELL_M * np.array([[first], [last + 1]])
            found.append((ends, walls.normal[w], CELL_M * clear[0], CELL_M * (clear[-1] + 1), pane_m))
    if not found:
        return NO_WINDOWS
    ends_of_all, normal, bottom_m, top_m, panes_m = zip(*found, strict=True)
    return Windows(np.array(ends_of_all), np.array(normal), np.array(bottom_m), np.array(top_m), np.array(panes_m))


def _over_empty_columns(counts: FloatArray, bottom: int, top: int, first: int, last: int) -> tuple[int, int]:
    """A window's columns, with those beside it that return next to nothing between its sill and its head, but do below it.

    Glass that is met at a slant sends the rays elsewhere.

    counts: (columns, rows, 4) of the whole face; bottom, top: the window's rows.
    """
    below = counts[:, int(_FOOT_M / CELL_M) : bottom, _FILLED]
    usual = below.mean(axis=1) if below.shape[1] else np.zeros(len(counts))
    empty = counts[:, bottom:top, _FILLED].mean(axis=1) < _EMPTY_SHARE * usual
    return _widened(empty, first, last, _EMPTY_COLUMNS)


def _pane_m(counts: FloatArray, settings: BuildingSettings) -> float:
    """How far behind the face a window's pane stands, by what it returns away from reveals, sill and head."""
    columns, rows = (min(_JAMB_COLUMNS, (size - 1) // 2) for size in counts.shape[:2])
    inner = counts[columns : counts.shape[0] - columns, rows : counts.shape[1] - rows]
    sheet = _find_sheet(inner, settings)
    return sheet.behind_m if sheet is not None and sheet.behind_m > 0 else float("nan")


@dataclass(frozen=True)
class _Sheet:
    """The sheet that most returns from within an opening lie on.

    behind_m: so far behind the face. returns: how many lie on it. columns: in how many columns.
    """

    behind_m: float
    returns: int
    columns: int


def _find_sheet(counts: FloatArray, settings: BuildingSettings) -> _Sheet | None:
    """The sheet in an opening's cells (c, rows, 4): what stands behind a pane, or on its sill, adds returns of other depths.

    None where too few returns lie on one, or where they show in few of the columns that they might: the edge of a leaf or of
    a reveal does so.
    """
    filled = counts[..., _FILLED]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_m = counts[..., _SUM] / filled
        variance = counts[..., _SQUARES] / filled - mean_m**2
    flat = (filled > 0) & (variance < settings.pane_spread_m**2)
    if not flat.any():
        return None
    depth_m, weight = mean_m[flat], filled[flat]
    order = np.argsort(depth_m)
    depth_m, total = depth_m[order], np.concatenate([[0.0], np.cumsum(weight[order])])
    within = total[np.searchsorted(depth_m, depth_m + _SHEET_M, "right")]
    within -= total[np.searchsorted(depth_m, depth_m - _SHEET_M, "left")]
    on_sheet = flat & (np.abs(mean_m - depth_m[np.argmax(within)]) <= _SHEET_M)
    returns, columns = float(filled[on_sheet].sum()), int(on_sheet.any(axis=1).sum())
    if returns < settings.rays_min or columns < 0.5 * min(len(counts), returns):
        return None
    return _Sheet(-float(counts[on_sheet, _SUM].sum()) / returns, int(returns), columns)


def _above_sill(counts: FloatArray, top_m: float, settings: BuildingSettings) -> tuple[BoolArray, BoolArray]:
    """Columns (c,) that rays pass above the knee and not below it, and those of them (c,) whose foot is seen to be wall.

    What stands before a window hides its sill, and a window is as wide as it is all the same.
    """
    foot, knee, top = int(0.1 / CELL_M), int(_KNEE_M / CELL_M), int(max(top_m - 0.2, 0.0) / CELL_M)
    below = counts[:, foot:knee].sum(axis=1)
    near = _with_neighbours(np.swapaxes(_with_neighbours(counts), 0, 1)).swapaxes(0, 1)
    clear = (near[..., _THROUGH] > near[..., _FILLED]) & (near[..., _THROUGH] >= 0.5 * settings.rays_min)
    passed = clear[:, knee:top].sum(axis=1) >= _WINDOW_MIN_M / CELL_M
    may_be = passed & (below[:, _THROUGH] <= 0.1 * below[:, _FILLED])
    return may_be, may_be & (below[:, _FILLED] >= settings.rays_min)


def _is_pane(counts: FloatArray, settings: BuildingSettings) -> bool:
    """Whether an opening holds a pane: glass lets most rays through, but those that it returns come from one sheet.

    An open doorway returns nothing, and what stands in it has some depth. (Glass returns rays that meet it straight on,
    and dust does so elsewhere: Wang and Wang, "Detecting glass in simultaneous localisation and mapping", 2017.)

    counts: (c, rows, 4) of the opening's columns; those at its jambs are not looked at.
    """
    jamb = min(_JAMB_COLUMNS, (len(counts) - 1) // 2)
    inner = counts[jamb : len(counts) - jamb, int(_FOOT_M / CELL_M) : int(settings.door_height_min_m / CELL_M)]
    sheet = _find_sheet(inner, settings)
    return sheet is not None and sheet.returns >= settings.pane_share_min * float(inner[..., _THROUGH].sum())


def _is_open_to_floor(counts: FloatArray, settings: BuildingSettings) -> bool:
    """Whether rays pass an opening's columns (c, rows, 4) at its foot: what stands before a window may hide its sill."""
    foot = counts[:, int(_FOOT_M / CELL_M) : int(_KNEE_M / CELL_M)].sum(axis=(0, 1))
    return bool(
        foot[_THROUGH] >= settings.rays_min
        and foot[_THROUGH] > settings.agreement_min * (foot[_THROUGH] + foot[_FILLED])
    )


def _with_neighbours(counts: FloatArray) -> FloatArray:
    """Each column with the counts of the two beside it: an emitter's lines may stand farther apart than a column is."""
    summed = counts.copy()
    summed[1:] += counts[:-1]
    summed[:-1] += counts[1:]
    return summed


def _along(walls: Walls, w: int) -> FloatArray:
    """The unit vector (2,) along a wall."""
    along: FloatArray = walls.ends[w, 1] - walls.ends[w, 0]
    return along / np.linalg.norm(along)


@dataclass(frozen=True)
class _DoorColumns:
    """What a face's columns (c,) say of doors.

    is_open, is_closed: whether it may be an open door's, a closed one's.
    through: share of the rays below a door's head that went through. rays: (c, 4) counts of those.
    lintel_m: mean distance of the wall above before the face. depth_m: how far behind that a leaf lies.
    """

    is_open: BoolArray
    is_closed: BoolArray
    through: FloatArray
    rays: FloatArray
    lintel_m: FloatArray
    depth_m: FloatArray


def _look_for_doors(counts: FloatArray, top_m: float, settings: BuildingSettings) -> _DoorColumns:
    """Columns with wall above and, below, either nothing for the rays to hit or a recessed leaf."""
    smooth = _with_neighbours(counts)
    low, knee = int(_FOOT_M / CELL_M), int(0.6 / CELL_M)
    high, above = int(settings.door_height_min_m / CELL_M), int(settings.door_height_max_m / CELL_M)
    top = int(max(top_m - 0.1, 0) / CELL_M)
    above_head = smooth[:, min(above, max(top - 4, 0)) : top]
    # What hangs behind a lintel is seen below it, and would pull its mean back.
    with np.errstate(invalid="ignore", divide="ignore"):
        on_face = np.abs(above_head[..., _SUM] / above_head[..., _FILLED]) < AT_FACE_M
    lintel = (above_head * on_face[..., None]).sum(axis=1)
    below, foot = smooth[:, low:high].sum(axis=1), smooth[:, low:knee].sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        lintel_m = lintel[:, _SUM] / lintel[:, _FILLED]
        mean_m = below[:, _SUM] / below[:, _FILLED]
        spread_m = np.sqrt(np.maximum(below[:, _SQUARES] / below[:, _FILLED] - mean_m**2, 0))
        through = below[:, _THROUGH] / (below[:, _THROUGH] + below[:, _FILLED])
        foot_through = foot[:, _THROUGH] / (foot[:, _THROUGH] + foot[:, _FILLED])
        depth_m = lintel_m - mean_m
        foot_depth_m = lintel_m - foot[:, _SUM] / foot[:, _FILLED]
    decided = below[:, _THROUGH] + below[:, _FILLED] >= settings.rays_min
    wall_above = (lintel[:, _FILLED] >= 2) & (above_head[..., _THROUGH].sum(axis=1) <= lintel[:, _FILLED])
    is_open = decided & wall_above & (through > settings.agreement_min) & ~(foot_through < settings.agreement_min)
    is_closed = (
        decided
        & wall_above
        & (through < 1 - settings.agreement_min)
        & (depth_m > settings.recess_min_m)
        # A leaf is recessed down to the floor; below a window the wall stands flush.
        & ~(foot_depth_m < 0.5 * settings.recess_min_m)
        & (spread_m < 0.06)
    )
    return _DoorColumns(is_open, is_closed, through, below, lintel_m, depth_m)


def _doors_in(w: int, walls: Walls, cells: WallCells, settings: BuildingSettings) -> Iterable[_Door]:
    counts = cells.counts[cells.first[w] : cells.first[w + 1]].astype(np.float64)
    if len(counts) < 3:
        return
    found = _look_for_doors(counts, walls.top_m[w], settings)
    low, high = int(_FOOT_M / CELL_M), int(settings.door_height_min_m / CELL_M)
    along = _along(walls, w)
    for state, flags in ((DoorState.OPEN, found.is_open), (DoorState.CLOSED, found.is_closed)):
        for first, last in stretches(flags, 2):
            if state == DoorState.OPEN:
                opening = counts[first : last + 1]
                if _is_pane(opening, settings) or not _is_open_to_floor(opening, settings):
                    continue
                first, last = _to_jambs(counts[:, low:high].sum(axis=1), first, last, _LEAF_COLUMNS)
            width_m = (last + 1 - first) * CELL_M
            # Smoothing and the cells' own width blur each side by up to a column.
            if not settings.door_width_min_m <= width_m + CELL_M or width_m > settings.door_width_max_m:
                continue
            columns = slice(first, last + 1)
            lintel_m = float(np.nanmean(found.lintel_m[columns]))
            depth_m = float("nan") if state == DoorState.OPEN else float(np.nanmedian(found.depth_m[columns]))
            if not _has_jamb(counts, first, last, lintel_m, depth_m, settings):
                continue
            agree = found.through[columns] if state == DoorState.OPEN else 1 - found.through[columns]
            yield _Door(
                ends=walls.ends[w, 0] + along * CELL_M * np.array([[first], [last + 1]]),
                normal=walls.normal[w],
                head_m=_head_m(counts[columns], state, lintel_m, settings),
                depth_m=depth_m,
                state=state,
                agreement=float(np.nanmean(agree[flags[columns]])),
                coverage=float(np.mean(flags[columns])),
                ray_count=int(found.rays[columns][:, [_FILLED, _THROUGH]].sum() / 3),
                wall=w,
                is_cut=first == 0 or last == len(counts) - 1,
            )


def _has_jamb(
    counts: FloatArray, first: int, last: int, lintel_m: float, depth_m: float, settings: BuildingSettings
) -> bool:
    """Whether the wall above an opening stands beside it too, on one side at least.

    A leaf is recessed behind the wall beside it, not only behind what is above: so is a cupboard's front below a board, and
    a wall that leans. Beside an open doorway that is seen through another one, things may hide the wall.

    counts: (columns, rows, 4) of the whole face; first, last: the opening's columns. lintel_m: the wall above before the
    face. depth_m: the leaf behind that; NaN of an open door.
    """
    low, high = int(_FOOT_M / CELL_M), int(settings.door_height_min_m / CELL_M)
    below = counts[:, low:high].sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        behind_m = lintel_m - below[:, _SUM] / below[:, _FILLED]
    seen = below[:, _FILLED] + below[:, _THROUGH] >= settings.rays_min
    stands = (below[:, _FILLED] >= settings.rays_min) & (below[:, _THROUGH] < below[:, _FILLED])
    flush = stands & (np.abs(behind_m) < (0.5 * depth_m if np.isfinite(depth_m) else _ON_FACE_M))
    sides = slice(max(first - _BESIDE_COLUMNS, 0), first), slice(last + 1, last + 1 + _BESIDE_COLUMNS)
    hidden = not np.isfinite(depth_m) and np.concatenate([seen[side] for side in sides]).mean() < _HIDDEN_JAMBS
    return hidden or any(np.count_nonzero(flush[side]) >= _JAMB_WALL_COLUMNS for side in sides)


def _to_jambs(below: FloatArray, first: int, last: int, most: int) -> tuple[int, int]:
    """An open stretch of columns, widened to the jambs: beside it rays end on the reveals or on a leaf, behind the face.

    below: (columns, 4), a face's counts between the foot and the head of an opening. most: columns on each side.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        behind = below[:, _SUM] / below[:, _FILLED] < -_REVEAL_MIN_M
    return _widened(behind, first, last, most)


def _widened(flags: BoolArray, first: int, last: int, most: int) -> tuple[int, int]:
    """A stretch of columns with the flagged ones that follow on each side without a gap, so many at most."""
    for _ in range(most):
        if first > 0 and flags[first - 1]:
            first -= 1
        if last + 1 < len(flags) and flags[last + 1]:
            last += 1
    return first, last


def _head_m(counts: FloatArray, state: DoorState, lintel_m: float, settings: BuildingSettings) -> float:
    """Height below which the rows of a door are no longer wall."""
    rows = counts.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        depth_m = lintel_m - rows[:, _SUM] / rows[:, _FILLED]
        if state == DoorState.OPEN:
            # A ray that ends on the lintel's underside passes the face lower than it ends.
            wall = (rows[:, _FILLED] > rows[:, _THROUGH]) & (depth_m < _REVEAL_MIN_M)
        else:
            wall = depth_m < 0.5 * settings.recess_min_m
    start = int((settings.door_height_min_m - 0.1) / CELL_M)
    stop = min(int((settings.door_height_max_m + 0.3) / CELL_M), len(rows))
    for row in range(start, stop):
        if wall[row] and rows[row, _FILLED] > 0:
            # The head lies somewhere in the row below, which is partly wall.
            return (row - 0.5) * CELL_M
    return settings.door_height_min_m


@numba.njit(cache=True, nogil=True)
def _join(
    moments: FloatArray,
    normal: FloatArray,
    ends: FloatArray,
    order: IntArray,
    cos_angle: float,
    distance_m: float,
    gap_m: float,
) -> IntArray:  # pragma: no cover
    """The fused wall of each plane, numbered from 0."""
    count = len(order)
    wall = np.full(count, -1, np.int64)
    total = np.zeros((count, 6))
    facing = np.zeros((count, 2))
    fit = np.zeros((count, 5))  # normal x, y, offset, lowest and highest place along it
    walls = 0
    for position in range(count):
        p = order[position]
        best, nearest = -1, distance_m
        for w in range(walls):
            if facing[w, 0] * normal[p, 0] + facing[w, 1] * normal[p, 1] < cos_angle:
                continue
            nx, ny, offset = fit[w, 0], fit[w, 1], fit[w, 2]
            far = 0.0
            low, high = np.inf, -np.inf
            for e in range(2):
                far = max(far, abs(nx * ends[p, e, 0] + ny * ends[p, e, 1] - offset))
                u = -ny * ends[p, e, 0] + nx * ends[p, e, 1]
                low, high = min(low, u), max(high, u)
            if far < nearest and max(low, fit[w, 3]) - min(high, fit[w, 4]) < gap_m:
                best, nearest = w, far
        if best < 0:
            best = walls
            walls += 1
            fit[best, 3], fit[best, 4] = np.inf, -np.inf
        wall[p] = best
        total[best] += moments[p]
        old = fit[best].copy()
        nx, ny, offset, _, _ = fit_upright_plane(total[best])
        if nx * normal[p, 0] + ny * normal[p, 1] < 0:
            nx, ny, offset = -nx, -ny, -offset
        facing[best, 0], facing[best, 1] = nx, ny
        low, high = np.inf, -np.inf
        for e in range(2):
            u = -ny * ends[p, e, 0] + nx * ends[p, e, 1]
            low, high = min(low, u), max(high, u)
        if old[3] < old[4]:
            # The direction hardly moves once a wall is long: carry its old ends over to the new one.
            for u_old in (old[3], old[4]):
                x = old[0] * old[2] - old[1] * u_old
                y = old[1] * old[2] + old[0] * u_old
                u = -ny * x + nx * y
                low, high = min(low, u), max(high, u)
        fit[best, 0], fit[best, 1], fit[best, 2], fit[best, 3], fit[best, 4] = nx, ny, offset, low, high
    return wall


@numba.njit(cache=True, nogil=True)
def _own_plane(
    ends: FloatArray,
    normal: FloatArray,
    plane_ends: FloatArray,
    plane_normal: FloatArray,
    first: int,
    after: int,
    distance_m: float,
    cos_angle: float,
) -> tuple[float, float, float, float, float]:  # pragma: no cover
    """Normal x, y and offset of a scan's own plane of a wall face, the one that shares most with it, and the stretch of the
    face over which it was seen; the face's own normal and offset, and no stretch, where there is none."""
    along = ends[1] - ends[0]
    length = np.sqrt(along[0] ** 2 + along[1] ** 2)
    dx, dy = along[0] / length, along[1] / length
    nx, ny, offset = normal[0], normal[1], normal[0] * ends[0, 0] + normal[1] * ends[0, 1]
    longest, start, stop = 0.0, np.inf, -np.inf
    for p in range(first, after):
        px, py = plane_normal[p, 0], plane_normal[p, 1]
        if px * normal[0] + py * normal[1] < cos_angle:
            continue
        low, high = np.inf, -np.inf
        far = 0.0
        for e in range(2):
            ex, ey = plane_ends[p, e, 0] - ends[0, 0], plane_ends[p, e, 1] - ends[0, 1]
            far = max(far, abs(normal[0] * ex + normal[1] * ey))
            low, high = min(low, ex * dx + ey * dy), max(high, ex * dx + ey * dy)
        shared = min(high, length) - max(low, 0.0)
        if far < distance_m and shared > longest:
            longest, start, stop = shared, low, high
            nx, ny = px, py
            offset = px * plane_ends[p, 0, 0] + py * plane_ends[p, 0, 1]
    return nx, ny, offset, start, stop


@numba.njit(cache=True, nogil=True)
def _trace(
    ends: FloatArray,
    normal: FloatArray,
    first: IntArray,
    counts: FloatArray,
    origin: FloatArray,
    floor: FloatArray,
    starts: IntArray,
    ray_end: FloatArray,
    ray_label: UInt8Array,
    plane_starts: IntArray,
    plane_ends: FloatArray,
    plane_normal: FloatArray,
    near_m: float,
    range_m: float,
    distance_m: float,
    cos_angle: float,
) -> None:  # pragma: no cover
    rows = counts.shape[1]
    for s in range(len(origin)):
        ox, oy, oz = origin[s, 0], origin[s, 1], origin[s, 2]
        for w in range(len(ends)):
            nx, ny = normal[w, 0], normal[w, 1]
            reach = nx * (ox - ends[w, 0, 0]) + ny * (oy - ends[w, 0, 1])
            if reach < 0.1 or reach > range_m:
                continue
            dx, dy = ends[w, 1, 0] - ends[w, 0, 0], ends[w, 1, 1] - ends[w, 0, 1]
            length = np.sqrt(dx * dx + dy * dy)
            dx, dy = dx / length, dy / length
            nearest = min(max((ox - ends[w, 0, 0]) * dx + (oy - ends[w, 0, 1]) * dy, 0.0), length)
            if np.hypot(ends[w, 0, 0] + dx * nearest - ox, ends[w, 0, 1] + dy * nearest - oy) > range_m:
                continue
            columns = first[w + 1] - first[w]
            own_x, own_y, own_offset, start, stop = _own_plane(
                ends[w],
                normal[w],
                plane_ends,
                plane_normal,
                plane_starts[s],
                plane_starts[s + 1],
                distance_m,
                cos_angle,
            )
            face_offset = normal[w, 0] * ends[w, 0, 0] + normal[w, 1] * ends[w, 0, 1]
            for r in range(starts[s], starts[s + 1]):
                x, y, z = np.float64(ray_end[r, 0]), np.float64(ray_end[r, 1]), np.float64(ray_end[r, 2])
                nx, ny, offset = normal[w, 0], normal[w, 1], face_offset
                along = (x - ends[w, 0, 0]) * dx + (y - ends[w, 0, 1]) * dy
                if start - _OWN_MARGIN_M < along < stop + _OWN_MARGIN_M:
                    nx, ny, offset = own_x, own_y, own_offset
                reach = nx * ox + ny * oy - offset
                if reach < 0.1:
                    continue
                side = nx * x + ny * y - offset
                if side > 0.1:
                    continue
                # Floor and ceiling behind an opening are no leaf: what ended there passed the face.
                level = ray_label[r] == _FLOOR or ray_label[r] == _CEILING
                near = side > (-AT_FACE_M if level else -near_m)
                if not near:
                    t = reach / (reach - side)
                    x, y, z = ox + t * (x - ox), oy + t * (y - oy), oz + t * (z - oz)
                column = int(np.floor(((x - ends[w, 0, 0]) * dx + (y - ends[w, 0, 1]) * dy) / CELL_M))
                row = int(np.floor((z - (floor[s, 0] + floor[s, 1] * x + floor[s, 2] * y)) / CELL_M))
                if column < 0 or column >= columns or row < 0 or row >= rows:
                    continue
                cell = counts[first[w] + column, row]
                if near:
                    cell[0] += 1.0
                    cell[1] += side
                    cell[2] += side * side
                else:
                    cell[3] += 1.0
