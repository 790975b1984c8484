"""What the recorder writes and the blueprints show: entity paths, timelines, class names and colours."""

from collections.abc import Mapping
from enum import IntEnum
from pathlib import PurePath
from typing import Any

import numpy as np

from algorithms.labels import NO_RETURN, Label, Verdict
from algorithms.map_comparison import Agreement
from algorithms.scan import FloatArray
from algorithms.standing_walls import FaceVerdict

APPLICATION_ID = "furniture_free_mapping"

SCAN_TIMELINE = "scan"
"""Index of the vertical cloud in the bag, skipped ones counted."""
STAMP_TIMELINE = "stamp"
"""Header stamp, nanoseconds since 1970."""

README = "/readme"
MESSAGES = "/messages"

WORLD = "/world"
BASE = "/world/base"
TRAJECTORY = "/world/trajectory"
MAP_POINTS = "/world/map/points"
MAP_CEILING = "/world/map/ceiling"
ODOMETRY = "/world/odometry"
ODOMETRY_SENSOR = "/world/odometry/sensor"
KEYPOINTS = "/world/odometry/sensor/keypoints"
LOCAL_MAP = "/world/odometry/local_map"
BUILDING = "/world/building"
WALLS = "/world/building/walls"
DOORS = "/world/building/doors"
DOOR_SILLS = "/world/building/sills"
WINDOWS = "/world/building/windows"
REFUSED_WALLS = "/world/building/refused_walls"
REFUSED_COLOUR = (255, 140, 60)
BUILDING_REASONS = "/world/building/reasons"
REFUSALS = {
    FaceVerdict.ENDS_LOW: "rays pass above it, below the ceiling (a leaf, a cupboard)",
    FaceVerdict.HANGS: "rays pass below it (a duct, a beam)",
}
CLOUD = "/world/building/cloud"
CLOUD_CEILING = "/world/building/ceiling"
GRID = "/world/grid"
FURNITURE_FREE = "furniture_free"
"""Name of the grid that the run is about; the paper's rivals lie beside it."""
OVERLAYS = "/world/overlay"
"""Below it, for each grid by name, what is right and wrong of it."""

SCAN = "/scan"
POINTS = "/scan/points"
RELABELLED = "/scan/relabelled"
FLOOR = "/scan/floor"
CEILING = "/scan/ceiling"
LINES = "/scan/lines"
EXAMPLE_LINE = "/scan/lines/example"
UPMOST = "/scan/candidates/upmost"
BOTTOMMOST = "/scan/candidates/bottommost"
PLANES = "/scan/planes"
DOOR_CONDITIONS = "/scan/doors/conditions"
DOOR_LINES = "/scan/doors/lines"
OPENINGS = "/scan/doors/openings"

STRUCTURES = "/scan/structures"
CURVES = "/scan/curves"
CURVE_FRAMES = "/scan/curves/frames"
CURVE_THRESHOLDS = "/scan/curves/thresholds"
CURVE_TEXTS = "/scan/curves/texts"
CURVE_DIFFERENCES = "/scan/curves/differences"
CURVE_UPMOST = "/scan/curves/upmost"
CURVE_BOTTOMMOST = "/scan/curves/bottommost"
CURVE_EXAMPLE = "/scan/curves/example"
CURVE_EXAMPLE_SLOPE = "/scan/curves/example_slope"
CURVE_EXAMPLE_STRUCTURES = "/scan/curves/example_structures"
CURVE_EXAMPLE_TEXTS = "/scan/curves/example_texts"

TRUTH_WALLS = "/world/truth/walls"
TRUTH_DOORS = "/world/truth/doors"
ERRORS = "/world/errors/space"
PLAN_ERRORS = "/world/errors/plan"
INVENTED_DOORS = "/world/errors/invented_doors"
FIGURES = "/evaluation/figures"
SCAN_ERRORS = "/metrics/errors"

MILLISECONDS = "/metrics/milliseconds"
LABEL_COUNTS = "/metrics/labels"
COUNTS = "/metrics/counts"
REGISTRATION = "/metrics/registration"

POINT_LABEL_SCAN = "label_scan"
POINT_VERDICT_COLOR = "verdict_color"
POINT_RADIUS_UPRIGHT = "radius_without_floor_and_ceiling"
CANDIDATE_PLANE_COLOR = "plane_color"

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


