"""The forward differences of eq. 2: of all lines as an image, of one line as a curve (Fig. 5b).

All are drawn on one sheet, with y downwards, as `blueprints.views.differences` shows it: the
curve above y = 0, and below it two images with a column for each point line and a row for each
sample.
"""

from itertools import pairwise

import numpy as np
import rerun as rr

from ffmap.algorithms.base.scan import BoolArray, FloatArray, UInt8Array
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.vertical_structures import VerticalStructures
from ffmap.app.record.log import Log, evidence
from ffmap.app.record.shapes import (
    TEXT_COLOR,
    annotations,
    strip_style_2d,
    strips_2d,
    ui_radius,
    words,
)
from ffmap.blueprints.entities import BOTTOMMOST_COLOR, SELECTED_COLOR, UPMOST_COLOR, Color

_WIDTH, _IMAGE_WIDTH, _GAP = 640.0, 305.0, 30.0
_MIDDLE, _HALF = -100.0, 64.0
"""Where the curve is zero, and half the height of its frame."""
_LIMIT = 4.0
"""Differences beyond ±4 times the threshold are drawn at ±4 times the threshold."""
_FRAME_COLOR: Color = (70, 74, 82)
_THRESHOLD_COLOR: Color = (240, 60, 60)
_CURVE_COLOR: Color = (110, 150, 225)

_BOUNDS = (-4.0, -3.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 3.0, 4.0)
"""Between the colours of differences, in units of the threshold."""
_SCALE: tuple[Color, ...] = (
    *((90, 30, 140), (105, 60, 200), (85, 105, 235), (115, 165, 250)),
    *((10, 85, 60), (20, 120, 80), (40, 150, 95), (80, 180, 120)),
    *((250, 215, 70), (250, 160, 40), (240, 100, 40), (190, 25, 40)),
)
"""Green: upright, within the threshold. Blue: nearer with height; yellow to red: farther."""
_SHADES = 1 + np.searchsorted(_BOUNDS, np.arange(-9, 9) / 2.0, "right").astype(np.uint8)
"""Colours of differences in steps of half a threshold: every bound is at one."""
_NO_SAMPLE: Color = (30, 32, 36)
_STRUCTURES: dict[int, tuple[str, Color]] = {
    0: ("no structure", _NO_SAMPLE),
    1: ("structure between the others", (105, 110, 120)),
    2: ("bottom-most structure", BOTTOMMOST_COLOR),
    3: ("up-most structure: wall candidate", UPMOST_COLOR),
}
_FLOAT16_MAX = 65504.0


def log_curve_styles(log: Log, slope_max: float) -> None:
    """Log the constant data of all scans: colours, frames, thresholds, titles.

    slope_max: the threshold of eq. 2.
    """
    bounds = [f"{slope_max * bound:g}" for bound in _BOUNDS]
    ranges = [f"below {bounds[0]}", *(f"{a} to {b}" for a, b in pairwise(bounds))]
    names = ["no sample", *ranges, f"above {bounds[-1]}, or equal heights"]
    colors = (_NO_SAMPLE, *_SCALE)
    classes = {k: (name, color) for k, (name, color) in enumerate(zip(names, colors, strict=True))}
    opaque = rr.SegmentationImage.from_fields(opacity=1.0)
    log.static("/scan/differences/of_lines", annotations(classes), opaque)
    log.static("/scan/differences/structures", annotations(_STRUCTURES), opaque)
    x = np.linspace(0.0, _IMAGE_WIDTH, len(_SCALE) + 1)
    steps = np.stack([x[:-1], x[1:]], axis=1)
    bar = np.stack([steps, np.full_like(steps, 214.0)], axis=2).astype(np.float32)
    log.static(
        "/scan/differences/scale",
        rr.LineStrips2D(bar, colors=_SCALE, radii=5.0, draw_order=20.0),
    )
    shown = [_BOUNDS.index(bound) for bound in (-4.0, -1.0, 0.0, 1.0, 4.0)]
    ticks = [(x[k + 1], 224.0) for k in shown]
    log.static("/scan/differences/scale/values", words(ticks, [bounds[k] for k in shown]))
    top, foot = _MIDDLE - _HALF, _MIDDLE + _HALF
    frame = [[(0, top), (_WIDTH, top), (_WIDTH, foot), (0, foot), (0, top)]]
    log.static("/scan/differences/frame", strips_2d(frame, _FRAME_COLOR, 0.5, 10.0))
    levels = [_MIDDLE - sign * _HALF / _LIMIT for sign in (-1, 1)]
    thresholds = [[(0, y), (_WIDTH, y)] for y in levels]
    log.static("/scan/differences/threshold", strips_2d(thresholds, _THRESHOLD_COLOR, 1.25, 40.0))
    limits = [(-16.0, levels[1]), (-16.0, levels[0])]
    names = [f"+{slope_max:g}", f"−{slope_max:g}"]
    log.static("/scan/differences/threshold/values", words(limits, names, _THRESHOLD_COLOR))
    for path, color, radius, order in (
        ("/scan/differences/curve", _CURVE_COLOR, 1.0, 30.0),
        ("/scan/differences/curve/slope", SELECTED_COLOR, 1.0, 50.0),
        ("/scan/differences/curve/column", SELECTED_COLOR, 1.5, 60.0),
    ):
        log.static(path, strip_style_2d(color, radius, order))
    log.static("/scan/differences/curve/structures", rr.Boxes2D.from_fields(radii=ui_radius(1.5)))
    name = rr.Points2D.from_fields(
        positions=[(120.0, foot - 26.0)], radii=0.0, colors=TEXT_COLOR, show_labels=True
    )
    log.static("/scan/differences/curve/name", name)
    titles = {
        (_WIDTH / 2, top - 26.0): "one line, foot left: eq. 2 blue, deciding slope violet",
        (_IMAGE_WIDTH / 2, -22.0): "all lines: eq. 2",
        (_WIDTH - _IMAGE_WIDTH / 2, -22.0): "up-most green, lowest orange",
    }
    log.static("/scan/differences/titles", words(list(titles), list(titles.values())))


