"""Bags of a robot that drives through a generated building, with the ground truth."""

from ffmap.loaders.simulator.sensors import LAYOUTS
from ffmap.loaders.simulator.settings import PRESETS, SimulationSettings
from ffmap.loaders.simulator.simulate import simulate

__all__ = ["LAYOUTS", "PRESETS", "SimulationSettings", "simulate"]
