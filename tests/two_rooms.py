"""Two rooms with a wall and a door between them, seen by exact rays."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import (
    NO_WINDOWS,
    Doors,
    Walls,
    Windows,
    one_door,
    unknown_support,
)
from ffmap.algorithms.maps.furniture_free import Immobile
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.summary import Features, concatenate
from tests.faces import parsed
from tests.rasters import moved
from tests.tracing import rays_alone

CEILING_M = 2.6
HEAD_M = 2.05
JAMBS_X = (1.5, 2.4)
SIZE_M = (4.0, 3.0)
Span = tuple[float, float]
Panel = tuple[FloatArray, Span]


@dataclass(frozen=True)
class TwoRooms:
    """Room A is [0, 4] × [0, 3], room B the same behind a wall.

    closed: the leaf is 4 cm behind A's face. both_seen: whether rays of B are included. turn_deg,
    shift: of the whole in the map. pillar: 40 × 20 cm before A's western wall. leaf_deg: of an open
    leaf, hinged at the western jamb. glass: heights of a pane that returns nothing, in the southern
    wall of A from x = 1 to 2, with reveals of 30 cm; outside_m beyond is a wall. more: further
    panels.
    """

    thickness_m: float = 0.2
    closed: bool = False
    both_seen: bool = True
    turn_deg: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    pillar: bool = False
    leaf_deg: float | None = None
    glass: Span | None = None
    outside_m: float = 1.5
    more: tuple[Panel, ...] = ()

    def to_map(self, places: FloatArray) -> FloatArray:
        return moved(np.asarray(places, float), self.turn_deg, self.shift)

    def to_rooms(self, places: FloatArray) -> FloatArray:
        return moved(np.asarray(places, float) - self.shift, -self.turn_deg, (0.0, 0.0))

    @property
    def faces(self) -> list[tuple[FloatArray, FloatArray]]:
        """Ends and normal of each wall face, unbroken by the door, as the building fuses them."""
        (x, y), t = SIZE_M, self.thickness_m
        found = []
        for south, north in ((0, y), (y + t, 2 * y))[: 1 + self.both_seen]:
            found += [
                ([[0, south], [0, north]], [1, 0]),
                ([[x, south], [x, north]], [-1, 0]),
                ([[0, south], [x, south]], [0, 1]),
                ([[0, north], [x, north]], [0, -1]),
            ]
        return [(np.array(ends, float), np.array(normal, float)) for ends, normal in found]

    @property
    def panels(self) -> list[Panel]:
        """What stops rays: segments with the heights between which they are."""
        (x, y), t, (left, right) = SIZE_M, self.thickness_m, JAMBS_X
        sides = [[[0, 0], [0, 2 * y]], [[x, 0], [x, 2 * y]], [[0, 2 * y], [x, 2 * y]]]
        sides += [[[jamb, y], [jamb, y + t]] for jamb in JAMBS_X]
        lintels = []
        for face in (y, y + t):
            sides += [[[0, face], [left, face]], [[right, face], [x, face]]]
            lintels.append([[left, face], [right, face]])
        panels = [(side, (0.0, CEILING_M)) for side in [*sides, *self._southern_wall]]
        panels += [(lintel, (HEAD_M, CEILING_M)) for lintel in lintels]
        if self.closed:
            panels.append(([[left, y + 0.04], [right, y + 0.04]], (0.0, HEAD_M)))
        if self.pillar:
            corners = [[0, 1.0], [0.2, 1.0], [0.2, 1.4], [0, 1.4]]
            panels += [(list(ends), (0.0, CEILING_M)) for ends in pairwise(corners)]
        if self.leaf_deg is not None:
            (tip,) = moved(np.array([[right - left, 0.0]]), self.leaf_deg, (left, y + t))
            panels.append(([[left, y + t], tip], (0.0, HEAD_M - 0.02)))
        if self.glass is not None:
            pane, (low_m, high_m) = [[1, 0], [2, 0]], self.glass
            panels += [(pane, (0.0, low_m)), (pane, (high_m, CEILING_M))]
            panels += [([[side, 0], [side, -0.3]], self.glass) for side in (1, 2)]
        return [*((np.array(ends, float), span) for ends, span in panels), *self.more]

    @property
    def _southern_wall(self) -> list[list[list[float]]]:
        x, _ = SIZE_M
        if self.glass is None:
            return [[[0, 0], [x, 0]]]
        outside = [[-2, -self.outside_m], [6, -self.outside_m]]
        return [[[0, 0], [1, 0]], [[2, 0], [x, 0]], outside]

    @property
    def window(self) -> Windows:
        """The pane in A's southern wall."""
        assert self.glass is not None
        bottom_m, top_m = (np.array([height]) for height in self.glass)
        pane, normal = self.to_map(np.array([[1.0, 0.0], [2.0, 0.0]])), self.walls.normal[2:3]
        return Windows(pane[None], normal, bottom_m, top_m, np.array([np.nan]), unknown_support(1))

    def scans(self, count: int = 6, rays: int = 6000, seed: int = 0) -> Features:
        """Scans from places along each room that was driven through."""
        rooms = (0.0, SIZE_M[1] + self.thickness_m) if self.both_seen else (0.0,)
        places = [(x, south + 1.5) for south in rooms for x in np.linspace(0.7, 3.3, count)]
        return concatenate([self._scan(i, np.array(p), rays, seed) for i, p in enumerate(places)])

    def _scan(self, index: int, place: FloatArray, rays: int, seed: int) -> Features:
        generator = np.random.default_rng((seed, index))
        heading = generator.uniform(0, 2 * np.pi, rays)
        slope = np.tan(generator.uniform(-1.2, 1.2, rays))
        along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        reach = np.where(slope < 0, -1.0 / slope, (CEILING_M - 1.0) / slope)
        label = np.where(slope < 0, Label.FLOOR, Label.CEILING).astype(np.uint8)
        for ends, (bottom_m, top_m) in self.panels:
            wall = ends[1] - ends[0]
            with np.errstate(divide="ignore", invalid="ignore"):
                turn = along[:, 0] * wall[1] - along[:, 1] * wall[0]
                offset = ends[0] - place
                t = (offset[0] * wall[1] - offset[1] * wall[0]) / turn
                u = (offset[0] * along[:, 1] - offset[1] * along[:, 0]) / turn
                z = 1.0 + slope * t
            hit = (t > 0) & (u >= 0) & (u <= 1) & (z >= bottom_m) & (z <= top_m) & (t < reach)
            reach, label = np.where(hit, t, reach), np.where(hit, np.uint8(Label.WALL), label)
        ends_xy = self.to_map(place + along * reach[:, None])
        origin = np.array([*self.to_map(place[None])[0], 1.0])
        return rays_alone(origin, np.column_stack([ends_xy, 1.0 + slope * reach]), label, index)

    @property
    def walls(self) -> Walls:
        ends = np.array([self.to_map(e) for e, _ in self.faces])
        normal = moved(np.array([n for _, n in self.faces]), self.turn_deg, (0.0, 0.0))
        count = len(ends)
        return Walls(
            ends,
            normal,
            np.zeros(count),
            np.full(count, CEILING_M),
            np.full(count, 5, np.int32),
            np.full(count, 0.01),
            np.full(count, 900),
            unknown_support(count),
        )

    @property
    def doors(self) -> Doors:
        y = SIZE_M[1]
        sill = self.to_map(np.array([[JAMBS_X[0], y], [JAMBS_X[1], y]]))
        return one_door(
            ends=sill,
            normal=self.walls.normal[3],
            head_m=HEAD_M,
            depth_m=0.04 if self.closed else np.nan,
            state=DoorState.CLOSED if self.closed else DoorState.OPEN,
            agreement=1.0,
            coverage=1.0,
            ray_count=100,
            scan_count=6,
            first_scan=0,
            last_scan=5,
            wall=3,
            reveal_m=self.thickness_m,
        )

    def build(
        self, doors: Doors | None = None, windows: Windows | None = None
    ) -> tuple[Immobile, Drive]:
        """What the grid is drawn from."""
        features = self.scans()
        immobile = Immobile(
            walls=self.walls,
            parsed=parsed(self.walls, features, ceiling_m=CEILING_M).stretches,
            doors=self.doors if doors is None else doors,
            windows=NO_WINDOWS if windows is None else windows,
        )
        return immobile, Drive(features.origin_map, lambda: [features])


def without(doors: Doors) -> Doors:
    """No doors, of the same kind."""
    return replace(doors, **{name: getattr(doors, name)[:0] for name in doors.__dataclass_fields__})
