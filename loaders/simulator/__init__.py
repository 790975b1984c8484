"""Real bags from generated buildings: two lidars on a robot that drives in and out of rooms, with the truth."""

from ffmap.loaders.simulator.layouts import LAYOUTS
from ffmap.loaders.simulator.plans import BUILDINGS
from ffmap.loaders.simulator.settings import SimulationSettings
from ffmap.loaders.simulator.simulate import SimulationReport, simulate

__all__ = ["BUILDINGS", "LAYOUTS", "SimulationReport", "SimulationSettings", "simulate"]