class LineOutcome(IntEnum):
    """What became of a point line."""

    NO_STRUCTURE = 0
    REFUSED = 1
    WALL = 2
    DOOR = 3


LINE_OUTCOMES: dict[int, tuple[str, Color]] = {
    LineOutcome.NO_STRUCTURE: ("no vertical structure", (130, 130, 130)),
    LineOutcome.REFUSED: ("candidate refused", (255, 140, 0)),
    LineOutcome.WALL: ("in a wall plane", CLASSES[Label.WALL][1]),
    LineOutcome.DOOR: ("above a door", CLASSES[Label.DOOR][1]),
}

DOOR_CONDITION_CLASSES: dict[int, tuple[str, Color]] = {
    1: ("1: in a wall plane", (170, 170, 170)),
    2: ("1, 2: all below lies behind the plane", (255, 140, 0)),
    3: ("1, 2, 3: high enough: above a door", CLASSES[Label.DOOR][1]),
}
"""How many of the paper's conditions held, in order."""

VERDICTS: dict[int, tuple[str, Color]] = {
    Verdict.RIGHT: ("right", (80, 88, 100)),
    Verdict.FALSE_WALL: ("false wall", (240, 50, 50)),
    Verdict.MISSED_WALL: ("missed wall", (255, 150, 0)),
    Verdict.FALSE_DOOR: ("false door", (200, 90, 255)),
    Verdict.MISSED_DOOR: ("missed door", (70, 140, 255)),
    Verdict.OTHER: ("other", (240, 220, 90)),
}
"""Name and colour of what may be wrong with a label."""
AGREEMENTS: dict[int, tuple[str, Color]] = {
    Agreement.NOTHING: ("unknown", (205, 205, 205)),
    Agreement.FREE: ("free", (255, 255, 255)),
    Agreement.BOTH: ("wall in both", (20, 140, 60)),
    Agreement.ONLY_MAP: ("wall only in the map", (240, 50, 50)),
    Agreement.ONLY_REFERENCE: ("wall only in the reference", (255, 150, 0)),
    Agreement.NOT_SEEN: ("wall that was not seen", (120, 160, 230)),
}
"""Name and colour of what a map laid over another shows (Fig. 9e)."""
TRUTH_COLOR: Color = (235, 238, 245)

UPMOST_COLOR: Color = (46, 204, 87)
BOTTOMMOST_COLOR: Color = (255, 140, 0)
THRESHOLD_COLOR: Color = (240, 60, 60)
CURVE_COLOR: Color = (84, 112, 160)
EXAMPLE_COLOR: Color = (255, 255, 255)
FRAME_COLOR: Color = (70, 74, 82)
TEXT_COLOR: Color = (200, 204, 212)
TRAJECTORY_COLOR: Color = (0, 214, 255)
KEYPOINT_COLOR: Color = (255, 196, 0)
LOCAL_MAP_COLOR: Color = (96, 110, 130)

PLANE_COLORS: tuple[Color, ...] = (
    (31, 186, 140),
    (214, 110, 40),
    (126, 118, 220),
    (231, 60, 148),
    (122, 186, 40),
    (240, 190, 30),
    (90, 170, 240),
    (170, 110, 70),
)
"""Wall planes take these in turn."""
REFUSED_COLOR: Color = (110, 110, 110)


