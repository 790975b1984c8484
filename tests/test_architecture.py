"""Arrows point one way: app -> blueprints, loaders, algorithms; loaders -> algorithms; nothing else."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ALLOWED = {
    "algorithms": {"algorithms"},
    "loaders": {"loaders", "algorithms"},
    "blueprints": {"blueprints", "algorithms"},
    "app": {"app", "blueprints", "loaders", "algorithms"},
}
HOUSE = set(ALLOWED) | {"tests"}
ONLY_IN = {
    "kiss_icp": ["algorithms/odometry.py"],
    "small_gicp": ["algorithms/gaussian_map.py"],
    "gtsam": ["algorithms/pose_graph.py"],
    "rerun": [
        "app/recorder.py",
        "app/recording.py",
        "app/recorded.py",
        "app/evaluation_recorder.py",
        "app/room_recorder.py",
        "app/inspect_recorder.py",
        "app/compare_recorder.py",
        "app/pipeline.py",
        "app/sweep_recorder.py",
        "app/catalogue",
        "blueprints/",
    ],
    "embreex": ["loaders/simulator/"],
    "pickle": [],
}


def imports_of(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("folder", ALLOWED)
def test_imports_follow_the_arrows(folder: str) -> None:
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    for path in files:
        assert imports_of(path) & HOUSE <= ALLOWED[folder], path


@pytest.mark.parametrize("package", ONLY_IN)
def test_packages_stay_where_they_belong(package: str) -> None:
    for folder in ALLOWED:
        for path in sorted((ROOT / folder).rglob("*.py")):
            place = path.relative_to(ROOT).as_posix()
            if package in imports_of(path):
                assert any(place.startswith(home) for home in ONLY_IN[package]), place
