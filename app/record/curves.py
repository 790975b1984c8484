"""The difference curves of eq. 2, drawn for every line, and one line drawn large (paper, Fig. 5b)."""

import numpy as np
import rerun as rr

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.vertical_structures import VerticalStructures
from ffmap.app.record.log import Log, arrays
from ffmap.app.record.shapes import rounded, ui_radius, unbroken, words
from ffmap.blueprints import entities
from ffmap.blueprints.entities import CurveSheet

FLOAT16_MAX = 65504.0
_CURVE_STEP = 2
"""The small curves are drawn through every second sample, for a recording holds those of every scan."""
_CURVE_STYLES: tuple[tuple[str, float, entities.Color], ...] = (
    (entities.CURVE_DIFFERENCES, 0.5, entities.CURVE_COLOR),
    (entities.CURVE_UPMOST, 1.5, entities.UPMOST_COLOR),
    (entities.CURVE_BOTTOMMOST, 1.5, entities.BOTTOMMOST_COLOR),
    (entities.CURVE_EXAMPLE, 1.0, entities.CURVE_COLOR),
    (entities.CURVE_EXAMPLE_SLOPE, 1.0, entities.EXAMPLE_COLOR),
)


def log_curve_sheet(log: Log, sheet: CurveSheet, slope_max: float) -> None:
    """Frames, thresholds, titles and styles, which never change."""
    cells = sheet.cells
    half = sheet.cell_height / 2
    large = [[0, 0, sheet.WIDTH, sheet.EXAMPLE_HEIGHT]]
    small = np.column_stack([cells - [0, half], np.full((len(cells), 2), [sheet.cell_width, sheet.cell_height])])
    boxes = np.concatenate([large, small])
    frames = rr.Boxes2D(
        array=boxes, array_format=rr.Box2DFormat.XYWH, colors=entities.FRAME_COLOR, radii=ui_radius(0.5)
    )
    log.static(entities.CURVE_FRAMES, frames)
    middles = np.concatenate([[[0, sheet.EXAMPLE_HEIGHT / 2]], cells])
    reach = slope_max / sheet.LIMIT * np.array([sheet.EXAMPLE_HEIGHT / 2] + [half] * len(cells))
    thresholds = np.empty((2, len(middles), 2, 2), np.float32)
    thresholds[..., 0, 0], thresholds[..., 1, 0] = middles[:, 0], middles[:, 0] + boxes[:, 2]
    thresholds[0, ..., 1], thresholds[1, ..., 1] = (middles[:, 1:] + sign * reach[:, None] for sign in (-1, 1))
    log.static(
        entities.CURVE_THRESHOLDS,
        rr.LineStrips2D(
            thresholds.reshape(-1, 2, 2),
            colors=entities.THRESHOLD_COLOR,
            radii=np.tile([ui_radius(1.25)] + [ui_radius(0.5)] * len(cells), 2),
            draw_order=40.0,
        ),
    )
    titles = {
        0.0: f"One line, foot left, top right: eq. 2 blue, slope that decides white, threshold ±{slope_max:g} red",
        sheet.side_top(0): f"Side 0, pairs 0 to {sheet.line_pairs - 1}, each from -{sheet.LIMIT:g} to {sheet.LIMIT:g}; "
        "up-most green, bottom-most orange",
        sheet.side_top(1): f"Side 1, pairs 0 to {sheet.line_pairs - 1}",
    }
    tops = list(titles) if sheet.line_pairs else [0.0]
    places = [(sheet.WIDTH / 2, top - sheet.TITLE_HEIGHT) for top in tops]
    log.static(entities.CURVE_TEXTS, words(places, [titles[top] for top in tops]))
    for path, radius_ui, color in _CURVE_STYLES:
        # The thresholds lie on the curves of eq. 2, the rest on both.
        order = 30.0 if color == entities.CURVE_COLOR else 50.0
        log.static(path, rr.LineStrips2D.from_fields(radii=ui_radius(radius_ui), colors=color, draw_order=order))
    log.static(entities.CURVE_EXAMPLE_TEXTS, rr.Points2D.from_fields(show_labels=True, radii=0.0))
    log.static(entities.CURVE_EXAMPLE_STRUCTURES, rr.Boxes2D.from_fields(radii=ui_radius(1.5)))


