"""What the recorder writes and the blueprints show: entity paths, timelines, class names and colours."""

from collections.abc import Mapping
from enum import IntEnum
from pathlib import PurePath
from typing import Any

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN, Label, Verdict
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.face_verdicts import FaceVerdict
from ffmap.algorithms.building.height_map import Surface
from ffmap.algorithms.building.label_reasons import REASONS
from ffmap.algorithms.truth.maps import Agreement

APPLICATION_ID = "furniture_free_mapping"

SCAN_TIMELINE = "scan"  # Index of the vertical cloud in the bag, skipped ones counted, those of several lidars by their stamps
STAMP_TIMELINE = "stamp"  # Header stamp, nanoseconds since 1970

README = "/readme"
GLANCE = "/glance"  # What the first tab shows, in a few words
MESSAGES = "/messages"  # Of single scans: why one was skipped, or its registration is weak
WARNINGS = "/warnings"  # Of the whole run
LABEL_LEGEND = "/legend/labels"
ERROR_LEGEND = "/legend/errors"

WORLD = "/world"
BASE = "/world/base"
OWN_BODY = "own_body"  # Below a lidar's own entity in the base's frame
TRAJECTORY = "/world/trajectory"
MAP_POINTS = "/world/map/points"
MAP_CEILING = "/world/map/ceiling"
ODOMETRY = "/world/odometry"
ODOMETRY_SENSOR = "/world/odometry/sensor"
KEYPOINTS = "/world/odometry/sensor/keypoints"
LOCAL_MAP = "/world/odometry/local_map"
WEAK_REGISTRATION = "/world/odometry/weak"
POSE_GRAPH = "/world/pose_graph"
SUBMAPS = "/world/pose_graph/submaps"
LOOPS = "/world/pose_graph/loops"
WAY_OF_ODOMETRY = "/world/pose_graph/way_of_odometry"
BUILDING = "/world/building"
WALLS = "/world/building/walls"
DOORS = "/world/building/doors"
DOOR_SILLS = "/world/building/sills"
DOOR_LEAVES = "/world/building/leaves"
WINDOWS = "/world/building/windows"
MULLIONS = "/world/building/mullions"
BLINDS = "/world/building/blinds"
FUSED_WALLS = "/world/building/fused_walls"
REFUSED_WALLS = "/world/building/refused_walls"
AGAINST_WALLS = "/world/building/against_walls"
LEVELS = "/world/building/levels"
OVERHEAD = [surface for surface in Surface if surface.label == Label.CEILING] + [Surface.MIRRORED_FLOOR]
BUILDING_REASONS = "/world/building/reasons"
REFUSALS = {
    FaceVerdict.ENDS_LOW: "rays pass above it, below the ceiling (a leaf, a cupboard)",
    FaceVerdict.HANGS: "rays pass below it (a duct, a beam)",
    FaceVerdict.ALONE: "few scans saw it, no wall is parallel or square to it, it ends below the ceiling (a side of furniture)",
    FaceVerdict.LEANS: "it crosses a wall at a small angle (a leaf open against it, or a plane laid across wall and leaf)",
    FaceVerdict.OUTSIDE: "neither floor nor ceiling was seen before it (another house's front, through a window)",
    FaceVerdict.MIRRORED: "it is seen past a window alone (a pane's reflection of another wall)",
    FaceVerdict.FOLDED: "it hangs in folds, before and behind its plane by turns (a curtain)",
}
CLOUD = "/world/building/cloud"
CLOUD_CEILING = "/world/building/ceiling"
GRID = "/world/grid"
FURNITURE_FREE = "furniture_free"  # Name of the grid that the run is about; the paper's rivals lie beside it
SEGMENTED = "segmented"  # Name of a grid of another system's, of which only the rooms are wanted
ROOMS = "/world/rooms"
ROOM_FLOORS, ROOM_OUTLINES, ROOM_NAMES, ROOM_PASSAGES = "floors", "outlines", "names", "passages"
"""What lies below `ROOMS`, and below each of `ROOMS_COMPARED`."""
ROOM_TOPOLOGY = f"{ROOMS}/topology"
ROOM_VORONOI = f"{ROOMS}/voronoi"
ROOM_FURNITURE = f"{ROOMS}/furniture"
ROOMS_COMPARED = "/world/rooms_compared"
"""Below it, by name, the areas of other maps for comparison (Fig. 10), each like those below `ROOMS`."""
ROOM_GRAPH = "/rooms/graph"
GRAPH_UNITS_PER_M = 25.0
"""The graph's view writes names in its own units: rooms have to lie as far apart as they are long."""
OVERLAYS = "/world/overlay"  # Below it, for each grid by name, what is right and wrong of it

