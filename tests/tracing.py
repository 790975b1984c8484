"""Counting rays against faces as the run does, for scans that lie in memory."""

from ffmap.algorithms.building.drive import TraceOnce
from ffmap.algorithms.building.model import BuildingSettings, Walls, Windows
from ffmap.algorithms.building.ray_evidence import WallCells, trace_rays
from ffmap.algorithms.building.windows import rays_through
from ffmap.algorithms.scan.summary import Features


def tracing(features: Features) -> TraceOnce:
    def trace(faces: Walls, settings: BuildingSettings, through: Windows | None) -> WallCells:
        return trace_rays(faces, [features if through is None else rays_through(through, features)], settings)

    return TraceOnce(trace)
