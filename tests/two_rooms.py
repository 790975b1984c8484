"""Two rooms with a wall and a door between them, seen by exact rays: a building whose maps are known."""

from dataclasses import dataclass, field, replace

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import BuildingSettings, Doors, Walls, Windows, one_door
from ffmap.algorithms.building.ray_evidence import trace_rays
from ffmap.algorithms.building.votes import VoxelTable
from ffmap.algorithms.maps.furniture_free import Immobile, both_sides
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.summary import Features, concatenate
from tests.tracing import rays_alone

CEILING_M = 2.6
HEAD_M = 2.05
JAMBS_X = (1.5, 2.4)
SIZE_M = (4.0, 3.0)


@dataclass(frozen=True)
class TwoRooms:
    """Room A is [0, 4] × [0, 3], room B the same behind a wall; B's rays are left out unless both are seen.

    closed: the leaf stands 4 cm behind A's face. turn_deg, shift: of the whole in the map. pillar: 40 × 20 cm before A's
    western wall. leaf_deg: where an open leaf stands, hung at the western jamb. glass: heights between which the
    southern wall of A has a pane that returns nothing, from x = 1 to 2, with reveals of 30 cm; so far outside is a wall.
    """

    thickness_m: float = 0.2
    closed: bool = False
    both_seen: bool = True
    turn_deg: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    pillar: bool = False
    leaf_deg: float | None = None
    glass: tuple[float, float] | None = None
    outside_m: float = 1.5
    more: tuple[tuple[FloatArray, tuple[float, float]], ...] = field(default=())

    def to_map(self, places: FloatArray) -> FloatArray:
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        return np.asarray(places, float) @ np.array([[c, s], [-s, c]]) + np.array(self.shift)

    def to_rooms(self, places: FloatArray) -> FloatArray:
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        return (np.asarray(places, float) - np.array(self.shift)) @ np.array([[c, -s], [s, c]])

    @property
    def faces(self) -> list[tuple[FloatArray, FloatArray]]:
        """Ends and normal of each wall face, unbroken by the door, as the building fuses them."""
        (x, y), t = SIZE_M, self.thickness_m
        a = [
            ([[0, 0], [0, y]], [1, 0]),
            ([[x, 0], [x, y]], [-1, 0]),
            ([[0, 0], [x, 0]], [0, 1]),
            ([[0, y], [x, y]], [0, -1]),
        ]
        b = [
            ([[0, y + t], [0, 2 * y]], [1, 0]),
            ([[x, y + t], [x, 2 * y]], [-1, 0]),
            ([[0, y + t], [x, y + t]], [0, 1]),
            ([[0, 2 * y], [x, 2 * y]], [0, -1]),
        ]
        return [(np.array(e, float), np.array(n, float)) for e, n in (a + b if self.both_seen else a)]

    @property
    def panels(self) -> list[tuple[FloatArray, tuple[float, float]]]:
        """What stops rays: segments with the heights between which they stand."""
        (x, y), t, (left, right) = SIZE_M, self.thickness_m, JAMBS_X
        whole = (0.0, CEILING_M)
        panels = [(ends, whole) for ends, _ in self.faces if ends[0, 1] == ends[1, 1] and ends[0, 1] not in (y, y + t)]
        panels += [(ends, whole) for ends, _ in self.faces if ends[0, 0] == ends[1, 0]]
        if not self.both_seen:
            panels += [(np.array([[0, 2 * y], [x, 2 * y]]), whole), (np.array([[0, y], [0, 2 * y]]), whole)]
            panels += [(np.array([[x, y], [x, 2 * y]]), whole)]
        for side in (y, y + t):
            panels += [(np.array([[0, side], [left, side]]), whole), (np.array([[right, side], [x, side]]), whole)]
            panels += [(np.array([[left, side], [right, side]]), (HEAD_M, CEILING_M))]
        panels += [(np.array([[jamb, y], [jamb, y + t]]), whole) for jamb in JAMBS_X]
        if self.closed:
            panels += [(np.array([[left, y + 0.04], [right, y + 0.04]]), (0.0, HEAD_M))]
        if self.pillar:
            corners = np.array([[0, 1.0], [0.2, 1.0], [0.2, 1.4], [0, 1.4]])
            panels += [(corners[i : i + 2], whole) for i in range(3)]
        if self.leaf_deg is not None:
            angle = np.radians(self.leaf_deg)
            hinge = np.array([left, y + t])
            tip = hinge + (right - left) * np.array([np.cos(angle), np.sin(angle)])
            panels += [(np.stack([hinge, tip]), (0.0, HEAD_M - 0.02))]
        if self.glass is not None:
            south = [i for i, (ends, _) in enumerate(panels) if (ends[:, 1] == 0).all() and ends[1, 0] == x]
            panels.pop(south[0])
            panels += [(np.array([[a, 0], [b, 0]], float), whole) for a, b in ((0, 1), (2, x))]
            panels += [(np.array([[1, 0], [2, 0]], float), (0.0, self.glass[0]))]
            panels += [(np.array([[1, 0], [2, 0]], float), (self.glass[1], CEILING_M))]
            panels += [(np.array([[side, 0], [side, -0.3]], float), self.glass) for side in (1, 2)]
            panels += [(np.array([[-2, -self.outside_m], [6, -self.outside_m]], float), whole)]
        return [*panels, *self.more]

    @property
    def window(self) -> Windows:
        """The pane in A's southern wall."""
        assert self.glass is not None
        bottom_m, top_m = (np.array([height]) for height in self.glass)
        pane, normal = self.to_map(np.array([[1.0, 0.0], [2.0, 0.0]])), self.walls.normal[2:3]
        return Windows(pane[None], normal, bottom_m, top_m, np.array([np.nan]))

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
        origin = self.to_map(np.zeros((1, 2)))
        normal = np.array([self.to_map(n[None])[0] - origin[0] for _, n in self.faces])
        count = len(ends)
        return Walls(
            ends,
            normal,
            np.zeros(count),
            np.full(count, 2.6),
            np.full(count, 5, np.int32),
            np.full(count, 0.01),
            np.full(count, 900),
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

    def build(self, doors: Doors | None = None, windows: Windows | None = None) -> tuple[Immobile, Drive]:
        """What the grid is drawn from."""
        features = self.scans()
        votes = VoxelTable(0.05, len(Label))
        votes.add(features.ray_end_map, features.ray_label)
        none = np.zeros(0)
        immobile = Immobile(
            walls=self.walls,
            cells=trace_rays(both_sides(self.walls), [features], BuildingSettings()),
            votes=votes.votes(),
            doors=doors if doors is not None else self.doors,
            windows=windows
            if windows is not None
            else Windows(np.zeros((0, 2, 2)), np.zeros((0, 2)), none, none, none),
        )
        return immobile, Drive(features.origin_map, lambda: [features])


def without(doors: Doors) -> Doors:
    """No doors, of the same kind."""
    return replace(doors, **{name: getattr(doors, name)[:0] for name in doors.__dataclass_fields__})
