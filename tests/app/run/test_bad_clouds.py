"""Damaged clouds are skipped, the others are labelled, and the run reports which and why."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader, Writer

from ffmap.algorithms.building.final_labels import Relabelling
from ffmap.app.run import blocks
from ffmap.loaders.bag import Message, make_typestore
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.app.run.test_scans import failing
from tests.loaders.bag_builder import CLOUD
from tests.program import ffmap_here, with_cache

VERTICAL, HORIZONTAL = "/vertical_velodyne/velodyne_points", "/horizontal_velodyne/velodyne_points"


def changed(
    bag: Path, path: Path, changes: dict[tuple[str, int], Callable[[Message], None]]
) -> Path:
    """The same bag with some clouds changed, by their topic and number."""
    store = make_typestore(1)
    numbers = {VERTICAL: 0, HORIZONTAL: 0}
    with Reader(bag) as reader, Writer(path) as writer:
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=store)
            for c in reader.connections
        }
        for connection, time_ns, data in reader.messages():
            if connection.topic in numbers:
                change = changes.get((connection.topic, numbers[connection.topic]))
                numbers[connection.topic] += 1
                if change is not None:
                    message = store.deserialize_ros1(data, CLOUD)
                    message.data = message.data.copy()
                    change(message)
                    data = store.serialize_ros1(message, CLOUD)
            writer.write(connections[connection.id], time_ns, data)
    return path


def empty_without_layout(message: Message) -> None:
    message.width, message.point_step, message.row_step, message.data = 0, 0, 0, message.data[:0]


def truncated(message: Message) -> None:
    message.data = message.data[:100]


def with_a_return_far_away(message: Message) -> None:
    message.data[: 3 * 4] = np.array([0.0, 10_000.0, 0.0], np.float32).view(np.uint8)


def all_far_away(message: Message) -> None:
    message.data.reshape(-1, message.point_step)[:, :4] = np.array([5e5], np.float32).view(np.uint8)


def test_clouds_that_are_wrong_cost_themselves_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "duration_s": 1.5}
    simulate(tmp_path / "sound.bag", SimulationSettings.model_validate(values))
    bag = changed(
        tmp_path / "sound.bag",
        tmp_path / "bad.bag",
        {
            (VERTICAL, 0): empty_without_layout,
            (VERTICAL, 4): with_a_return_far_away,
            (VERTICAL, 6): all_far_away,
            (HORIZONTAL, 6): truncated,
        },
    )
    monkeypatch.setattr(
        Relabelling, "labels", failing(Relabelling.labels, {2}, ValueError("no face"))
    )
    out = tmp_path / "run"
    options = ("--outputs", "labels,maps", "--no-evaluate", "--quiet", "--workers", 1)
    done = ffmap_here(with_cache(tmp_path / "cache"), "run", bag, "--out", out, *options)
    assert done.returncode == 0, done.stderr
    record = json.loads((out / "run.json").read_text())
    counts = record["counts"]
    assert counts["clouds"] - counts["scans"] == 2
    assert counts["skipped"] == {"no points": 1, "no return within 100 m (scan.range_max_m)": 1}
    assert counts["beyond_range"] == 1
    both = "no points (1), no return within 100 m (scan.range_max_m) (1)"
    assert f"2 vertical clouds skipped: {both}" in record["warnings"]
    warnings = "\n".join(record["warnings"])
    assert (
        "returns farther than 100 m away were left out (scan.range_max_m): 1, in 1 of" in warnings
    )
    assert f"1 of 14 horizontal clouds skipped: {HORIZONTAL}: the cloud is truncated" in warnings
    assert (
        "1 scans keep the labels that they have alone: final labelling failed (ValueError: no face)"
        in warnings
    )
    assert "no face" in record["tracebacks"]["ValueError: no face"]
    columns, rows = (int(word) for word in (out / "map.pgm").read_bytes().split(b"\n")[1].split())
    assert columns * rows < 500 * 500


def test_a_run_whose_scans_fail_ends_with_one_line_and_keeps_the_traceback(
    small_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing_scan = failing(blocks.label_scan, set(range(99)), ValueError("no wall"))
    monkeypatch.setattr(blocks, "label_scan", failing_scan)
    words = ("run", small_bag, "--out", tmp_path / "run", "--quiet", "--workers", 1)
    done = ffmap_here(with_cache(small_bag.parent / "cache"), *words)
    assert done.returncode == 2
    assert "so far, 20 times with ValueError: no wall" in done.stderr
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["outcome"] == "aborted"
    assert "raise error" in record["tracebacks"]["ValueError: no wall"]
