"""The building: its faces, doors, windows, levels, maps, and the fused cloud."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np
import rerun as rr

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m, moved
from ffmap.algorithms.building.face_alignment import AlignedFaces
from ffmap.algorithms.building.face_foreground import covered_places
from ffmap.algorithms.building.face_verdicts import JudgedFaces
from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.height_map import HeightMap
from ffmap.algorithms.building.model import CELL_M, Doors
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.record.building_reasons import explain_building
from ffmap.app.record.log import Log, evidence
from ffmap.app.record.shapes import at_height, panel_mesh, rounded, strips, ui_radius, upright_frames
from ffmap.app.record.wall_panels import wall_panels
from ffmap.blueprints import entities

MAP_RADIUS_UI = 1.25


def log_map_block(log: Log, index: int, stamp_ns: int, points_map: FloatArray, label: UInt8Array) -> None:
    """Points that are new in the map since the last block; the viewer shows all up to the cursor."""
    log.at(stamp_ns, index)
    _log_split(log, entities.MAP_POINTS, entities.MAP_CEILING, points_map, label, static=False)


def log_fused_walls(log: Log, aligned: AlignedFaces) -> None:
    """Where each face was before it was laid along the returns of all scans."""
    fused = aligned.fused
    if not len(fused):
        return
    labels = [
        f"before it was laid along all returns ({scans} scans): its ends then moved {100 * a:+.1f} and {100 * b:+.1f} cm "
        f"towards the room{'; a part of a face that was cut where it steps' if cut else ''}"
        for scans, (a, b), cut in zip(fused.scan_count, aligned.moved_m, aligned.cut, strict=True)
    ]
    lines = strips(at_height(fused.ends, 0.0), entities.FUSED_WALL_COLOR, 1.0, labels, show_labels=False)
    log.static(entities.FUSED_WALLS, lines, evidence(moved_m=aligned.moved_m, scan_count=fused.scan_count))


def log_building(log: Log, building: BuildingModel) -> None:
    """The walls, what stands against them, what was refused as a wall, doors, windows and level surfaces."""
    _log_walls(log, building)
    _log_refused(log, building.judged)
    _log_doors(log, building.doors)
    _log_windows(log, building)
    _log_levels(log, building.levels)
    log.text(entities.BUILDING_REASONS, explain_building(building))


def _log_walls(log: Log, building: BuildingModel) -> None:
    walls, foreground = building.walls, building.foreground
    panels = wall_panels(walls, building.doors, building.windows, building.blinds)
    if len(walls):
        log.static(
            entities.WALLS,
            panel_mesh(panels.ends, panels.bottom_m, panels.top_m, entities.CLASSES[Label.WALL][1]),
            evidence(walls, "scan_count", "rms_m", wall_of_panel=panels.wall),
        )
    if foreground.covered.any():
        log.static(
            entities.AGAINST_WALLS,
            rr.Points3D(
                covered_places(walls, foreground).astype(np.float32),
                radii=CELL_M / 2,
                colors=entities.CLASSES[Label.CLUTTER][1],
                labels="stands against the wall",
                show_labels=False,
            ),
        )


def _log_refused(log: Log, judged: JudgedFaces) -> None:
    faces = judged.refused
    if len(faces):
        frames = upright_frames(faces.ends, faces.bottom_m, faces.top_m)
        labels = [f"no wall: {entities.REFUSALS[verdict]}" for verdict in judged.verdict]
        log.static(
            entities.REFUSED_WALLS,
            strips(frames, entities.REFUSED_WALL_COLOR, 1.5, labels, show_labels=False),
            evidence(verdict=judged.verdict, scan_count=faces.scan_count),
        )


def _log_doors(log: Log, doors: Doors) -> None:
    if not len(doors):
        return
    color = entities.CLASSES[Label.DOOR][1]
    log.static(entities.DOOR_SILLS, strips(at_height(doors.ends, 0.0), color, 3.0))
    labels = [
        f"{DoorState(state).name.lower()} door, {width:.2f} m, {confidence:.0%}"
        for state, width, confidence in zip(doors.state, lengths_m(doors.ends), doors.confidence, strict=True)
    ]
    columns = ("state", "confidence", "agreement", "coverage", "lintel", "scan_count", "depth_m", "ajar", "crossed")
    log.static(
        entities.DOORS,
        strips(upright_frames(doors.ends, np.zeros(len(doors)), doors.head_m), color, 3.0, labels, show_labels=False),
        evidence(doors, *columns, "ray_count", "casing_m", "contrast", "outline", "glazed"),
    )
    # An open door is its frame; a closed one has a leaf.
    closed = doors.select(doors.state == DoorState.CLOSED)
    if len(closed):
        log.static(entities.DOOR_LEAVES, panel_mesh(closed.ends, np.zeros(len(closed)), closed.head_m, color))


def _log_windows(log: Log, building: BuildingModel) -> None:
    windows, leaf_panes, mullions, blinds = building.windows, building.leaf_panes, building.mullions, building.blinds
    glass = windows.append(leaf_panes)
    if len(glass):
        frames = upright_frames(glass.ends, glass.bottom_m, glass.top_m)
        color = entities.CLASSES[Label.OUTSIDE][1]
        labels = ["window"] * len(windows) + ["pane of an open leaf"] * len(leaf_panes)
        log.static(entities.WINDOWS, strips(frames, color, 1.5, labels, show_labels=False))
    if len(mullions):
        fronts = panel_mesh(mullions.front, mullions.bottom_m, mullions.top_m, entities.CLASSES[Label.WALL][1])
        log.static(entities.MULLIONS, fronts, evidence(mullions, "out_m"))
    if len(blinds):
        hung = moved(blinds.ends, blinds.normal, -blinds.behind_m)
        log.static(
            entities.BLINDS,
            panel_mesh(hung, blinds.bottom_m, blinds.top_m, entities.CLASSES[Label.CLUTTER][1]),
            evidence(blinds, "behind_m", "contrast"),
        )


def _log_levels(log: Log, levels: Sequence[HeightMap]) -> None:
    """Where ceilings, beams, floors and floors that panes mirror were told that scans took for something else, cell by cell."""
    for surface, maps in groupby(levels, key=lambda level: level.surface):
        drawn = list(maps)
        places = np.concatenate([level.places for level in drawn])
        counts = [np.count_nonzero(level.known) for level in drawn]
        low_m, high_m = (
            np.concatenate([getattr(level, name)[level.known] for level in drawn]) for name in ("low_m", "high_m")
        )
        log.static(
            f"{entities.LEVELS}/{surface}",
            rr.Boxes3D(
                centers=places.astype(np.float32),
                half_sizes=np.repeat([[0.5 * level.cell_m] * 2 + [0.005] for level in drawn], counts, axis=0),
                colors=entities.CLASSES[surface.label][1],
                fill_mode=rr.components.FillMode.Solid,
                labels=surface.replace("_", " "),
                show_labels=False,
            ),
            evidence(low_m=low_m, high_m=high_m),
        )


def log_grid(log: Log, name: str, grid: GridMap) -> None:
    """A grid map; it holds for the whole run."""
    # As in nav_msgs/OccupancyGrid, which the colour map is made for: 0 free, 100 occupied, 255 unknown.
    occupancy = np.select([grid.cells == Cell.OCCUPIED, grid.cells == Cell.FREE], [100, 0], 255).astype(np.uint8)
    rows, columns = occupancy.shape
    log.static(
        f"{entities.GRID}/{name}",
        rr.GridMap(
            data=np.ascontiguousarray(occupancy[::-1]).tobytes(),  # an image's first row is its uppermost
            format=rr.components.ImageFormat(width=columns, height=rows, color_model="L", channel_datatype="U8"),
            cell_size=grid.cell_m,
            # Below the trajectory, which it would hide.
            translation=[float(grid.origin[0]), float(grid.origin[1]), -0.05],
            colormap=rr.components.Colormap.RvizMap,
        ),
    )


def log_cloud(log: Log, points_map: FloatArray, label: UInt8Array) -> None:
    """The fused semantic cloud, once."""
    _log_split(log, entities.CLOUD, entities.CLOUD_CEILING, points_map, label, static=True)


def _log_split(log: Log, path: str, ceiling_path: str, points_map: FloatArray, label: UInt8Array, static: bool) -> None:
    """The ceiling apart, so that a view can look into the building from above."""
    ceiling = label == Label.CEILING
    positions = rounded(points_map)
    for own_path, own in ((path, ~ceiling), (ceiling_path, ceiling)):
        points = rr.Points3D(positions[own], class_ids=label[own], radii=ui_radius(MAP_RADIUS_UI))
        log.stream.log(own_path, points, static=static)