SCAN = "/scan"
POINTS = "/scan/points"
RELABELLED = "/scan/relabelled"
SCAN_LIDAR = "/scan/lidar"  # Where several are labelled: which one the scan is from, in words, and beside them as a number
LIDAR_PLACE = "place"  # That number: 0 for the first of the lidars that are labelled, as run.json lists them
FLOOR = "/scan/floor"
CEILING = "/scan/ceiling"
LINES = "/scan/lines"
EXAMPLE_LINE = "/scan/lines/example"
UPMOST = "/scan/candidates/upmost"
BOTTOMMOST = "/scan/candidates/bottommost"
PLANES = "/scan/planes"
SCAN_DOORS = "/scan/doors"
DOOR_CONDITIONS = f"{SCAN_DOORS}/conditions"
DOOR_LINES = f"{SCAN_DOORS}/lines"
OPENINGS = f"{SCAN_DOORS}/openings"

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
TRUTH_DOOR_SILLS = "/world/truth/door_sills"  # The same doors laid flat: seen from above, upright frames would be slabs
ERRORS = "/world/errors/space"
PLAN_ERRORS = "/world/errors/plan"
INVENTED_DOORS = "/world/errors/invented_doors"
FIGURES = "/evaluation/figures"
EVALUATION_HELP = "/evaluation/help"
SCAN_ERRORS = "/metrics/errors"

CHANGED_POINTS = "/changes/{}/points"  # Of the comparison of the first run with this one; its letter is to be filled in
CHANGED_CUBES = "/changes/{}/cubes"
CHANGED_PERCENT = "/changes/{}/percent"
CHANGED_PERCENT_SCAN = "/changes/{}/percent_of_single_scans"
CHANGED_PLANES = "/changes/{}/planes"
CHANGED_WALLS = "/changes/{}/building/walls"
CHANGED_DOORS = "/changes/{}/building/doors"
CHANGED_CELLS = "/changes/{}/building/cells"
POSE_DISTANCE = "/changes/{}/pose_distance_m"
CHANGES_TEXT = "/changes/{}/text"
RUNS_TEXT = "/changes/runs"
PATHS = "/paths"  # Below it the trajectory of each run, by its letter

LINE_TIMELINE = "line"  # Of a recording of one scan: point line 2 × pair + side
WHY_LINE = "/why/line"
WHY_SCAN = "/why/scan"
LINE_SIGHT = "/scan/line/sight"
LINE_STRUCTURES = "/scan/line/structures"
LINE_GROWING = "/scan/line/growing_plane"
LINE_PLANE = "/scan/line/plane"
LINE_DOOR = "/scan/line/door"
FAULTS = "/scan/faults"  # The returns of an inspected scan that are labelled wrongly
PROFILE = "/profile"
PROFILE_SAMPLES = "/profile/samples"
PROFILE_STRUCTURES = "/profile/structures"
PROFILE_LEVELS = "/profile/levels"
PROFILE_DOOR = "/profile/door"
PROFILE_FAULTS = "/profile/faults"

MILLISECONDS = "/metrics/milliseconds"
LABEL_COUNTS = "/metrics/labels"
COUNTS = "/metrics/counts"
RANGES = "/metrics/ranges"
REGISTRATION = "/metrics/registration"

POINT_LABEL_SCAN = "label_scan"
POINT_INTENSITY = "intensity"
POINT_ALONE = "measured_alone"
"""Whether a return lies on no facet that its neighbours show: its range stays as measured."""
POINT_REASON = "reason"
"""Why the building relabelled a return, see `REASONS`."""
POINT_OFF_FACE = "metres_to_wall_face"
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


