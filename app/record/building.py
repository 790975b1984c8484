"""The building: wall faces, doors, windows, level surfaces, grid maps, and the fused cloud."""

from collections.abc import Iterable, Sequence
from itertools import groupby

import numpy as np
import rerun as rr

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m, moved
from ffmap.algorithms.building.evidence import BEYOND
from ffmap.algorithms.building.face_foreground import covered_places
from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.heights import HeightMap
from ffmap.algorithms.building.model import CELL_M, Doors, Walls
from ffmap.algorithms.building.settle import ParsedFaces
from ffmap.algorithms.building.verdicts import JudgedFaces
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.record.building_reasons import (
    REFUSALS,
    building_document,
    reasons,
    short_reasons,
    words,
)
from ffmap.app.record.log import Evidence, Log, evidence
from ffmap.app.record.shapes import (
    at_height,
    panel_mesh,
    rounded,
    strips,
    ui_radius,
    upright_frames,
    upright_quads,
)
from ffmap.app.record.wall_panels import wall_panels
from ffmap.blueprints.entities import (
    CLASSES,
    DOOR_COLOR,
    FACES,
    GRID,
    LAYER_COLORS,
    MAP_POINTS,
    REASONS,
    WALL_COLOR,
    WALLS,
    Color,
)

_MAP_RADIUS = ui_radius(1.25)
_FUSED_COLOR: Color = (190, 190, 190)
_UNSEEN_COLOR: Color = (40, 40, 40)
_REFUSED_COLOR: Color = (255, 140, 60)
_ODDS = "kind", "second", "odds", "on", "behind", "seen"
_SHEET = "sheet_m", "sheet_share", "sheet_patches"
"""Fields of `Support`."""
_OUTSIDE_COLOR, _CLUTTER_COLOR = CLASSES[Label.OUTSIDE][1], CLASSES[Label.CLUTTER][1]


def log_map_block(
    log: Log, index: int, stamp_ns: int, points_map: FloatArray, label: UInt8Array
) -> None:
    """Log the points that are new in the map since the last block."""
    log.at(stamp_ns, index)
    _log_split(log, MAP_POINTS, "/world/map/ceiling", points_map, label, static=False)


def log_fused_walls(log: Log, fused: Walls) -> None:
    """Log the wall planes of all scans, fused, before any was judged."""
    if not len(fused):
        return
    labels = [
        f"fused from wall planes of {scans} scans, {1000 * rms_m:.0f} mm rms"
        for scans, rms_m in zip(fused.scan_count, fused.rms_m, strict=True)
    ]
    lines = strips(at_height(fused.ends, 0.0), _FUSED_COLOR, 1.0, labels, show_labels=False)
    values = evidence(scan_count=fused.scan_count, rms_m=fused.rms_m)
    log.static("/world/building/fused_walls", lines, values)


def log_building(log: Log, building: BuildingModel) -> None:
    """Log walls, clutter against them, refused faces, doors, windows, levels, and the reasons."""
    _log_walls(log, building)
    _log_refused(log, building.judged)
    _log_doors(log, building.doors)
    _log_windows(log, building)
    _log_levels(log, building.levels)
    log.text(REASONS, building_document(building))


def _log_walls(log: Log, building: BuildingModel) -> None:
    walls, foreground = building.walls, building.foreground
    panels = wall_panels(walls, building.ways, building.windows, building.blinds)
    outlines = upright_frames(walls.ends, walls.bottom_m, walls.top_m)
    for w, why in enumerate(reasons(walls.support)):
        of, wall = panels.wall == w, walls.one(w)
        log.static(
            f"{WALLS}/{w:03d}",
            panel_mesh(panels.ends[of], panels.bottom_m[of], panels.top_m[of], WALL_COLOR),
            strips(outlines[w : w + 1], WALL_COLOR, 1.0, [f"wall {w}: {why}"], show_labels=False),
            evidence(wall, "scan_count", "rms_m"),
            evidence(wall.support, *_ODDS),
        )
    if foreground.covered.any():
        points = rr.Points3D(
            covered_places(walls, foreground).astype(np.float32),
            radii=CELL_M / 2,
            colors=_CLUTTER_COLOR,
            labels="clutter against the wall",
            show_labels=False,
        )
        log.static("/world/building/against_walls", points)


