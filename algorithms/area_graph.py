"""Rooms, passages and topology of a grid map: the Area Graph (paper, IV.D, Fig. 10)."""

from dataclasses import dataclass

import shapely

from algorithms.scan import FloatArray, IntArray


@dataclass(frozen=True)
class Room:
    """One area of the Area Graph.

    name: unique in its map. polygon: its free space in metres of the map frame, furniture in it counted as the room's.
    area_m2: what the polygon covers. doors: indices of the doors on its border, ascending.
    """

    name: str
    polygon: shapely.Polygon
    area_m2: float
    doors: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Passage:
    """Where two rooms meet.

    rooms: indices of the two, the lower first. line: (2, 2) x and y of its ends in metres of the map frame.
    door: index of the detected door that it is, None where the map alone told.
    """

    rooms: tuple[int, int]
    line: FloatArray
    door: int | None


@dataclass(frozen=True, eq=False)
class AreaGraph:
    """Rooms, how they are joined, and the evidence.

    label: (rows, columns) int32, the room's index in each cell of the grid, -1 where there is none; row 0 is the lowest y.
    origin: (2,) x and y of the grid's lower left corner. cell_m: edge of a cell.
    furniture: what the alpha removal took for furniture, in metres of the map frame.
    skeleton: (s, 2, 2) edges of the Voronoi graph, cut at the passages, in metres of the map frame.
    """

    rooms: tuple[Room, ...]
    passages: tuple[Passage, ...]
    label: IntArray
    origin: FloatArray
    cell_m: float
    furniture: tuple[shapely.Polygon, ...]
    skeleton: FloatArray

    def __len__(self) -> int:
        return len(self.rooms)
