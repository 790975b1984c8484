"""Why the building gave a return another label than its scan had."""

from enum import IntEnum

from ffmap.algorithms.building.heights import Surface


class Reason(IntEnum):
    """By what a return was relabelled; what a level surface says follows, see `REASONS`."""

    KEPT = 0
    BEYOND_WINDOW = 1
    MET_FIRST = 2
    ABOVE_FLOOR = 3
    ON_LEAF = 4
    IN_OPENING = 5
    AGAINST_WALL = 6
    ON_REFUSED = 7
    ON_REVEAL = 8
    ON_FACE = 9
    IN_WALL = 10
    NO_FACE = 11
    IN_HALO = 12
    ON_BLIND = 13


SURFACE_REASONS = {surface: len(Reason) + place for place, surface in enumerate(Surface)}
"""The code of each level surface, after those of `Reason`."""

_SURFACE_WORDS = {
    Surface.CEILING: "all scans together show a ceiling there",
    Surface.CEILING_DROP: "it is a beam, a coffer or a soffit that closes up to the ceiling",
    Surface.FLOOR: "all scans together show a floor there",
    Surface.STEP_FRONT: "it is the front of a step between two floors",
    Surface.STOREY_BELOW: "it lies below the floor",
}

REASONS: dict[int, str] = {
    Reason.KEPT: "nothing changed it",
    Reason.BEYOND_WINDOW: "its ray passed a pane",
    Reason.MET_FIRST: "along an edge, its ray meets this surface first",
    Reason.ABOVE_FLOOR: "it lies higher above the floor than the floor's returns scatter",
    Reason.ON_LEAF: "it lies on a closed door's leaf",
    Reason.IN_OPENING: "no wall stands in an open doorway",
    Reason.AGAINST_WALL: "something stands flat against the wall there",
    Reason.ON_REFUSED: "it lies on a face that is no wall's",
    Reason.ON_REVEAL: "it lies on a reveal, a sill, a lintel or a mullion",
    Reason.ON_FACE: "it lies on a wall's face",
    Reason.IN_WALL: "it lies within a wall, behind the face that the sensor sees: scatter",
    Reason.NO_FACE: "no wall's face is near enough",
    Reason.IN_HALO: "the surface beside it has many times as many returns there: scatter",
    Reason.ON_BLIND: "it lies on what hangs in a window",
    **{SURFACE_REASONS[surface]: words for surface, words in _SURFACE_WORDS.items()},
}
"""Each code in words, as the end of a sentence that begins with because."""

SETTINGS: dict[int, str] = {
    Reason.BEYOND_WINDOW: "relabelling.behind_glass_m",
    Reason.MET_FIRST: "relabelling.scatter_m",
    Reason.ABOVE_FLOOR: "relabelling.floor_scatter_m",
    Reason.ON_LEAF: "relabelling.leaf_distance_m",
    Reason.IN_OPENING: "relabelling.opening_m",
    Reason.AGAINST_WALL: "foreground.relief_m",
    Reason.ON_REFUSED: "relabelling.wall_distance_m",
    Reason.ON_REVEAL: "relabelling.at_reveal_m",
    Reason.ON_FACE: "relabelling.wall_distance_m",
    Reason.IN_WALL: "relabelling.body_m",
    Reason.NO_FACE: "relabelling.forget_m",
    Reason.IN_HALO: "halo.ratio",
    Reason.ON_BLIND: "relabelling.wall_distance_m",
}
"""The setting of each reason that decides on single returns; `NO_FACE` of a door is by that of
`ON_FACE`. The others depend on what all scans show of the building."""

FACE_COMPARISONS: dict[int, str] = {
    Reason.ON_FACE: "<",
    Reason.ON_REFUSED: ">",
    Reason.NO_FACE: ">",
}
"""How the setting is compared with the distance of a return from the nearest face."""