def log_faces(log: Log, parsed: ParsedFaces, refused: ParsedFaces, judged: JudgedFaces) -> None:
    """Log a picture of each wall and refused face: its cells, its stretches, and their odds."""
    _log_faces(log, FACES, parsed, range(len(parsed.faces)))
    _log_faces(log, f"{FACES}/refused", refused, np.flatnonzero(judged.refused.support.face >= 0))


def _log_faces(log: Log, path: str, parsed: ParsedFaces, numbers: Iterable[int]) -> None:
    """Log the layer of depth that most rays into each cell ended in as the texture of its face."""
    for w, (number, face) in enumerate(zip(numbers, parsed.faces.walls.ends, strict=True)):
        columns = parsed.faces.columns(w)
        ended = parsed.faces.evidence.ended[columns]
        rows = max(int(np.ceil(parsed.faces.top_m[columns].max() / CELL_M)), 1)
        cells = ended[:, :rows]
        layer = np.where(cells.any(axis=-1), cells.argmax(axis=-1), BEYOND + 1)
        picture = np.array([*LAYER_COLORS, _UNSEEN_COLOR], np.uint8)[layer.T[::-1]]
        # The last column may reach beyond the face's end.
        share = lengths_m(face[None])[0] / (len(cells) * CELL_M)
        top_m = np.array([rows * CELL_M])
        vertices, triangles = upright_quads(face[None], np.zeros((1, 1)), top_m[:, None])
        drawn = rr.Mesh3D(
            vertex_positions=vertices,
            triangle_indices=triangles,
            vertex_texcoords=np.array([[0, 1], [share, 1], [share, 0], [0, 0]], np.float32),
            albedo_texture=picture,
        )
        of_cells = evidence(ended=cells.reshape(-1, cells.shape[-1]))
        log.static(f"{path}/{number:03d}", drawn, *_stretches(parsed, w), of_cells)


def _stretches(parsed: ParsedFaces, w: int) -> tuple[rr.AsComponents | Evidence, ...]:
    """Return the outlines of the stretches of a face, labelled by their odds."""
    faces, stretches = parsed.faces, parsed.stretches[w]
    ends = faces.cut([(w, own.first, own.after) for own in stretches]).ends
    top_m = [float(faces.top_m[faces.columns(w)][own.columns].min()) for own in stretches]
    bottom_m, head_m = CELL_M * np.array([(own.sill, own.head) for own in stretches]).T
    frames = upright_frames(ends, bottom_m, np.where(head_m > 0.0, head_m, top_m))
    labels = [
        f"{words(own.kind)}, {own.width_m:.2f} m: odds {own.odds:.0f} nats against "
        f"{words(own.second)}"
        for own in stretches
    ]
    rows = np.array([(own.kind, own.second, own.odds) for own in stretches])
    kind, second = rows[:, :2].T.astype(np.uint8)
    drawn = strips(frames, _FUSED_COLOR, 1.0, labels, show_labels=False)
    return drawn, evidence(kind=kind, second=second, odds=rows[:, 2])


def _log_refused(log: Log, judged: JudgedFaces) -> None:
    faces = judged.refused
    if len(faces):
        frames = upright_frames(faces.ends, faces.bottom_m, faces.top_m)
        why = zip(judged.verdict, reasons(faces.support), strict=True)
        labels = [
            f"no wall {k}: {REFUSALS[verdict]}; {odds}" for k, (verdict, odds) in enumerate(why)
        ]
        log.static(
            "/world/building/refused_walls",
            strips(frames, _REFUSED_COLOR, 1.5, labels, show_labels=False),
            evidence(verdict=judged.verdict, scan_count=faces.scan_count),
            evidence(faces.support, *_ODDS),
        )


def _log_doors(log: Log, doors: Doors) -> None:
    if not len(doors):
        return
    sills = strips(at_height(doors.ends, 0.0), DOOR_COLOR, 3.0)
    log.static("/world/building/sills", sills)
    labels = [
        f"door {d}: {DoorState(state).name.lower()}, {width:.2f} m; {odds}"
        for d, (state, width, odds) in enumerate(
            zip(doors.state, lengths_m(doors.ends), short_reasons(doors.support), strict=True)
        )
    ]
    frames = upright_frames(doors.ends, np.zeros(len(doors)), doors.head_m)
    of_doors = evidence(
        doors,
        *("state", "confidence", "agreement", "coverage", "lintel", "scan_count", "depth_m"),
        *("ajar", "crossed", "ray_count", "glazed"),
    )
    drawn = strips(frames, DOOR_COLOR, 3.0, labels, show_labels=False)
    odds = evidence(doors.support, *_ODDS, *_SHEET, "contrast")
    log.static("/world/building/doors", drawn, of_doors, odds)
    # An open door is drawn as its frame, a closed one with its leaf.
    closed = doors.select(doors.state == DoorState.CLOSED)
    if len(closed):
        leaves = panel_mesh(closed.ends, np.zeros(len(closed)), closed.head_m, DOOR_COLOR)
        log.static("/world/building/leaves", leaves)