def log_differences(log: Log, labelling: ScanLabelling) -> None:
    """Log the differences and the structures of all lines: values, and both as images."""
    structures, slope_max = labelling.structures, labelling.settings.vertical_structures.slope_max
    # Not as tensors: few readers of tables know their union type.
    curves = {name: _float16(getattr(structures, name)) for name in ("difference", "slope")}
    kept = "line", "first", "last", "bottom_m", "top_m", "upmost", "bottommost"
    log.row("/scan/structures", None, evidence(structures, *kept, **curves))
    present = labelling.lines.samples[:, 0] >= 0
    count, samples = structures.difference.shape
    image_format = rr.components.ImageFormat(count, samples, channel_datatype="U8")
    width = _IMAGE_WIDTH / max(count, 1)
    left = 0.0
    for path, classes in (
        ("/scan/differences/of_lines", _shaded(structures.difference / slope_max, present)),
        ("/scan/differences/structures", _roles(structures)),
    ):
        image = classes.T[::-1, _columns(count)]
        log.row(path, rr.SegmentationImage, buffer=[image.tobytes()], format=[image_format])
        log.row(path, rr.Transform3D, translation=[[left, 0.0, 0.0]], scale=[[width, 1.0, 1.0]])
        left = _IMAGE_WIDTH + _GAP


def log_line(log: Log, labelling: ScanLabelling, line: int) -> None:
    """Log the curve of one line (Fig. 5b), its structures, and where it is in the images."""
    structures, slope_max = labelling.structures, labelling.settings.vertical_structures.slope_max
    present = labelling.lines.samples[line, 0] >= 0
    step = _WIDTH / (structures.difference.shape[1] - 1)
    for path, values in (
        ("/scan/differences/curve", structures.difference),
        ("/scan/differences/curve/slope", structures.slope),
    ):
        # Equal heights, where eq. 2 has no value, are as steep as possible.
        drawn = np.clip(np.nan_to_num(values[line] / slope_max, nan=_LIMIT), -_LIMIT, _LIMIT)
        curve = np.column_stack([step * np.arange(len(drawn)), _MIDDLE - _HALF / _LIMIT * drawn])
        log.row(path, rr.LineStrips2D, strips=curve[None].astype(np.float32)[: int(present)])
    own = np.flatnonzero(structures.line == line)
    first, last = structures.first[own], structures.last[own]
    colors = np.full((len(own), 3), _FRAME_COLOR, np.uint8)
    colors[own == structures.bottommost[line]] = BOTTOMMOST_COLOR
    colors[own == structures.upmost[line]] = UPMOST_COLOR
    log.row(
        "/scan/differences/curve/structures",
        rr.Boxes2D,
        evidence(line=np.array([line]), first=first, last=last),
        half_sizes=np.column_stack([(last - first) * step / 2, np.full(len(own), _HALF)]),
        centers=np.column_stack([(last + first) * step / 2, np.full(len(own), _MIDDLE)]),
        colors=colors,
    )
    count = len(labelling.lines)
    x = _IMAGE_WIDTH / count * (0.5 + int(np.flatnonzero(_columns(count) == line)[0]))
    marks = [[(x + left, 201.0), (x + left, 206.0)] for left in (0.0, _IMAGE_WIDTH + _GAP)]
    log.row("/scan/differences/curve/column", rr.LineStrips2D, strips=np.array(marks, np.float32))
    name = f"line {line} (pair {line // 2}, side {line % 2})"
    log.row("/scan/differences/curve/name", rr.Points2D, labels=[name])


def _columns(lines: int) -> np.ndarray:
    """Return the line of each column: those of side 0, then those of side 1."""
    return np.concatenate([np.arange(0, lines, 2), np.arange(1, lines, 2)])


def _shaded(difference: FloatArray, present: BoolArray) -> UInt8Array:
    """Return the class of each difference (L, n), in units of the threshold."""
    steep = np.nan_to_num(difference, nan=np.inf)
    halves = np.clip(np.floor(2.0 * steep), -9, 8).astype(np.intp)
    return np.where(present[:, None], _SHADES[halves + 9], 0)


def _roles(structures: VerticalStructures) -> UInt8Array:
    """Return the class of each sample (L, n), see `_STRUCTURES`."""
    roles = np.zeros(structures.difference.shape, np.uint8)
    for s, (line, first, last) in enumerate(
        zip(structures.line, structures.first, structures.last, strict=True)
    ):
        role = 3 if s == structures.upmost[line] else 2 if s == structures.bottommost[line] else 1
        roles[line, first : last + 1] = role
    return roles


def _float16(values: FloatArray) -> FloatArray:
    return np.clip(values, -_FLOAT16_MAX, _FLOAT16_MAX).astype(np.float16)