def log_curves(log: Log, labelling: ScanLabelling, line_pairs: int | None = None) -> None:
    """Eq. 2 for every line: its values, the deciding slope's, and both drawn.

    line_pairs: for how many pairs the sheet has cells, those of the lidar with most; None for as many as the scan has.
    """
    structures, samples = labelling.structures, labelling.lines.samples
    # Not as tensors, whose union type few readers of tables know.
    kept = "line", "first", "last", "bottom_m", "top_m", "upmost", "bottommost"
    curves_of_lines = {"difference": _float16(structures.difference), "slope": _float16(structures.slope)}
    log.row(entities.STRUCTURES, evidence=arrays(structures, *kept, **curves_of_lines))
    sheet = CurveSheet(len(samples) // 2 if line_pairs is None else line_pairs)
    cells = sheet.cells
    present = np.flatnonzero(samples[:, 0] >= 0)
    shown = np.arange(0, sheet.SAMPLES, _CURVE_STEP)
    curves = np.empty((len(present), len(shown), 2), np.float32)
    curves[..., 0] = cells[present, :1] + sheet.scale * shown
    scale = sheet.cell_height / 2 / sheet.LIMIT
    drawn = _clamped(structures.difference[present][:, shown], sheet.LIMIT)
    curves[..., 1] = np.rint(cells[present, 1:] - scale * drawn)
    log.row(entities.CURVE_DIFFERENCES, rr.LineStrips2D, strips=curves)
    for path, chosen, offset in (
        (entities.CURVE_UPMOST, structures.upmost, sheet.cell_height * 0.36),
        (entities.CURVE_BOTTOMMOST, structures.bottommost, sheet.cell_height * 0.46),
    ):
        own = chosen[chosen >= 0]
        line = structures.line[own]
        bars = np.empty((len(own), 2, 2), np.float32)
        bars[:, 0, 0] = cells[line, 0] + sheet.scale * structures.first[own]
        bars[:, 1, 0] = cells[line, 0] + sheet.scale * structures.last[own]
        bars[..., 1] = cells[line, 1:] + offset
        log.row(path, rr.LineStrips2D, strips=bars)


def log_line(log: Log, points_level: FloatArray, labelling: ScanLabelling, line: int) -> None:
    """One line drawn large, in space and with its curve as in Fig. 5b, at the time that is set."""
    structures, sheet = labelling.structures, CurveSheet(len(labelling.lines) // 2)
    present = labelling.lines.samples[line, 0] >= 0
    strips, _ = unbroken(rounded(points_level[labelling.lines.samples[[line] if present else []]]))
    log.row(entities.EXAMPLE_LINE, rr.LineStrips3D, strips=strips)
    middle, scale = sheet.EXAMPLE_HEIGHT / 2, sheet.EXAMPLE_HEIGHT / 2 / sheet.LIMIT
    step = sheet.WIDTH / (sheet.SAMPLES - 1)
    x = np.arange(sheet.SAMPLES) * step
    for path, values in (
        (entities.CURVE_EXAMPLE, structures.difference),
        (entities.CURVE_EXAMPLE_SLOPE, structures.slope),
    ):
        y = middle - scale * _clamped(values[line], sheet.LIMIT)
        curve = np.stack([x, y], axis=1, dtype=np.float32)[None]
        log.row(path, rr.LineStrips2D, strips=curve if present else curve[:0])
    _log_structures_of(log, structures, line, step)


def _log_structures_of(log: Log, structures: VerticalStructures, line: int, step: float) -> None:
    """The runs of a line that eq. 2 found, as boxes behind its curve; the up-most and the bottom-most named."""
    sheet = CurveSheet
    own = np.flatnonzero(structures.line == line)
    half_sizes = np.full((len(own), 2), sheet.EXAMPLE_HEIGHT / 2, np.float32)
    half_sizes[:, 0] = (structures.last[own] - structures.first[own]) * step / 2
    centers = half_sizes.copy()
    centers[:, 0] += structures.first[own] * step
    upmost, bottommost = structures.upmost[line], structures.bottommost[line]
    colors = np.full((len(own), 3), entities.FRAME_COLOR, np.uint8)
    colors[own == bottommost] = entities.BOTTOMMOST_COLOR
    colors[own == upmost] = entities.UPMOST_COLOR
    evidence = {"line": np.array([line]), "first": structures.first[own], "last": structures.last[own]}
    log.row(
        entities.CURVE_EXAMPLE_STRUCTURES,
        rr.Boxes2D,
        evidence,
        half_sizes=half_sizes,
        centers=centers,
        colors=colors,
    )
    # At heights of their own, and away from the ends: else they would hide one another, or be cut.
    named = [(upmost, "up-most: wall candidate", entities.UPMOST_COLOR, 0.58)] if upmost >= 0 else []
    if bottommost != upmost:
        named.append((bottommost, "bottom-most", entities.BOTTOMMOST_COLOR, 0.8))

    def middle(structure: int) -> float:
        x = (structures.first[structure] + structures.last[structure]) / 2 * step
        return float(np.clip(x, 0.15 * sheet.WIDTH, 0.85 * sheet.WIDTH))

    places = [(middle(s), height * sheet.EXAMPLE_HEIGHT) for s, _, _, height in named]
    log.row(
        entities.CURVE_EXAMPLE_TEXTS,
        rr.Points2D,
        positions=np.array(places, np.float32).reshape(-1, 2),
        labels=[name for _, name, _, _ in named],
        colors=np.array([color for _, _, color, _ in named], np.uint8).reshape(-1, 3),
    )


def _float16(values: FloatArray) -> FloatArray:
    return np.clip(values, -FLOAT16_MAX, FLOAT16_MAX).astype(np.float16)


def _clamped(values: FloatArray, limit: float) -> FloatArray:
    """For drawing: equal heights, where eq. 2 has no value, are as steep as it gets."""
    return np.where(np.isnan(values), np.float32(limit), np.clip(values, -limit, limit))
