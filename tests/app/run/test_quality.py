"""A drive of 25 s through a furnished office: labels, doors, map and rooms stay as good."""

import json
from pathlib import Path

from ffmap.app.commands import run as run_command
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.simulator import SimulationSettings, simulate

AT_LEAST = {
    "wall.f1": 0.967,
    "floor.f1": 0.985,
    "ceiling.f1": 0.985,
    "door.f1": 0.975,
    "clutter.f1": 0.917,
    "doors.recall": 0.87,
    "maps.furniture_free.precision_without_cabinets": 0.97,
    "maps.furniture_free.recall": 0.97,
    "rooms.furniture_free.recall": 0.75,
    "rooms.furniture_free.precision": 0.95,
}
AT_MOST = {
    "doors.invented": 0.0,
    "doors.width_error_m": 0.01,
    "maps.furniture_free.blocked": 0.125,  # one of eight, of which 30 cm were seen
    "trajectory.ate_rmse_m": 0.015,
}


def test_figures_stay_as_good(tmp_path: Path) -> None:
    bag, out = tmp_path / "office.bag", tmp_path / "run"
    simulate(bag, SimulationSettings(building="office", seed=1, duration_s=25.0))
    options = RunOptions(outputs=("labels", "maps", "geojson"), quiet=True, workers=1)
    run_command.run(BagPath((bag,)), Settings(), options, out=out)
    metrics = json.loads((out / "metrics.json").read_text())
    worse = {name: metrics[name] for name, least in AT_LEAST.items() if metrics[name] < least}
    worse |= {name: metrics[name] for name, most in AT_MOST.items() if metrics[name] > most}
    assert worse == {}
