"""Fuse the walls, openings and levels of all scans, and draw the maps of the building."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.scan import BoolArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.drive import AllScans, Drive, new_views
from ffmap.algorithms.building.evidence import Evidence, trace_shared
from ffmap.algorithms.building.fusion import Building, fuse_building
from ffmap.algorithms.building.model import BuildingSettings, Walls, Windows
from ffmap.algorithms.building.rays import OwnPlane
from ffmap.algorithms.building.windows import rays_through
from ffmap.algorithms.maps.all_maps import Maps
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.scan.summary import Features, select_scans
from ffmap.app.folder.map_files import write_grid
from ffmap.app.folder.names import (
    DOORS,
    FLOOR_PLAN_DXF,
    FLOOR_PLAN_SVG,
    PASSAGES,
    ROOMS_OSM,
    WALLS,
    map_file,
    rooms_file,
)
from ffmap.app.folder.osm_file import write_osm
from ffmap.app.folder.pictures import write_floor_plan
from ffmap.app.folder.plan_dxf import write_dxf
from ffmap.app.folder.room_files import door_rooms, write_passages, write_rooms
from ffmap.app.folder.walls_and_doors import write_doors, write_walls
from ffmap.app.record.building import (
    log_building,
    log_faces,
    log_fused_walls,
    log_grid,
)
from ffmap.app.record.rooms import log_areas, log_rooms
from ffmap.app.run.arrays import map_arrays, unpack
from ffmap.app.run.report import Report
from ffmap.app.run.scans import LabelledScans
from ffmap.app.run.start import Run
from ffmap.app.setup.outputs import Output
from ffmap.blueprints import entities


def fuse_all_scans(
    run: Run, labelled: LabelledScans, trajectory: Trajectory, report: Report
) -> tuple[Building, AllScans]:
    """Fuse the building, and return it with the evidence that the maps need too."""
    report.progress.stage("building", None)
    features = _FeaturesOfScans.of(run, labelled, trajectory)
    drive = Drive(trajectory.T_map_base[:, :3, 3], features.read)
    rays = _RayCounts(features, run.settings.building, run.options.workers)
    votes, rivals = labelled.votes, labelled.rivals
    traces = rays.all_rays, rays.within, rays.beyond
    evidence = AllScans(drive, votes, rivals, *traces, run.settings.levels)
    building = fuse_building(evidence, run.settings.fusion)
    if report.log is not None:
        log_fused_walls(report.log, building.fused)
        log_building(report.log, building.model)
        log_faces(report.log, building.parsed, building.refused, building.model.judged)
    return building, evidence


@dataclass(frozen=True)
class _FeaturesOfScans:
    """The scans that the building is fused from, see `new_views`.

    blocks: features of some scans each, mapped into memory. chosen: (n,) bool by scan number.
    """

    blocks: tuple[Features, ...]
    chosen: BoolArray

    @classmethod
    def of(cls, run: Run, labelled: LabelledScans, trajectory: Trajectory) -> "_FeaturesOfScans":
        order = run.inputs.scans
        chosen = np.zeros(len(order), bool)
        T_map_base = trajectory.at(labelled.stamps_ns)
        chosen[labelled.scan] = new_views(T_map_base, order.lidar[labelled.scan])
        blocks = []
        for block in labelled.blocks:
            if chosen[block.first : block.first + block.count].any():
                blocks.append(unpack(Features, map_arrays(block.labelled), "feature_"))
        return cls(tuple(blocks), chosen)

    def read(self, blocks: Sequence[Features] | None = None) -> Iterator[Features]:
        """Yield the features of the chosen scans, block by block."""
        for block in self.blocks if blocks is None else blocks:
            chosen = self.chosen[block.scan]
            yield block if chosen.all() else select_scans(block, chosen)


class _RayCounts:
    """Books rays in cells of faces, in several threads; see `AllScans`."""

    def __init__(
        self, features: _FeaturesOfScans, settings: BuildingSettings, workers: int
    ) -> None:
        self._features, self._workers = features, workers
        self._range_m, self._own = settings.range_m, OwnPlane.of(settings)

    def all_rays(self, faces: Walls) -> Evidence:
        return self._traced(faces, self._features.read)

    def within(self, openings: Walls) -> Evidence:
        return self._traced(openings, self._features.read, at_ends=True)

    def beyond(self, faces: Walls, windows: Windows) -> Evidence:
        def of_block(block: Features) -> list[Features]:
            return [rays_through(windows, part) for part in self._features.read((block,))]

        with ThreadPoolExecutor(self._workers) as threads:
            parts = threads.map(of_block, self._features.blocks)
            through = [part for block in parts for part in block]
        return self._traced(faces, lambda: through)

    def _traced(
        self, faces: Walls, blocks: Callable[[], Iterable[Features]], at_ends: bool = False
    ) -> Evidence:
        return trace_shared(faces, blocks, self._range_m, self._own, self._workers, at_ends)


def log_maps(maps: Maps, report: Report) -> None:
    """Record grids and rooms."""
    if report.log is None:
        return
    for name, grid in _grids(maps).items():
        log_grid(report.log, name, grid)
    log_rooms(report.log, maps.rooms)
    for segmented, graph in maps.compared_rooms.items():
        log_areas(report.log, graph, f"{entities.ROOMS_COMPARED}/{segmented}")
    report.show_map(maps.grid)


def write_maps(run: Run, building: Building, maps: Maps) -> None:
    """Write walls, doors, rooms, plan and grids."""
    folder, outputs = run.folder, run.options.outputs
    if Output.GEOJSON in outputs:
        write_walls(folder / WALLS, building.model.walls, building.thickness_m)
        write_doors(folder / DOORS, building.model.doors, door_rooms(maps.rooms))
        rooms = {Segmented.FURNITURE_FREE: maps.rooms} | dict(maps.compared_rooms)
        for segmented, graph in rooms.items():
            write_rooms(folder / rooms_file(segmented), graph)
        write_passages(folder / PASSAGES, maps.rooms)
        write_osm(folder / ROOMS_OSM, maps.rooms)
    if Output.PLAN in outputs:
        write_floor_plan(folder / FLOOR_PLAN_SVG, maps.plan, run.inputs.bag_path.name)
        write_dxf(folder / FLOOR_PLAN_DXF, maps.plan)
    if Output.MAPS in outputs:
        for name, grid in _grids(maps).items():
            write_grid(folder / map_file(name), grid)


def _grids(maps: Maps) -> dict[str, GridMap]:
    return {entities.FURNITURE_FREE: maps.grid} | {str(n): grid for n, grid in maps.rivals.items()}
