"""Real bags from generated buildings: two lidars on a robot that drives in and out of rooms, with the truth."""

from loaders.simulator.plans import BUILDINGS
from loaders.simulator.settings import SimulationSettings
from loaders.simulator.simulate import SimulationReport, simulate

__all__ = ["BUILDINGS", "SimulationReport", "SimulationSettings", "simulate"]