def scan_error(verdict: Verdict) -> str:
    """Where the share of each scan's returns is logged that are wrong in one way."""
    return f"{SCAN_ERRORS}/{VERDICTS[verdict][0].replace(' ', '_')}"


class Fault(IntEnum):
    """What is wrong with a return's final label, as an inspected scan shows it."""

    NONE = 0
    OF_THE_SCAN = 1  # Wrong, and the scan by itself had said the same
    OF_THE_BUILDING = 2  # Wrong, and the scan by itself had said something else
    RELABELLED = 3  # Another than the scan's own; which of them is right is not known


FAULT_CLASSES: dict[int, tuple[str, Color]] = {
    Fault.OF_THE_SCAN: ("wrong, as the scan labelled it", (0, 235, 235)),
    Fault.OF_THE_BUILDING: ("wrong, as the building changed it", (255, 180, 205)),
    Fault.RELABELLED: ("changed by the building", (0, 235, 235)),
}
"""Colours that nothing else in the view has."""
AGREEMENTS: dict[int, tuple[str, Color]] = {
    Agreement.NOTHING: ("unknown", (205, 205, 205)),
    Agreement.FREE: ("free", (255, 255, 255)),
    Agreement.BOTH: ("wall in both", (20, 140, 60)),
    Agreement.ONLY_MAP: ("wall only in the map", (240, 50, 50)),
    Agreement.ONLY_REFERENCE: ("wall only in the ground truth", (255, 150, 0)),
    Agreement.NOT_SEEN: ("wall that was not seen", (120, 160, 230)),
}
"""Name and colour of what a map laid over another shows (Fig. 9e)."""
TRUTH_COLOR: Color = (235, 238, 245)

UPMOST_COLOR: Color = (46, 204, 87)
BOTTOMMOST_COLOR: Color = (255, 140, 0)
THRESHOLD_COLOR: Color = (240, 60, 60)
CURVE_COLOR: Color = (84, 112, 160)
EXAMPLE_COLOR: Color = (255, 255, 255)
GROWING_COLOR: Color = (190, 120, 255)
LOST_COLOR: Color = (240, 70, 70)
GAINED_COLOR: Color = (60, 220, 120)
BACKDROP_COLOR: Color = (86, 90, 98)
TRANSITION_COLORS: tuple[Color, ...] = (
    (255, 80, 80), (70, 160, 255), (255, 200, 40), (190, 110, 255),
    (60, 220, 120), (255, 130, 30), (50, 225, 225), (255, 120, 190),
)  # fmt: skip
"""The most frequent changes from one label to another take these in turn."""
OTHER_TRANSITION_COLOR: Color = (170, 170, 170)
RUN_COLORS: tuple[Color, ...] = ((0, 214, 255), (255, 170, 0), (190, 120, 255), (60, 220, 120), (255, 120, 190))
FRAME_COLOR: Color = (70, 74, 82)
TEXT_COLOR: Color = (200, 204, 212)
OWN_BODY_COLOR: Color = (255, 120, 200)
TRAJECTORY_COLOR: Color = (0, 214, 255)
KEYPOINT_COLOR: Color = (255, 196, 0)
WEAK_COLOR: Color = (255, 70, 70)
LOCAL_MAP_COLOR: Color = (96, 110, 130)
LOOP_COLOR: Color = (0, 190, 160)
LOOP_DOUBTED_COLOR: Color = (255, 110, 60)
WAY_OF_ODOMETRY_COLOR: Color = (200, 90, 90)
PASSAGE_COLOR: Color = (214, 40, 40)
TOPOLOGY_COLOR: Color = (150, 0, 190)
VORONOI_COLOR: Color = (54, 120, 255)
FURNITURE_COLOR: Color = (255, 140, 0)

