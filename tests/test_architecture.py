"""Imports point one way, between the top-level folders and between the folders in them."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TOP = ("algorithms", "blueprints", "loaders", "app")
ROOMS = {
    "algorithms": ("base", "scan", "poses", "building", "maps", "truth"),
    "app": ("setup", "folder", "record", "run", "analysis", "commands"),
}
"""Each uses only those before it."""


def imported(path: Path) -> set[tuple[str, ...]]:
    """Modules of this program that a file imports, as ("algorithms", "scan", "doors")."""
    modules: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {tuple(module.split(".")[1:]) for module in modules if module.startswith("ffmap.")}


@pytest.mark.parametrize(
    ("folder", "room"), [(folder, room) for folder, rooms in ROOMS.items() for room in rooms]
)
def test_a_room_uses_only_those_before_it(folder: str, room: str) -> None:
    rooms = ROOMS[folder]
    later = set(rooms[rooms.index(room) + 1 :])
    files = sorted((ROOT / folder / room).rglob("*.py"))
    assert files
    for path in files:
        backwards = {
            ".".join(parts) for parts in imported(path) if parts[0] == folder and parts[1] in later
        }
        assert not backwards, path.relative_to(ROOT)


@pytest.mark.parametrize("folder", ROOMS)
def test_every_room_is_known(folder: str) -> None:
    assert {
        path.name
        for path in (ROOT / folder).iterdir()
        if path.is_dir() and path.name != "__pycache__"
    } == set(ROOMS[folder])


def test_every_folder_is_installed() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = {path.parent.relative_to(ROOT) for top in TOP for path in (ROOT / top).rglob("*.py")}
    inner = sorted("ffmap." + ".".join(folder.parts) for folder in folders)
    assert sorted(listed) == ["ffmap", *inner]


def test_the_folders_are_installed_as_one_package(tmp_path: Path) -> None:
    """Beside packages that have the folders' names, as ROS workspaces put them into PYTHONPATH."""
    for folder in TOP:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "__init__.py").write_text("raise ImportError('another program')")
    mapping = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"][
        "package-dir"
    ]
    assert mapping == {"ffmap": "."} | {f"ffmap.{folder}": folder for folder in TOP}
    command = [Path(sys.executable).with_name("ffmap"), "settings"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    told = subprocess.run(command, cwd=tmp_path, env=environment, text=True, capture_output=True)
    assert told.returncode == 0, told.stderr
    assert "similarity_m" in told.stdout
