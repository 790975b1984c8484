"""Stage 3 of a run: the building from all scans together, and its maps, recorded and written."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.scan import BoolArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.drive import AllScans, Drive, TraceOnce, new_views
from ffmap.algorithms.building.fusion import Building, fuse_building
from ffmap.algorithms.building.model import NO_WINDOWS, BuildingSettings, Walls, Windows
from ffmap.algorithms.building.ray_evidence import WallCells, trace_shared
from ffmap.algorithms.building.windows import rays_through
from ffmap.algorithms.maps.all_maps import Maps, draw_maps
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.scan.summary import Features, select_scans
from ffmap.app.folder.map_files import write_grid
from ffmap.app.folder.names import DOORS, FLOOR_PLAN_DXF, FLOOR_PLAN_SVG, WALLS, map_file, rooms_file
from ffmap.app.folder.pictures import write_floor_plan
from ffmap.app.folder.plan_dxf import write_dxf
from ffmap.app.folder.room_files import door_rooms, topology, write_rooms
from ffmap.app.folder.walls_and_doors import write_doors, write_walls
from ffmap.app.record.building import log_building, log_fused_walls, log_grid
from ffmap.app.record.rooms import log_areas, log_rooms
from ffmap.app.record.whole_run import layout
from ffmap.app.run.blocks import PlaceJob
from ffmap.app.run.context import Run
from ffmap.app.run.spool import PLACED, load_features
from ffmap.app.run.stage_scans import LabelledScans
from ffmap.app.setup.outputs import Output
from ffmap.blueprints import entities


def build(run: Run, scans: LabelledScans, trajectory: Trajectory) -> tuple[Building, AllScans]:
    """The building of all scans, recorded, and what they gathered."""
    run.progress.stage("building", None)
    telling = _Telling.of(run, scans, trajectory)
    drive = Drive(trajectory.T_map_base[:, :3, 3], telling.features)
    trace = TraceOnce(_RayCounts(telling, run.options.workers))
    gathered = AllScans(drive, scans.votes, scans.rivals, trace, run.settings.levels)
    building = fuse_building(gathered, run.settings.fusion)
    if run.log is not None:
        log_fused_walls(run.log, building.aligned)
        log_building(run.log, building.model)
    run.state.counts |= {
        "walls": len(building.model.walls),
        "refused_walls": len(building.model.judged.refused),
        "doors": len(building.model.doors),
    }
    return building, gathered


def draw(run: Run, building: Building, gathered: AllScans) -> Maps:
    """The building's maps, written; its walls and doors too, for each door names the rooms that it joins."""
    maps = draw_maps(building, gathered, run.settings.maps)
    _write(run, building, maps)
    return maps


def take_maps(run: Run, maps: Maps) -> None:
    """Record the maps, and keep what the run says of them; by the one thread that writes the recording."""
    _record(run, maps)
    run.state.topology = topology(maps.rooms)
    run.state.counts["rooms"] = len(maps.rooms)


@dataclass(frozen=True)
class _Telling:
    """The scans that the building is made of, see `new_views`; jobs: of the blocks that hold any.

    scans: (n,) whether each cloud that was read is one of them, by its number.
    """

    jobs: tuple[PlaceJob, ...]
    scans: BoolArray

    @classmethod
    def of(cls, run: Run, labelled: LabelledScans, trajectory: Trajectory) -> "_Telling":
        """Of all scans that were labelled."""
        order = run.inputs.scans
        telling = np.zeros(len(order), bool)
        telling[labelled.scan] = new_views(trajectory.at(labelled.stamps_ns), order.lidar[labelled.scan])
        blocks = [(job, job.label.block) for job in labelled.jobs]
        return cls(tuple(job for job, own in blocks if telling[own.first : own.first + own.count].any()), telling)

    def features(self, jobs: Sequence[PlaceJob] | None = None) -> Iterator[Features]:
        """What the spool holds of them, block by block; of some blocks alone where these are given."""
        for job in self.jobs if jobs is None else jobs:
            for features in load_features(job.label.path.with_suffix(PLACED)):
                chosen = self.scans[features.scan]
                yield features if chosen.all() else select_scans(features, chosen)


class _RayCounts:
    """`TracePart` by several threads. Which rays ended beyond windows is kept until others are asked about."""

    def __init__(self, telling: _Telling, workers: int) -> None:
        self._telling, self._workers = telling, workers
        self._asked, self._beyond = NO_WINDOWS.key, list[Features]()

    def __call__(self, faces: Walls, settings: BuildingSettings, through: Windows | None) -> WallCells:
        if through is None:
            return trace_shared(faces, self._telling.features, settings, self._workers)
        beyond = self._rays_beyond(through)
        return trace_shared(faces, lambda: beyond, settings, self._workers)

    def _rays_beyond(self, windows: Windows) -> list[Features]:
        def beyond_in(job: PlaceJob) -> list[Features]:
            return [rays_through(windows, part) for part in self._telling.features((job,))]

        if windows.key != self._asked:
            with ThreadPoolExecutor(self._workers) as threads:
                # Few rays end beyond windows.
                beyond = [part for parts in threads.map(beyond_in, self._telling.jobs) for part in parts]
            self._asked, self._beyond = windows.key, beyond
        return self._beyond


def _grids(maps: Maps) -> dict[str, GridMap]:
    """Every grid map by its name, the run's own first."""
    return {entities.FURNITURE_FREE: maps.grid} | {str(name): grid for name, grid in maps.rivals.items()}


def _record(run: Run, maps: Maps) -> None:
    if run.log is None or run.recording is None:
        return
    for name, grid in _grids(maps).items():
        log_grid(run.log, name, grid)
    log_rooms(run.log, maps.rooms)
    for segmented, graph in maps.compared_rooms.items():
        log_areas(run.log, graph, f"{entities.ROOMS_COMPARED}/{segmented}")
    several = len(run.inputs.verticals) > 1
    run.recording.set_layout(layout(run.inputs.line_pairs, run.options.detail, run.record, maps.grid, several))


def _write(run: Run, building: Building, maps: Maps) -> None:
    folder, outputs = run.folder.path, run.options.outputs
    if Output.GEOJSON in outputs:
        write_walls(folder / WALLS, building.model.walls, building.thickness_m)
        write_doors(folder / DOORS, building.model.doors, door_rooms(maps.rooms))
        for name, graph in ({Segmented.FURNITURE_FREE: maps.rooms} | dict(maps.compared_rooms)).items():
            write_rooms(folder / rooms_file(name), graph)
    if Output.PLAN in outputs:
        write_floor_plan(folder / FLOOR_PLAN_SVG, maps.plan, run.inputs.bag_path.name)
        write_dxf(folder / FLOOR_PLAN_DXF, maps.plan)
    if Output.MAPS in outputs:
        for map_name, grid in _grids(maps).items():
            write_grid(folder / map_file(map_name), grid)
