"""Arrows point one way, between the top-level folders and between the rooms in them; the linter bans what is left."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TOP = ("algorithms", "blueprints", "loaders", "app")
ALLOWED = {
    "algorithms": {"algorithms"},
    "loaders": {"loaders", "algorithms"},
    "blueprints": {"blueprints", "algorithms"},
    "app": {"app", "blueprints", "loaders", "algorithms"},
}
ROOMS = {
    "algorithms": ("base", "scan", "poses", "building", "maps", "truth"),
    "app": ("setup", "folder", "record", "run", "analysis", "sweeps", "commands"),
}
"""Each uses only those before it."""


def imported(path: Path) -> set[tuple[str, ...]]:
    """The parts of this program's modules that a file imports, as ("algorithms", "scan", "doors")."""
    modules: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {tuple(module.split(".")[1:]) for module in modules if module.startswith("ffmap.")}


@pytest.mark.parametrize("folder", TOP)
def test_imports_follow_the_arrows(folder: str) -> None:
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    for path in files:
        assert {parts[0] for parts in imported(path)} <= ALLOWED[folder], path


@pytest.mark.parametrize(("folder", "room"), [(folder, room) for folder, rooms in ROOMS.items() for room in rooms])
def test_a_room_uses_only_those_before_it(folder: str, room: str) -> None:
    rooms = ROOMS[folder]
    later = set(rooms[rooms.index(room) + 1 :])
    files = sorted((ROOT / folder / room).rglob("*.py"))
    assert files
    for path in files:
        backwards = {".".join(parts) for parts in imported(path) if parts[0] == folder and parts[1] in later}
        assert not backwards, path.relative_to(ROOT)


@pytest.mark.parametrize("folder", ROOMS)
def test_every_room_is_known(folder: str) -> None:
    assert {path.name for path in (ROOT / folder).iterdir() if path.is_dir() and path.name != "__pycache__"} == set(
        ROOMS[folder]
    )


def test_every_folder_is_installed() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = {path.parent.relative_to(ROOT) for top in TOP for path in (ROOT / top).rglob("*.py")}
    assert sorted(listed) == sorted("ffmap." + ".".join(folder.parts) for folder in folders)


def test_tests_lie_where_the_code_does() -> None:
    for path in (ROOT / "tests").rglob("test_*.py"):
        folder = path.parent.relative_to(ROOT / "tests")
        if folder.parts and folder.parts[0] in TOP:
            assert (ROOT / folder).is_dir(), path
            assert re.fullmatch(r"test_\w+\.py", path.name)
