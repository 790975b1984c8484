"""A drive in three files has the labels of the drive in one, to the last bit, wherever it is cut."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.loaders.bag_builder import PERIOD_NS
from tests.parts import PACKETS, cut, in_one_folder, in_packets
from tests.program import ffmap_here, kill_once, with_cache

TOPICS = ("/horizontal_velodyne/velodyne_points", "/vertical_velodyne/velodyne_points")
PLACES_S = (1.53, 3.27)
"""From the bag's beginning; between two clouds of each lidar."""


def drive(folder: Path, container: str) -> Path:
    bag = folder / ("drive.bag" if container == "bag" else f"drive_{container}")
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "format": container, "duration_s": 5.0}
    simulate(bag, SimulationSettings.model_validate(values))
    return bag


def cut_in_three(bag: Path, folder: Path) -> list[Path]:
    with open_bag(bag) as opened:
        assert opened.start_ns is not None
        return cut(bag, folder, [opened.start_ns + round(1e9 * place) for place in PLACES_S])


def record_of(environment: dict[str, str], out: Path, *words: object) -> dict[str, Any]:
    """What run.json holds of a run with one worker that writes labels alone."""
    options = ("--outputs", "labels", "--workers", 1, "--no-evaluate", "--quiet")
    done = ffmap_here(environment, "run", *words, "--out", out, *options)
    assert done.returncode == 0, done.stderr
    record: dict[str, Any] = json.loads((out / "run.json").read_text())
    return record


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return with_cache(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("drive"), "bag")


@pytest.fixture(scope="module")
def record(whole: Path, environment: dict[str, str]) -> dict[str, Any]:
    """Of the run on the drive in one file."""
    return record_of(environment, whole.parent / "run", whole)


def test_a_run_on_parts_that_was_killed_goes_on_to_the_same_labels(
    whole: Path, record: dict[str, Any], environment: dict[str, str], tmp_path: Path
) -> None:
    first, second, third = cut_in_three(whole, tmp_path)
    out = tmp_path / "run"
    words = ("run", third, first, second, "--out", out, "--outputs", "labelled-bag,labels", "--quiet")
    kill_once(environment, lambda: list(out.glob("spool/*.arrow")), *words)
    away = second.rename(tmp_path / "away.bag")
    refused = ffmap_here(environment, "run", "--resume", out)
    assert refused.returncode == 2
    assert refused.stderr.startswith(f"ffmap: {second}: the run's bag is gone")
    away.rename(second)
    done = ffmap_here(environment, "run", "--resume", out)
    assert done.returncode == 0, done.stderr
    assert "from the cache" in done.stdout + done.stderr
    resumed = json.loads((out / "run.json").read_text())
    assert resumed["bag"]["parts"] == [str(first), str(second), str(third)]
    assert resumed["bag"]["path"] == str(first)
    assert resumed["labels_digest"] == record["labels_digest"]
    with open_bag(out / "labelled.bag") as labelled, open_bag(whole) as one:
        assert index_clouds(labelled, TOPICS[1]).stamp_ns.tolist() == index_clouds(one, TOPICS[1]).stamp_ns.tolist()
    again = ffmap_here(environment, "inspect", out, "--scan", 15, "--out", tmp_path / "scan.rrd")
    assert again.returncode == 0, again.stderr
    assert "labels equal" in again.stdout
    moved = [path.rename(path.with_name(f"moved_{path.name}")) for path in (first, second, third)]
    words = [word for path in moved for word in ("--bag", path)]
    assert ffmap_here(environment, "inspect", out, "--scan", 15, *words, "--out", tmp_path / "scan.rrd").returncode == 0


@pytest.mark.parametrize("container", ["mcap", "db3"])
def test_parts_of_ros_2_give_the_same_labels(
    record: dict[str, Any], environment: dict[str, str], tmp_path: Path, container: str
) -> None:
    parts = cut_in_three(drive(tmp_path, container), tmp_path)
    paths = parts if container == "mcap" else [in_one_folder(parts, tmp_path / "folder")]
    assert record_of(environment, tmp_path / "run", *paths)["labels_digest"] == record["labels_digest"]


def test_a_revolution_that_the_cut_goes_through_is_joined(
    whole: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    packets = in_packets(whole, TOPICS)
    expected = record_of(environment, tmp_path / "one", packets)
    with open_bag(packets) as opened:
        indexes = [index_clouds(opened, topic) for topic in TOPICS]
    assert all(abs(index.message_count - PACKETS).max() <= 1 for index in indexes)
    # Within a revolution of both lidars, from the first of whose messages it is far to the next revolution.
    begins_ns = sorted(time for index in indexes for time in index.log_time_ns.tolist())
    wide = [(a + b) // 2 for a, b in pairwise(begins_ns) if b - a > PERIOD_NS // 4]
    places_ns = [wide[len(wide) // 3], wide[2 * len(wide) // 3]]
    parts = cut(packets, tmp_path, places_ns)
    with open_bag(parts[0]) as opened:
        assert all(index_clouds(opened, topic).message_count[-1] < PACKETS - 2 for topic in TOPICS)
    found = record_of(environment, tmp_path / "parts", *parts)
    assert found["labels_digest"] == expected["labels_digest"]


def test_what_is_no_drive_is_one_line(whole: Path, environment: dict[str, str]) -> None:
    for command in ("run", "info"):
        refused = ffmap_here(environment, command, whole, whole)
        assert refused.returncode == 2
        (line,) = refused.stderr.splitlines()
        assert line.startswith(f"ffmap: {whole}: its ")
        assert line.endswith("; give the parts of one drive, each once")
