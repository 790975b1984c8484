"""ffmap rigs: the list, and the file of one as a start for one's own."""

import json
from pathlib import Path

from ffmap.loaders.rig_file import built_in_path, built_in_rigs
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import ffmap_here, with_cache


def test_rigs_are_listed_and_printed(tmp_path: Path) -> None:
    environment = with_cache(tmp_path)
    listed = ffmap_here(environment, "rigs").stdout
    for rig in built_in_rigs():
        assert f"{rig.name}: {rig.description}; source: {rig.source}" in listed
        for lidar in rig.lidars:
            assert f"{lidar.topic} " in listed
            assert f"{lidar.frame}\n" in listed
    assert ffmap_here(environment, "rigs", "mars").stdout == built_in_path("mars").read_text()
    unknown = ffmap_here(environment, "rigs", "mrs")
    assert (unknown.returncode, unknown.stderr.count("\n")) == (2, 1)
    assert "did you mean mars?" in unknown.stderr


def test_a_printed_rig_is_a_rig_file_and_run_json_says_which_was_used(tmp_path: Path) -> None:
    environment, bag = with_cache(tmp_path / "cache"), tmp_path / "drive.bag"
    simulate(bag, SimulationSettings(building="small", seed=3, duration_s=2.0, layout="mars"))
    mine = tmp_path / "mine.toml"
    mine.write_text(ffmap_here(environment, "rigs", "mars").stdout)
    said = {}
    for name, options in {"auto": [], "named": ["--rig", "mars"], "file": ["--rig", str(mine)]}.items():
        info = ffmap_here(environment, "info", bag, *options)
        assert info.returncode == 0, info.stderr
        said[name] = next(line for line in info.stdout.splitlines() if "extrinsics from" in line)
        assert ("by its topics and frames" in info.stdout) == (name == "auto")
    assert said["auto"] == said["named"] == "  extrinsics from: the built-in rig mars"
    assert said["file"] == f"  extrinsics from: the rig file {mine}"
    words = ("run", bag, "--out", tmp_path / "run", "--detail", "map", "--quiet")
    done = ffmap_here(environment, *words)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["mounts_from"] == "the built-in rig mars"
    assert record["rig"]["vertical"]["frame"] == "horizontal_velodyne"
    assert any("built-in rig mars" in warning for warning in record["warnings"])