class CurveSheet:
    """Where the difference curves are drawn, in units of one sample to the right and downwards.

    On top one line's curve as in Fig. 5b; below it one small cell for every line: first the lines of side 0, emitter by
    emitter, then those of side 1.
    """

    SAMPLES = 200
    COLUMNS = 8
    GAP_X = 24
    CELL_HEIGHT = 80
    GAP_Y = 12
    SIDE_GAP = 130
    LIMIT = 4.0
    """Differences beyond ±4 are drawn at ±4."""
    WIDTH = COLUMNS * (SAMPLES + GAP_X) - GAP_X
    EXAMPLE_HEIGHT = 420
    TITLE_HEIGHT = 72

    def __init__(self, ring_count: int) -> None:
        self.ring_count = ring_count
        self.rows = -(-ring_count // self.COLUMNS)

    @property
    def height(self) -> float:
        """From the top of the large curve to the foot of the last cell."""
        return self.side_top(2) - self.SIDE_GAP

    @property
    def cells(self) -> FloatArray:
        """(2n, 2) left end and middle height of each line's cell."""
        ring, side = np.divmod(np.arange(2 * self.ring_count), 2)
        row, column = np.divmod(ring, self.COLUMNS)
        x = column * (self.SAMPLES + self.GAP_X)
        y = self.side_top(0) + side * (self.side_top(1) - self.side_top(0)) + row * (self.CELL_HEIGHT + self.GAP_Y)
        return np.column_stack([x, y + self.CELL_HEIGHT / 2]).astype(np.float32)

    def side_top(self, side: int) -> float:
        """Where the first row of a side begins."""
        return (
            self.EXAMPLE_HEIGHT + self.SIDE_GAP + side * (self.rows * (self.CELL_HEIGHT + self.GAP_Y) + self.SIDE_GAP)
        )


_README = """# {bag}

Every intermediate of *Furniture Free Mapping using 3D Lidars* (He, Hou, Schwertfeger), scan by scan.

**Two lidars, two tasks.** {lidars}

## What the tabs show
| tab | what to look at |
|---|---|
| **At a glance** | the labelled scan; its point lines and wall planes; eq. 2 along every line with its threshold; \
the map, growing up to the time cursor; the furniture-free grid |
| **Step by step** | Fig. 3 (no floor, no ceiling), 5a (point lines), 6 (up-most and bottom-most structures), \
7 (wall planes), the door conditions |
| **Building** | the fused cloud, walls, doors (blue), windows (magenta), and the grid; they hold for the whole run |
| **Odometry** | what KISS-ICP used of each horizontal scan. These lie on the timeline `stamp` alone: choose it below |
| **Metrics and warnings** | returns by label, evidence counted, milliseconds by stage, scans that were skipped |

## Colours
| class | {class_names} |
|---|{class_rules}
| colour | {class_colors} |

Point lines: green in a wall plane, blue above a door, orange where the candidate was refused, gray without a vertical
structure. Wall planes have colours of their own, in turn.

## Timelines
`scan` is the index of the vertical cloud in the bag, skipped ones counted; `stamp` is the time in the cloud's header.

## Frames
`/world` is the map: z up, its origin on the floor below the robot at the start. `/scan` is level, with its origin below
the robot and x ahead; its transform places it in the map.

## Where the values are
`/scan/points` has `label_scan`, the label by this scan alone, and `class_ids`, the final one. `/scan/relabelled` holds
the points where they differ. `/scan/structures` has `difference`, eq. 2 as printed, and `slope`, the one over a longer
span that decides: one row a line (2 × emitter + side) of 200 samples from below upwards; and each structure's line, first
and last sample. Planes, candidates and doors carry their parameters beside what is drawn.

## This run
{run}
"""

_COLOR_WORDS = ("yellow", "gray", "red", "green", "blue", "magenta")


def explain(record: Mapping[str, Any]) -> str:
    """The recording explained to a stranger, in Markdown.

    record: what `run.json` holds at the start; what is missing there is left out.
    """
    rig = record.get("rig", {})
    tasks = {"horizontal": "gives the poses", "vertical": "sweeps walls and ceiling and is labelled"}
    lidars = [f"The {role} one, `{rig[role]['topic']}`, {task}." for role, task in tasks.items() if role in rig]
    facts = {
        "bag": record.get("bag", {}).get("path"),
        "digest": record.get("bag", {}).get("digest"),
        "poses from": record.get("poses_from"),
        "started": record.get("started"),
        "settings": record.get("settings_hash"),
        **record.get("versions", {}),
    }
    settings = record.get("settings", {})
    steps = {step: values for step, values in settings.items() if isinstance(values, Mapping)}
    run = ["| | |", "|---|---|"] + [f"| {name} | `{value}` |" for name, value in facts.items() if value]
    if steps:
        run += ["", "## Settings", "| step | setting | value |", "|---|---|---|"]
        run += [f"| {step} | {name} | {value} |" for step, values in steps.items() for name, value in values.items()]
    return _README.format(
        bag=PurePath(str(facts["bag"] or "A run")).name,
        lidars=" ".join(lidars) or "The horizontal one gives the poses, the vertical one is labelled.",
        class_names=" | ".join(CLASSES[label][0] for label in Label),
        class_rules="---|" * len(Label),
        class_colors=" | ".join(_COLOR_WORDS),
        run="\n".join(run),
    )
