"""A comparison in one recording: the runs below their letters, and what differs in the map."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.truth.changes import (
    CLASSES,
    TRANSITIONS,
    Became,
    Changes,
    LabelChange,
    most_frequent,
    name_transition,
)
from ffmap.app.record.building import log_grid
from ffmap.app.record.log import Log, evidence, times
from ffmap.app.record.read_back import chunk_stream
from ffmap.app.record.shapes import annotations, at_height, strips, ui_radius
from ffmap.blueprints import entities
from ffmap.loaders.geojson import segments

_LIFT_M = 0.05
"""Height (m) of what changed above the map, which would hide it."""
_NEUTRAL = (140, 140, 140)
"""Colour of curves, visible on dark and on light backgrounds."""
_COLORS = {
    "lost": (240, 70, 70),
    "gained": (60, 220, 120),
    "altered": entities.KEYPOINT_COLOR,
}
_RUN_COLORS: tuple[entities.Color, ...] = (
    *((0, 214, 255), (255, 170, 0), (190, 120, 255), (60, 220, 120), (255, 120, 190)),
)
_TRANSITION_COLORS: tuple[entities.Color, ...] = (
    *((255, 80, 80), (70, 160, 255), (255, 200, 40), (190, 110, 255)),
    *((60, 220, 120), (255, 130, 30), (50, 225, 225), (255, 120, 190)),
)
"""The most frequent changes from one label to another take these in turn."""
_OTHER_TRANSITION_COLOR: entities.Color = (170, 170, 170)
_MAP = (
    "/",
    "/world",
    entities.TRAJECTORY,
    "/world/base/**",
    "/world/map/**",
    "/world/building/**",
    "/metrics/labels/**",
    "/metrics/counts/**",
    "/metrics/milliseconds/**",
    "/messages",
)
_SCANS = (
    "/scan",
    entities.POINTS,
    entities.PLANES,
    "/scan/candidates/upmost",
    "/scan/doors/**",
    "/scan/floor",
    "/scan/ceiling",
)


def write_rerooted(source: Path, letter: str, out: Path, recording_id: str, scans: bool) -> bool:
    """Write a run's recording below its letter; return whether it has anything to show.

    scans: with single scans, without the lines and curves of each.
    """
    passed = 0

    def rerooted(chunk: Any) -> Any:  # noqa: ANN401 - Rerun's own type
        nonlocal passed
        passed += 1
        return chunk.with_entity_path(f"/{letter}{chunk.entity_path.rstrip('/')}")

    wanted = chunk_stream(source).filter(content=[*_MAP, *(_SCANS if scans else ())])
    moved = wanted.map(rerooted)
    moved.write_rrd(out, application_id=entities.APPLICATION_ID, recording_id=recording_id)
    return passed > 0


def log_changed_points(
    log: Log, letter: str, points_map: FloatArray, before: UInt8Array, after: UInt8Array
) -> None:
    """Log the points (c, 3) of a scan whose labels differ, with their classes (c,) in both runs."""
    log.row(
        f"/changes/{letter}/points",
        rr.Points3D,
        evidence(before=before, after=after),
        positions=points_map,
        class_ids=CLASSES * before + after,
    )


def log_common(log: Log, text: str, colors: Mapping[int, entities.Color]) -> None:
    """Log the description of all runs, and the colours of transitions."""
    log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    log.text("/changes/runs", text)
    rest = _OTHER_TRANSITION_COLOR
    classes = {code: (name_transition(code), colors.get(code, rest)) for code in range(TRANSITIONS)}
    log.static("/changes", annotations(classes))


def transition_colors(changes: Sequence[Changes]) -> dict[int, entities.Color]:
    """Return the colours of the most frequent transitions, alike in all comparisons."""
    counts = [change.labels.counts.sum(axis=0) for change in changes if change.labels is not None]
    frequent = most_frequent(counts, len(_TRANSITION_COLORS))
    return dict(zip(frequent, _TRANSITION_COLORS, strict=False))


def log_run(
    log: Log, letter: str, number: int, path_m: FloatArray | None, grid: GridMap | None
) -> None:
    """Log a run's trajectory (n, 3) and map for the views from above."""
    if path_m is not None:
        color = _RUN_COLORS[number % len(_RUN_COLORS)]
        drawn = strips([path_m.astype(np.float32)], color, 1.5, letter)
        log.static(f"/paths/{letter}", drawn)
    if grid is not None:
        log_grid(log, letter, grid)


