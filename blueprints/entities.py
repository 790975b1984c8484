"""What the recorder and the layouts share: timelines, a few entity paths, names and colours."""

from enum import IntEnum

from ffmap.algorithms.base.labels import NO_RETURN, Label, Verdict
from ffmap.algorithms.building.heights import Surface
from ffmap.algorithms.truth.maps import Agreement

APPLICATION_ID = "furniture_free_mapping"

SCAN_TIMELINE = "scan"
"""Index of the vertical cloud in the bag, skipped ones counted; of several lidars by stamp."""
STAMP_TIMELINE = "stamp"
"""Header stamp, nanoseconds since 1970."""
LINE_TIMELINE = "line"
"""In a recording of one scan: the point line, 2 × pair + side."""

TRAJECTORY = "/world/trajectory"
MAP_POINTS = "/world/map/points"
GRID = "/world/grid"
"""Below it the grid maps by name."""
WALLS = "/world/building/walls"
FACES = "/world/building/faces"
"""Below both the walls by number, as in walls.geojson."""
REASONS = "/world/building/reasons"
FURNITURE_FREE = "furniture_free"
"""Name of the grid map that the run is about."""
SEGMENTED = "segmented"
"""Name of a grid map of another system, segmented into rooms."""
ROOMS_COMPARED = "/world/rooms_compared"
"""Below it, by name of the map, rooms of other maps (Fig. 10), each as below `/world/rooms`."""
POINTS = "/scan/points"
RELABELLED = "/scan/relabelled"
PLANES = "/scan/planes"
OPENINGS = "/scan/doors/openings"

POINT_LABEL_SCAN = "label_scan"
POINT_REASON = "reason"
"""What a relabelled return is from, see `panels.Kind`."""
POINT_ODDS = "odds"
POINT_WALL = "wall"
"""The number of the wall whose panel a relabelled return is from; -1 for others."""
POINT_VERDICT_COLOR = "verdict_color"
POINT_RADIUS_UPRIGHT = "radius_without_floor_and_ceiling"
CANDIDATE_PLANE_COLOR = "plane_color"

GRAPH_UNITS_PER_M = 25.0
"""Scale of the graph of rooms: its view draws names in its own units."""
OVERHEAD = [s for s in Surface if s.label == Label.CEILING]
"""Level surfaces that hide the rooms below them."""

Color = tuple[int, int, int]

CLASSES: dict[int, tuple[str, Color]] = {
    Label.CLUTTER: ("clutter", (255, 214, 0)),
    Label.FLOOR: ("floor", (140, 140, 140)),
    Label.CEILING: ("ceiling", (226, 48, 48)),
    Label.WALL: ("wall", (46, 204, 87)),
    Label.DOOR: ("door", (54, 120, 255)),
    Label.OUTSIDE: ("outside", (236, 64, 236)),
    NO_RETURN: ("none", (60, 60, 60)),
}
"""Name and colour of each label."""
WALL_COLOR, DOOR_COLOR = CLASSES[Label.WALL][1], CLASSES[Label.DOOR][1]
LAYER_COLORS: tuple[Color, ...] = (
    (255, 140, 60),
    WALL_COLOR,
    DOOR_COLOR,
    (150, 110, 230),
    (190, 190, 190),
    (250, 250, 250),
)
"""Rays that ended before a wall face, on it, in a recess, deep in the wall, far behind, beyond."""


class LineOutcome(IntEnum):
    """Result of a point line."""

    NO_STRUCTURE = 0
    REFUSED = 1
    WALL = 2
    DOOR = 3


LINE_OUTCOMES: dict[int, tuple[str, Color]] = {
    LineOutcome.NO_STRUCTURE: ("no vertical structure", (130, 130, 130)),
    LineOutcome.REFUSED: ("candidate refused", (255, 140, 0)),
    LineOutcome.WALL: ("in a wall plane", WALL_COLOR),
    LineOutcome.DOOR: ("above a door", DOOR_COLOR),
}


class Fault(IntEnum):
    """Error of the final label of a return."""

    NONE = 0
    OF_THE_SCAN = 1  # Wrong, as the scan labelled it
    OF_THE_BUILDING = 2  # Wrong, the scan had another label
    RELABELLED = 3  # Not the scan's label; ground truth is not known


FAULT_CLASSES: dict[int, tuple[str, Color]] = {
    Fault.OF_THE_SCAN: ("wrong, as the scan labelled it", (0, 190, 205)),
    Fault.OF_THE_BUILDING: ("wrong, as the building changed it", (255, 105, 180)),
    Fault.RELABELLED: ("changed by the building", (0, 190, 205)),
}
"""Colours that nothing else in the view has."""

VERDICTS: dict[int, tuple[str, Color]] = {
    Verdict.RIGHT: ("right", (80, 88, 100)),
    Verdict.FALSE_WALL: ("false wall", (240, 50, 50)),
    Verdict.MISSED_WALL: ("missed wall", (255, 150, 0)),
    Verdict.FALSE_DOOR: ("false door", (200, 90, 255)),
    Verdict.MISSED_DOOR: ("missed door", (70, 140, 255)),
    Verdict.OTHER: ("other", (240, 220, 90)),
}
"""Name and colour of each error of a label."""

AGREEMENTS: dict[int, tuple[str, Color]] = {
    Agreement.NOTHING: ("unknown", (205, 205, 205)),
    Agreement.FREE: ("free", (255, 255, 255)),
    Agreement.BOTH: ("wall in both", (20, 140, 60)),
    Agreement.ONLY_MAP: ("wall only in the map", (240, 50, 50)),
    Agreement.ONLY_REFERENCE: ("wall only in the ground truth", (255, 150, 0)),
}
"""Name and colour of each result of a comparison of two maps (Fig. 9e)."""

TRUTH_COLOR: Color = (0, 190, 160)
SELECTED_COLOR: Color = (165, 85, 255)
"""The line of the curve. Like all colours, it is visible on dark and on light ground."""
UPMOST_COLOR: Color = (46, 204, 87)
BOTTOMMOST_COLOR: Color = (255, 140, 0)
LOOP_COLOR: Color = (0, 190, 160)
WEAK_COLOR: Color = (255, 70, 70)
KEYPOINT_COLOR: Color = (255, 196, 0)


def scan_error(verdict: Verdict) -> str:
    """Return the entity of the share of each scan's returns with this error."""
    return f"/metrics/errors/{VERDICTS[verdict][0].replace(' ', '_')}"