LABEL_LEGEND_ENTRIES: tuple[tuple[str, Color], ...] = (
    ("wall", CLASSES[Label.WALL][1]),
    ("door (its leaf)", CLASSES[Label.DOOR][1]),
    ("floor", CLASSES[Label.FLOOR][1]),
    ("ceiling", CLASSES[Label.CEILING][1]),
    ("clutter (furniture)", CLASSES[Label.CLUTTER][1]),
    ("outside (behind glass)", CLASSES[Label.OUTSIDE][1]),
)
ERROR_LEGEND_ENTRIES: tuple[tuple[str, Color], ...] = (
    ("true wall or door", TRUTH_COLOR),
    *(VERDICTS[verdict] for verdict in (Verdict.FALSE_WALL, Verdict.MISSED_WALL)),
    *(VERDICTS[verdict] for verdict in (Verdict.FALSE_DOOR, Verdict.MISSED_DOOR)),
    ("other wrong label", VERDICTS[Verdict.OTHER][1]),
    ("right point, door not passed", VERDICTS[Verdict.RIGHT][1]),
)

PLANE_COLORS: tuple[Color, ...] = (
    (31, 186, 140), (214, 110, 40), (126, 118, 220), (231, 60, 148),
    (122, 186, 40), (240, 190, 30), (90, 170, 240), (170, 110, 70),
)  # fmt: skip
"""Wall planes take these in turn."""
REFUSED_CANDIDATE_COLOR: Color = (110, 110, 110)
FUSED_WALL_COLOR: Color = (190, 190, 190)
REFUSED_WALL_COLOR: Color = (255, 140, 60)

SERIES: dict[str, tuple[str, Color]] = {
    f"{COUNTS}/lines": ("point lines", (130, 170, 220)),
    f"{COUNTS}/structures": ("vertical structures", BOTTOMMOST_COLOR),
    f"{COUNTS}/candidates": ("wall candidates", UPMOST_COLOR),
    f"{COUNTS}/door_lines": ("lines above a door", CLASSES[Label.DOOR][1]),
    f"{COUNTS}/planes": ("wall planes", UPMOST_COLOR),
    f"{COUNTS}/openings": ("doors in view", CLASSES[Label.DOOR][1]),
    f"{RANGES}/scatter_mm": ("scatter of the ranges, mm", (130, 170, 220)),
    f"{RANGES}/measured_alone_percent": ("returns on no facet, %", (240, 190, 30)),
    f"{MILLISECONDS}/reading": ("reading, ms", (130, 170, 220)),
    f"{MILLISECONDS}/placing": ("placing, ms", (126, 118, 220)),
    f"{MILLISECONDS}/smoothing": ("smoothing, ms", (240, 190, 30)),
    f"{MILLISECONDS}/labelling": ("labelling, ms", UPMOST_COLOR),
    f"{REGISTRATION}/weak": ("registration is weak: 1 yes, 0 no", WEAK_COLOR),
    f"{REGISTRATION}/weakest_share": ("hold of the weakest direction, share of the best one's", KEYPOINT_COLOR),
    f"{REGISTRATION}/refined_inlier_share": ("share of the sweep that fits the map", KEYPOINT_COLOR),
    f"{REGISTRATION}/loops_moved_m": ("moved by closing the loops, m", LOOP_COLOR),
    f"{REGISTRATION}/residual_m": ("median distance to the local map, m", (130, 170, 220)),
    f"{REGISTRATION}/correction_m": ("correction of the predicted pose, m", (130, 170, 220)),
    f"{REGISTRATION}/threshold_m": ("adaptive threshold, m", (130, 170, 220)),
    f"{REGISTRATION}/milliseconds": ("registering, ms", (130, 170, 220)),
}
"""Name with its unit, and colour, of each curve that a layout shows beside those by label and by error."""


class Legend:
    """Where the entries of a legend are drawn, in units of its 2-D view: side by side, the name below its dot."""

    STEP = 120.0
    DOT_UI = 8.0
    NAMES_BELOW = 6.0
    ABOVE, BELOW = 9.0, 24.0


