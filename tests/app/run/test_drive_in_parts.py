"""A drive in three files has the labels of the drive in one, wherever it is cut."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_index import index_clouds
from tests.loaders.bag_builder import PERIOD_NS
from tests.parts import PACKETS, cut, in_packets
from tests.program import ffmap_here, with_cache

TOPICS = ("/horizontal_velodyne/velodyne_points", "/vertical_velodyne/velodyne_points")
PLACES_S = (1.53, 3.27)
"""From the bag's beginning; between two clouds of each lidar."""


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


@pytest.fixture
def environment(small_bag: Path) -> dict[str, str]:
    return with_cache(small_bag.parent / "cache")


def test_parts_give_the_same_labels_in_any_order_and_all_are_needed(
    small_bag: Path, small_run: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    first, second, third = cut_in_three(small_bag, tmp_path)
    record = json.loads((small_run / "run.json").read_text())
    out = tmp_path / "run"
    found = record_of(environment, out, third, first, second)
    assert found["labels_digest"] == record["labels_digest"]
    assert found["bag"]["parts"] == [str(first), str(second), str(third)]
    (out / "run.json").write_text(json.dumps(found | {"outcome": "aborted"}))
    second.rename(tmp_path / "moved.bag")
    refused = ffmap_here(environment, "run", "--resume", out)
    assert refused.returncode == 2
    assert refused.stderr.startswith(f"ffmap: {second}: the bag of the run is missing")
    # Wherever the parts are now, a scan can be labelled again.
    words = [word for path in (first, tmp_path / "moved.bag", third) for word in ("--bag", path)]
    words += ["--scan", 15, "--out", tmp_path / "scan.rrd"]
    again = ffmap_here(environment, "inspect", out, *words)
    assert again.returncode == 0, again.stderr
    assert "labels equal" in again.stdout


def test_a_revolution_that_the_cut_goes_through_is_joined(
    small_bag: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    packets = in_packets(small_bag, TOPICS)
    expected = record_of(environment, tmp_path / "one", packets)
    with open_bag(packets) as opened:
        indexes = [index_clouds(opened, topic) for topic in TOPICS]
    assert all(abs(index.message_count - PACKETS).max() <= 1 for index in indexes)
    # Within a revolution of both lidars, far from the next one.
    begins_ns = sorted(time for index in indexes for time in index.log_time_ns.tolist())
    wide = [(a + b) // 2 for a, b in pairwise(begins_ns) if b - a > PERIOD_NS // 4]
    places_ns = [wide[len(wide) // 3], wide[2 * len(wide) // 3]]
    parts = cut(packets, tmp_path, places_ns)
    with open_bag(parts[0]) as opened:
        assert all(index_clouds(opened, topic).message_count[-1] < PACKETS - 2 for topic in TOPICS)
    found = record_of(environment, tmp_path / "parts", *parts)
    assert found["labels_digest"] == expected["labels_digest"]


def test_what_is_no_drive_is_one_line(small_bag: Path, environment: dict[str, str]) -> None:
    for command in ("run", "info"):
        refused = ffmap_here(environment, command, small_bag, small_bag)
        assert refused.returncode == 2
        (line,) = refused.stderr.splitlines()
        assert line.startswith(f"ffmap: {small_bag}: its ")
        assert line.endswith("; give the parts of one drive, each once")