def _log_windows(log: Log, building: BuildingModel) -> None:
    windows, leaf_panes = building.windows, building.leaf_panes
    blinds = building.blinds
    glass = windows.append(leaf_panes)
    if len(glass):
        frames = upright_frames(glass.ends, glass.bottom_m, glass.top_m)
        names = [f"window {w}" for w in range(len(windows))]
        names += [f"pane of an open leaf {w}" for w in range(len(leaf_panes))]
        why = zip(names, reasons(glass.support), strict=True)
        labels = [f"{name}: {odds}" for name, odds in why]
        panes = strips(frames, _OUTSIDE_COLOR, 1.5, labels, show_labels=False)
        log.static("/world/building/windows", panes, evidence(glass.support, *_ODDS, *_SHEET))
    if len(blinds):
        ends = moved(blinds.ends, blinds.normal, -blinds.behind_m)
        hung = panel_mesh(ends, blinds.bottom_m, blinds.top_m, _CLUTTER_COLOR)
        log.static("/world/building/blinds", hung, evidence(blinds, "behind_m"))


def _log_levels(log: Log, levels: Sequence[HeightMap]) -> None:
    """Log the cells of level surfaces that only all scans together show, by kind of surface."""
    for surface, maps in groupby(levels, key=lambda level: level.surface):
        drawn = list(maps)
        counts = [np.count_nonzero(level.known) for level in drawn]
        sizes = np.repeat([[level.cell_m / 2] * 2 + [0.005] for level in drawn], counts, axis=0)
        boxes = rr.Boxes3D(
            centers=np.concatenate([level.places for level in drawn]).astype(np.float32),
            half_sizes=sizes,
            colors=CLASSES[surface.label][1],
            fill_mode=rr.components.FillMode.Solid,
            labels=surface.replace("_", " "),
            show_labels=False,
        )
        heights = evidence(
            low_m=np.concatenate([level.low_m[level.known] for level in drawn]),
            high_m=np.concatenate([level.high_m[level.known] for level in drawn]),
        )
        log.static(f"/world/building/levels/{surface}", boxes, heights)


def log_grid(log: Log, name: str, grid: GridMap) -> None:
    """Log a grid map for the whole recording."""
    # As in nav_msgs/OccupancyGrid: 0 free, 100 occupied, 255 unknown.
    states = [grid.cells == Cell.OCCUPIED, grid.cells == Cell.FREE]
    occupancy = np.select(states, [100, 0], 255).astype(np.uint8)
    rows, columns = occupancy.shape
    image = rr.components.ImageFormat(
        width=columns, height=rows, color_model="L", channel_datatype="U8"
    )
    log.static(
        f"{GRID}/{name}",
        rr.GridMap(
            data=np.ascontiguousarray(occupancy[::-1]).tobytes(),  # images begin at the top
            format=image,
            cell_size=grid.cell_m,
            # Below the trajectory, to not hide it.
            translation=[float(grid.origin[0]), float(grid.origin[1]), -0.05],
            colormap=rr.components.Colormap.RvizMap,
        ),
    )


def log_cloud(log: Log, points_map: FloatArray, label: UInt8Array) -> None:
    """Log the fused semantic cloud."""
    ceiling = "/world/building/ceiling"
    _log_split(log, "/world/building/cloud", ceiling, points_map, label, static=True)


def _log_split(
    log: Log,
    path: str,
    ceiling_path: str,
    points_map: FloatArray,
    label: UInt8Array,
    static: bool,
) -> None:
    """Log the ceiling apart: a view from above hides it."""
    ceiling = label == Label.CEILING
    positions = rounded(points_map)
    for own_path, own in ((path, ~ceiling), (ceiling_path, ceiling)):
        points = {"positions": positions[own], "class_ids": label[own], "radii": [_MAP_RADIUS]}
        if static:
            log.static(own_path, rr.Points3D(**points))
        else:
            log.row(own_path, rr.Points3D, **points)