class CurveSheet:
    """Where the difference curves are drawn, to the right and downwards.

    On top one line's curve as in Fig. 5b; below it one small cell for every line: first the lines of side 0, pair by
    pair, then those of side 1. scale: width of a sample in a cell; less than 1 where there are more lines than of 32 emitters.
    """

    SAMPLES = 200
    FEWEST_COLUMNS = 8
    GAP_X = 24
    GAP_Y = 12
    SIDE_GAP = 130
    LIMIT = 4.0  # Differences beyond ±4 are drawn at ±4
    WIDTH = FEWEST_COLUMNS * (SAMPLES + GAP_X) - GAP_X
    EXAMPLE_HEIGHT = 420
    TITLE_HEIGHT = 72

    def __init__(self, line_pairs: int) -> None:
        self.line_pairs = line_pairs
        # Of all the cells together, the sheet is about as wide as it is high.
        self.columns = max(self.FEWEST_COLUMNS, round(1.5 * float(np.sqrt(line_pairs))))
        self.rows = -(-line_pairs // self.columns)
        self.scale = self.WIDTH / (self.columns * (self.SAMPLES + self.GAP_X) - self.GAP_X)
        self.cell_width = self.SAMPLES * self.scale
        self.cell_height = 80 * self.scale

    @property
    def height(self) -> float:
        """From the top of the large curve to the foot of the last cell."""
        return self.side_top(2) - self.SIDE_GAP

    @property
    def cells(self) -> FloatArray:
        """(2n, 2) left end and middle height of each line's cell."""
        pair, side = np.divmod(np.arange(2 * self.line_pairs), 2)
        row, column = np.divmod(pair, self.columns)
        x = column * (self.SAMPLES + self.GAP_X) * self.scale
        y = self.side_top(0) + side * (self.side_top(1) - self.side_top(0)) + row * self._row_height
        return np.column_stack([x, y + self.cell_height / 2]).astype(np.float32)

    def side_top(self, side: int) -> float:
        """Where the first row of a side begins."""
        return self.EXAMPLE_HEIGHT + self.SIDE_GAP + side * (self.rows * self._row_height + self.SIDE_GAP)

    @property
    def _row_height(self) -> float:
        return self.cell_height + self.GAP_Y * self.scale


_README = """# {bag}

Every intermediate of *Furniture Free Mapping using 3D Lidars* (He, Hou, Schwertfeger), scan by scan.

**{tasks}** {lidars}

## What the tabs show
| tab | what to look at |
|---|---|
| **At a glance** | the labelled scan; its point lines and wall planes; eq. 2 along every line with its threshold; \
the map, growing up to the time cursor; the furniture-free grid |
| **Step by step** | Fig. 3 (no floor, no ceiling), 5a (point lines), 6 (up-most and bottom-most structures), \
7 (wall planes), the door conditions |
| **Building** | the fused cloud, walls, doors (blue: closed ones filled, open ones as frames), windows \
(magenta), and the grid; they hold for the whole run |
| **Maps** | the furniture-free grid beside the maps that the paper compares with (Fig. 6, 9) |
| **Rooms** | the rooms of the grid with their areas, those of the normal map with and without alpha removal (Fig. 10), \
which one leads to which, and the Voronoi graph they are cut from |
| **Odometry** | what was registered of each sweep, and the submaps that were joined where the robot came by again: \
loops (teal; orange where they contradict the others), the way before they were closed (red) |
| **Metrics and warnings** | returns by label, evidence counted, noise of the ranges, milliseconds by stage, \
scans that were skipped |
| **Evaluation** | where the truth is known and `evaluation.rrd` is open too: what is wrong, where, and the figures |

## Colours
| class | {class_names} |
|---|{class_rules}
| colour | {class_colors} |

Point lines: green in a wall plane, blue above a door, orange where the candidate was refused, gray without a vertical
structure. Wall planes have colours of their own, in turn.

## Timelines
`scan` is the index of the vertical cloud in the bag, skipped ones counted; `stamp` is the time in the cloud's header. Clouds of
several vertical lidars are counted together, in the order of their stamps; `/scan/lidar` then tells which one a scan is from.
What was registered of a horizontal sweep has the `scan` of the first vertical cloud that is not older, or of the last one.

## Frames
`/world` is the map: z up, its origin on the floor below the robot at the start. `/scan` is level, with its origin below
the robot and x ahead; its transform places it in the map.

## Where the values are
`/scan/points` are where their neighbours on the same ring show the surface; those that are `measured_alone` lie on no
surface that neighbours show, and stay. They have `label_scan`, the label by this scan alone, and `class_ids`, the final
one; `/scan/relabelled` holds those where they differ, with the `reason` why and the distance to the nearest wall's face
(`ffmap inspect` counts them in words). `/scan/structures` has `difference`, eq. 2 as printed, and `slope`,
the one over a longer span that decides: one row a line (2 × pair + side) of 200 samples from below upwards; and each
structure's line, first and last sample. Planes, candidates and doors carry their parameters beside what is drawn.
Wall candidates and door conditions carry the reason why each was taken or refused: rest the pointer on one.

The codes of `reason`: {reasons}.

## This run
{run}
"""

_GLANCE_SCANS = """**One scan of the vertical lidar, and the map up to it.** Drag the time cursor at the foot of the \
window to see others. Upper left: every return in the colour of its label. Below: how walls are told. Right: what all scans \
give together."""
_GLANCE_MAP = """**The building that all scans give together**: its cloud, walls, doors and windows, the grid map, and why \
each door is one. Single scans were not recorded (`--detail lines` does)."""
_GLANCE_POSES = """**The way of the lidar, and how well each sweep was registered.** Nothing was labelled: no lidar sweeps \
the walls. Drag the time cursor at the foot of the window to see other sweeps."""


def glance(labelled: bool, scans: bool) -> str:
    """What the first tab shows, in Markdown; labelled: whether anything was, scans: whether single ones are recorded."""
    shown = _GLANCE_POSES if not labelled else _GLANCE_SCANS if scans else _GLANCE_MAP
    return f"{shown} All tabs, colours and values are explained in the last tab, **Read me**."


EVALUATION_HELP_TEXT = """# Against the truth
The two tabs beside this one, **Figures** and **What is wrong, and where**, are empty where `recording.rrd` alone is open.
What they show is in `evaluation.rrd` beside it: open both files, or `ffmap view RUN`, which does so.

`ffmap run` writes that file if the bag carries the truth, and `ffmap evaluate RUN` does so later; `--truth FILE` takes the
truth from elsewhere. Real buildings usually have none.
"""

_COUNTS = {0: "Two", 1: "Two", 2: "Two", 3: "Three", 4: "Four", 5: "Five", 6: "Six"}
"""In words; of a run that does not tell its lidars, and of one whose bag lacks one, there are two."""
_COLOR_WORDS = ("yellow", "gray", "red", "green", "blue", "magenta")


def explain(record: Mapping[str, Any]) -> str:
    """The recording explained to a stranger, in Markdown.

    record: what `run.json` holds at the start; what is missing there is left out.
    """
    rig = record.get("rig", {})
    count = len({lidar["topic"] for lidar in rig.values()})
    lidars = [
        f"The {role.replace('_', ' ')} one, `{lidar['topic']}`, "
        f"{'gives the poses' if role == 'horizontal' else 'sweeps walls and ceiling and is labelled'}."
        for role, lidar in rig.items()
    ]
    facts = {
        "bag": record.get("bag", {}).get("path"),
        "further parts": " ".join((record.get("bag", {}).get("parts") or [])[1:]),
        "digest": record.get("bag", {}).get("digest"),
        "mounts from": record.get("mounts_from"),
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
        tasks="One lidar, both tasks." if count == 1 and len(rig) == 2 else f"{_COUNTS.get(count, count)} lidars, two tasks.",
        lidars=" ".join(lidars) or "The horizontal one gives the poses, the vertical one is labelled.",
        class_names=" | ".join(CLASSES[label][0] for label in Label),
        class_rules="---|" * len(Label),
        class_colors=" | ".join(_COLOR_WORDS),
        reasons="; ".join(f"{code} {words}" for code, words in REASONS.items() if code),
        run="\n".join(run),
    )
