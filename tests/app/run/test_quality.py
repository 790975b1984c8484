"""A drive of 25 s through a furnished office: labels, doors, map and rooms stay as good."""

import json
from typing import Any

import pytest

from ffmap.app.commands import run as run_command
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.simulator import SimulationSettings, simulate


@pytest.fixture(scope="module")
def metrics(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("quality")
    bag = folder / "office.bag"
    simulate(bag, SimulationSettings(building="office", seed=1, duration_s=25.0))
    run_command.run(
        BagPath((bag,)),
        Settings(),
        RunOptions(outputs=("labels", "maps", "geojson"), quiet=True, workers=1),
        out=folder / "run",
    )
    return json.loads((folder / "run" / "metrics.json").read_text())


@pytest.mark.parametrize(
    ("path", "minimum"),
    [
        ("wall.f1", 0.967),
        ("floor.f1", 0.985),
        ("ceiling.f1", 0.985),
        ("door.f1", 0.975),
        ("clutter.f1", 0.917),
        ("doors.recall", 0.87),
        ("maps.furniture_free.precision_without_cabinets", 0.97),
        ("maps.furniture_free.recall", 0.975),
        ("rooms.furniture_free.recall", 0.75),
        ("rooms.furniture_free.precision", 0.95),
    ],
)
def test_is_at_least(metrics: Any, path: str, minimum: float) -> None:
    assert metrics[path] >= minimum


@pytest.mark.parametrize(
    ("path", "maximum"),
    [
        ("doors.invented", 0.0),
        ("doors.width_error_m", 0.01),
        ("maps.furniture_free.blocked", 0.0),
        ("trajectory.ate_rmse_m", 0.015),
    ],
)
def test_is_at_most(metrics: Any, path: str, maximum: float) -> None:
    assert metrics[path] <= maximum