def log_change(
    log: Log,
    letter: str,
    change: Changes,
    text: str,
    scan_of: Mapping[int, int],
    colors: Mapping[int, entities.Color],
) -> None:
    """Log what differs between the first run and the one of this letter.

    scan_of: number of the scan at each time stamp. colors: see `transition_colors`.
    """
    log.text(f"/changes/{letter}/text", text)
    if change.labels is not None:
        _log_labels(log, letter, change.labels, colors)
    if change.poses is not None:
        _log_poses(log, letter, *change.poses, scan_of)
    for name, places in (("lost", change.lost), ("gained", change.gained)):
        color = _COLORS[name]
        if (walls := places.get("walls")) is not None and len(walls):
            drawn = strips(at_height(walls, _LIFT_M), color, 5.0)
            log.static(f"/changes/{letter}/building/walls/{name}", drawn)
        if (cells := places.get("cells")) is not None and len(cells):
            centres = at_height(cells, 0.5 * _LIFT_M)
            drawn_cells = rr.Points3D(centres, colors=color, radii=ui_radius(2.0))
            log.static(f"/changes/{letter}/building/cells/{name}", drawn_cells)
    for name, doors in change.doors.items():
        if doors:
            features, words = zip(*doors, strict=True)
            sills = at_height(segments(features), _LIFT_M)
            drawn = strips(sills, _COLORS[name], 7.0, list(words))
            log.static(f"/changes/{letter}/building/doors/{name}", drawn)


def _log_labels(
    log: Log, letter: str, labels: LabelChange, colors: Mapping[int, entities.Color]
) -> None:
    """Changed points over the map, and percentages of changed labels over the scans.

    With ground truth, also the points that became right and wrong.
    """
    radius = ui_radius(2.5)
    log.static(f"/changes/{letter}/points", rr.Points3D.from_fields(radii=radius))
    places, codes = labels.voxels.mean_position.astype(np.float32), labels.voxels.label
    drawn = rr.Points3D(places, class_ids=codes, radii=radius)
    log.static(f"/changes/{letter}/cubes", drawn)
    indexes = times(labels.stamp_ns, labels.scan)
    percent = 100.0 / np.maximum(labels.points, 1)
    counts = labels.counts.reshape(len(labels.scan), -1)
    path = f"/changes/{letter}/percent"
    curves = [
        (f"{path}/{rank}", counts[:, code], name_transition(code), color)
        for rank, (code, color) in enumerate(colors.items())
    ]
    curves.append((f"{path}/all", labels.changed, "all", _NEUTRAL))
    path = f"/changes/{letter}/percent_of_single_scans"
    curves.append((f"{path}/all", labels.changed_scan, "label_scan", _NEUTRAL))
    if labels.judged is not None:
        voxels = labels.judged_voxels
        for kind, color in ((Became.RIGHT, _COLORS["gained"]), (Became.WRONG, _COLORS["lost"])):
            name = f"became {kind.name.lower()}"
            places = voxels.mean_position[voxels.label == kind].astype(np.float32)
            drawn = rr.Points3D(places, colors=color, radii=radius)
            log.static(f"/changes/{letter}/{name.replace(' ', '_')}", drawn)
            path = f"/changes/{letter}/percent_judged/{kind.name.lower()}"
            curves.append((path, labels.judged[:, :, kind].sum(axis=1), name, color))
    for path, values, name, color in curves:
        log.curve_style(path, name, color)
        log.curve(path, indexes, percent * values)


def _log_poses(
    log: Log,
    letter: str,
    stamp_ns: IntArray,
    distance_m: FloatArray,
    aligned_m: FloatArray,
    scan_of: Mapping[int, int],
) -> None:
    known = np.array([stamp in scan_of for stamp in stamp_ns.tolist()], bool)
    if not known.any():
        return
    indexes = times(stamp_ns[known], [scan_of[stamp] for stamp in stamp_ns[known].tolist()])
    path = f"/changes/{letter}/pose_distance_m"
    for name, values, color in (
        ("in the map", distance_m, _NEUTRAL),
        ("aligned", aligned_m, _RUN_COLORS[0]),
    ):
        curve = f"{path}/{name.replace(' ', '_')}"
        log.curve_style(curve, name, color)
        # Less than a micrometre is a rounding error.
        log.curve(curve, indexes, np.round(values[known], 6))
