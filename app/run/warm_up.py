"""Imported by the workers' server before it forks: compiled code is loaded once, and shared by all workers.

Numba loads a function when it is first called with arrays of given types, which takes each process most of a second.
"""

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.ceilings import map_ceilings
from ffmap.algorithms.building.face_foreground import NO_FOREGROUND
from ffmap.algorithms.building.face_verdicts import NO_JUDGED_FACES
from ffmap.algorithms.building.final_labels import BuildingModel, Relabelling, RelabellingSettings
from ffmap.algorithms.building.halo import HaloSettings, find_halo
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.model import NO_BLINDS, NO_DOORS, NO_WALLS, NO_WINDOWS
from ffmap.algorithms.building.votes import VoxelTable
from ffmap.algorithms.poses.levelling import place_and_level
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.algorithms.scan.point_lines import COLUMN_PAIRS
from ffmap.algorithms.scan.smoothing import smooth_ranges
from ffmap.algorithms.scan.summary import extract
from ffmap.app.run.blocks import VOXEL_M, points_in_map
from ffmap.app.setup.settings import Settings

RINGS, FIRINGS = 8, 180
ROOM_M = np.array([3.0, 2.0, 1.2])
"""Half the edges of the room that is seen, about the sensor."""


def warm_up() -> None:
    """Take one scan of an empty room through both passes of a run."""
    scan, method = _room_scan(), Settings().method
    upright = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, ROOM_M[2]], [0, 0, 0, 1]])
    trajectory = Trajectory(np.array([0, 200_000_000]), np.stack([np.eye(4)] * 2))
    ranges = smooth_ranges(scan, method.smoothing)
    level = place_and_level(scan, ranges, trajectory, upright, 0.0, np.zeros(2), method.rearrangement, 2.0)
    placed = level.placed
    labelling = label_scan(scan, placed, method, 0)
    label_scan(scan, placed, method, 0, column_pairs=COLUMN_PAIRS)
    extract(0, placed, labelling)
    points_map = points_in_map(placed)
    table = VoxelTable(VOXEL_M, len(Label))
    table.add(points_map, labelling.label)
    votes = table.votes()
    table.absorb(votes)
    building = BuildingModel(
        NO_WALLS, NO_FOREGROUND, NO_JUDGED_FACES, NO_DOORS, NO_WINDOWS, NO_BLINDS, (map_ceilings(votes, LevelsSettings()),)
    )
    Relabelling.of(building, find_halo(votes, HaloSettings()), RelabellingSettings()).labels(
        points_map,
        level.floor.heights_above(placed.points_level),
        below_ceiling(placed.points_level, labelling.ceiling_planes),
        labelling.label,
        placed.to_map(placed.origin_level[None])[0],
    )


def _room_scan() -> Scan:
    """What a lidar with its spin axis along x returns from the middle of a box."""
    elevation = np.repeat(np.radians(np.linspace(-15, 15, RINGS)), FIRINGS)
    azimuth = np.tile(np.linspace(-np.pi, np.pi, FIRINGS, endpoint=False), RINGS)
    ray = np.column_stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    # The sensor's z lies along the map's x, its x against the map's z.
    reach = np.min(ROOM_M[[2, 1, 0]] / np.maximum(np.abs(ray), 1e-9), axis=1)
    points = (ray * reach[:, None]).astype(np.float32)
    count = len(points)
    return Scan(
        points_sensor=points,
        ring=np.repeat(np.arange(RINGS, dtype=np.uint16), FIRINGS),
        ring_count=RINGS,
        time_ns=np.tile(np.linspace(0, 99_000_000, FIRINGS).astype(np.int64), RINGS),
        start_ns=0,
        stamp_ns=0,
        cloud_index=np.arange(count, dtype=np.int32),
        cloud_size=count,
    )


warm_up()
