"""Why each return has its label by the scan alone: the distance from a surface of the scan."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import CEILING_LOWEST_M, ScanLabelling, completed_ends
from ffmap.app.record.conditions import HEADINGS, Condition, setting_of
from ffmap.app.record.tables import table
from ffmap.blueprints.entities import CLASSES

ALL = slice(None)
SURFACE_HEADINGS = "surface", "height (m)", "slope", "support (fitted returns)", "labelled returns"


@dataclass(frozen=True, eq=False)
class _Group:
    """Returns with one label of one surface.

    own: (n,) which they are. distance_m: (n,). condition: of them, measured at none yet.
    """

    label: Label
    own: BoolArray
    distance_m: FloatArray
    condition: Condition


class ReturnReasons:
    """The conditions that gave the returns (n,) of a scan their labels."""

    def __init__(self, labelling: ScanLabelling, points_level: FloatArray) -> None:
        self._labelling, self._groups = labelling, list(_groups(labelling, points_level))

    def short(self) -> list[str]:
        """Return half a line for each return."""
        texts = [""] * len(self._labelling.label)
        for group in self._groups:
            for i in np.flatnonzero(group.own).tolist():
                texts[i] = str(replace(group.condition, measured=group.distance_m[i]))
        return texts

    def rows(self, chosen: IntArray | slice = ALL) -> list[tuple[str, ...]]:
        """Return a row for each surface: returns, label, and the condition of the median one."""
        found: list[tuple[str, ...]] = []
        for group in self._groups:
            distance_m = np.sort(group.distance_m[chosen][group.own[chosen]])
            if len(distance_m):
                median = replace(group.condition, measured=distance_m[len(distance_m) // 2])
                found.append((f"{len(distance_m):,}", CLASSES[group.label][0], *median.row))
        return found

    @property
    def surface_rows(self) -> list[tuple[str, ...]]:
        """Rows under `SURFACE_HEADINGS` of floor and ceilings."""
        floor = self._labelling.floor
        names = ["floor, bent" if len(floor.pieces) else "floor"]
        names += [f"ceiling {k}" for k in range(len(self._labelling.ceilings))]
        return [
            (
                name,
                f"{plane.height_m - floor.height_m:.2f}",
                f"{np.hypot(*plane.slope):.3f}",
                f"{plane.support:,}",
                f"{np.count_nonzero(group.own):,}",
            )
            for name, plane, group in zip(
                names, (floor, *self._labelling.ceilings), self._groups, strict=False
            )
        ]

    def document(self, chosen: IntArray | slice = ALL) -> str:
        """Return the rows as a table in Markdown."""
        return table(("returns", "label", *HEADINGS), self.rows(chosen))


def _nearest_ceiling(labelling: ScanLabelling, points_level: FloatArray) -> IntArray:
    """(n,) index of the ceiling nearest in height; 0 without one."""
    off_m = [ceiling.height_at(points_level) - points_level[:, 2] for ceiling in labelling.ceilings]
    count = len(points_level)
    return np.abs(off_m).argmin(axis=0) if off_m else np.zeros(count, np.intp)


def _groups(labelling: ScanLabelling, points_level: FloatArray) -> Iterator[_Group]:
    label, planes, floor_m = labelling.label, labelling.planes, labelling.floor.height_m
    rearrangement, of = labelling.settings.rearrangement, labelling.settings
    to_floor_m = np.abs(labelling.height_m)
    to_ceiling_m = np.abs(labelling.below_m)
    to_ceiling_m[labelling.height_m <= CEILING_LOWEST_M] = np.inf
    floor_limit = rearrangement.floor_height_m, "m", setting_of(of, "rearrangement.floor_height_m")
    ceiling_limit = (
        *(rearrangement.ceiling_distance_m, "m"),
        setting_of(of, "rearrangement.ceiling_distance_m"),
    )
    wall_limit = of.wall_planes.distance_m, "m", setting_of(of, "wall_planes.distance_m")

    name = "III.A: distance from the floor"
    near = Condition(name, np.nan, "<", *floor_limit)
    yield _Group(Label.FLOOR, label == Label.FLOOR, to_floor_m, near)
    which = _nearest_ceiling(labelling, points_level)
    for k, ceiling in enumerate(labelling.ceilings):
        name = f"III.A: distance from ceiling {k}, {ceiling.height_m - floor_m:.2f} m high"
        near = Condition(name, np.nan, "<", *ceiling_limit)
        yield _Group(Label.CEILING, (label == Label.CEILING) & (which == k), to_ceiling_m, near)

    before_m = points_level[:, :2] @ planes.normal.T - planes.offset_m
    for k in range(len(planes)):
        name, own = f"III.C: distance from plane {k}", labelling.plane == k
        near = Condition(name, np.nan, "<", *wall_limit)
        yield _Group(Label.WALL, (label == Label.WALL) & own, np.abs(before_m[:, k]), near)
        openings = labelling.openings
        closed = (openings.plane == k) & (openings.state == DoorState.CLOSED)
        if closed.any():
            depth_m = 0.5 * float(openings.depth_m[closed].min())
            name = f"III.C: on the leaf of a closed door, depth behind plane {k}"
            near = Condition(name, np.nan, ">", depth_m, "m")
            yield _Group(Label.DOOR, (label == Label.DOOR) & own, -before_m[:, k], near)

    # Clutter is near no surface: the one that it misses by least.
    along = np.stack([-planes.normal[:, 1], planes.normal[:, 0]])
    place_m, (low, high) = points_level[:, :2] @ along, completed_ends(planes).T
    beside = (place_m > low) & (place_m < high)
    to_plane_m = np.where(beside, np.abs(before_m), np.inf).min(axis=1, initial=np.inf)
    surfaces = (
        ("III.A: nearest is the floor", to_floor_m, floor_limit),
        ("III.A: nearest is a ceiling", to_ceiling_m, ceiling_limit),
        ("III.C: nearest is a wall plane", to_plane_m, wall_limit),
    )
    excess_m = np.stack([distance_m - limit[0] for _, distance_m, limit in surfaces])
    missed = excess_m.argmin(axis=0)
    for k, (name, distance_m, limit) in enumerate(surfaces):
        far = Condition(name, np.nan, "≥", *limit)
        yield _Group(Label.CLUTTER, (label == Label.CLUTTER) & (missed == k), distance_m, far)
