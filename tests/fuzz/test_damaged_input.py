"""With damaged files of users, a command succeeds or fails with one line and exit code 2.

A few cases each, always the same; with --hypothesis-profile=long many, others every time.
"""

import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from PIL import Image

from ffmap.app.folder.atomic import write_geojson, write_json
from ffmap.app.setup.settings import Settings, as_toml
from ffmap.loaders.bag import make_typestore
from tests.app.analysis.test_evaluation import BUILDING, make_run, make_truth_bag
from tests.fuzz import reading
from tests.fuzz.damage import WORDS, damaged, damaged_json, damaged_text
from tests.fuzz.sandbox import Sandbox
from tests.loaders.bag_builder import (
    PERIOD_NS,
    START_NS,
    cloud,
    clouds,
    header,
    sweep,
    tf_message,
    write_bag,
)
from tests.loaders.test_recovery import foreign_mcap

HEAVY = 4
"""How many times as long a run's folder takes as a file."""


def fewer(test: Callable[..., None]) -> Callable[..., None]:
    return settings(max_examples=max(3, settings().max_examples // HEAVY))(test)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for what is damaged."""
    return tmp_path_factory.mktemp("whole")


def fresh(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


def read(sandbox: Sandbox, bag: Path) -> None:
    """Describe a bag, read its scans, ground truth and poses."""
    sandbox.ffmap("info", bag)
    sandbox.run(reading.read_every_scan, bag)
    sandbox.run(reading.read_truth_and_poses, bag)


def extrinsics(ros_version: int) -> Any:
    tilt = (0.0, 0.7071067811865476, 0.0, 0.7071067811865476)
    edges = [("base", "h", (0, 0, 1), (0, 0, 0, 1)), ("base", "v", (0, 0, 0.8), tilt)]
    return tf_message(edges, ros_version)


def small_drive(ros_version: int) -> list[Any]:
    """Two lidars, four sweeps each, and their extrinsics."""
    small = {"columns": 16, "elevations_deg": (-3, -1, 1, 3)}
    entries = [
        ("/tf_static", START_NS, extrinsics(ros_version)),
        *clouds("/h", 4, "h", ros_version, **small),
        *clouds("/v", 4, "v", ros_version, late_ns=10**6, **small),
    ]
    return sorted(entries, key=lambda entry: entry[1])


BAGS = {
    "ROS 1": ("a.bag", ""),
    "ROS 1, lz4": ("a.bag", "lz4"),
    "sqlite3": ("a_db3", ""),
    "sqlite3, file": ("a_db3", "file"),
    "MCAP, messages": ("a_mcap", "message"),
    "MCAP, no chunks": ("a.mcap", "none"),
    "MCAP, zstd": ("a.mcap", "zstd"),
}
"""Names and compressions; the last two as written by ROS 2's own recorder."""


@cache
def whole_bag(kind: str, folder: Path) -> Path:
    """A small drive in a container; a file, or a folder of metadata.yaml and one file."""
    name, compression = BAGS[kind]
    path = fresh(folder / kind) / name
    if path.suffix == ".mcap":
        chunked = compression != "none"
        return foreign_mcap(path, small_drive(2), chunked, CompressionType[compression.upper()])
    drive = small_drive(1 if path.suffix == ".bag" else 2)
    return write_bag(path, drive, 3000, compression)


@pytest.mark.parametrize("kind", BAGS)
@given(data=st.data())
def test_bags(kind: str, data: st.DataObject, sandbox: Sandbox, place: Path) -> None:
    whole = whole_bag(kind, place)
    case = fresh(sandbox.folder / "case") / whole.name
    if whole.is_dir():
        shutil.copytree(whole, case)
        file = data.draw(st.sampled_from(sorted(path.name for path in whole.iterdir())))
        (case / file).write_bytes(data.draw(damaged((whole / file).read_bytes())))
        alone = file != "metadata.yaml" and data.draw(st.booleans())
        case = case / file if alone else case
    else:
        case.write_bytes(data.draw(damaged(whole.read_bytes())))
    read(sandbox, case)


numbers = st.one_of(
    st.sampled_from((0, 1, 2, 3, 384, 2**16, 2**31 - 1, 2**32 - 1)), st.integers(0, 2**32 - 1)
)
field = st.tuples(
    st.sampled_from(
        [*["x", "y", "z", "ring", "time", "t", "timestamp", "intensity", "é", "label"], ""]
    ),
    st.one_of(st.integers(0, 30), numbers),
    st.one_of(st.integers(1, 8), st.integers(0, 255)),
    st.one_of(st.just(1), numbers),
)
values = st.one_of(
    st.floats(width=32),
    st.sampled_from((0.0, 1e30, -1e30, 1e6, 1e-30, float("nan"), float("inf"))),
)


@st.composite
def points(draw: st.DrawFn) -> bytes:
    """Points of which some columns, or some of the rows, have other values."""
    made = sweep(24)
    for name in draw(st.sets(st.sampled_from(made.dtype.names), min_size=1)):
        start, stop = (draw(st.integers(0, len(made))) for _ in range(2))
        rows = slice(start, stop, draw(st.integers(1, 50)))
        value = draw(values) if made.dtype[name].kind == "f" else draw(st.integers(0, 2**16 - 1))
        made[name][rows] = value
    return made.tobytes()


changes = st.fixed_dictionaries(
    {},
    optional={
        "height": numbers,
        "width": numbers,
        "point_step": numbers,
        "row_step": numbers,
        "is_bigendian": st.booleans(),
        "fields": st.lists(field, max_size=8),
        "data": st.one_of(points(), st.binary(max_size=100), damaged(sweep(24).tobytes())),
        "frame_id": st.sampled_from(("", "h", "/v", "x" * 1000, "a b")),
    },
)


@given(change=changes, every=st.booleans())
def test_clouds(change: dict[str, Any], every: bool, sandbox: Sandbox) -> None:
    """A bag in which all clouds, or one, have other attributes."""
    types, good = make_typestore(1).types, sweep(24)
    entries: list[Any] = [("/tf_static", START_NS, extrinsics(1))]
    for i in range(6):
        message = cloud(good, START_NS + i * PERIOD_NS, "v")
        for name, value in change.items() if every or i == 3 else ():
            if name == "fields":
                value = [types["sensor_msgs/msg/PointField"](*field) for field in value]
            if name == "data":
                value = np.frombuffer(value, np.uint8)
            setattr(message.header if name == "frame_id" else message, name, value)
        entries.append(("/v", START_NS + (i + 1) * PERIOD_NS, message))
    read(sandbox, write_bag(fresh(sandbox.folder / "case") / "a.bag", entries))


def packet(mode: int, model: int) -> bytes:
    """A packet of a Velodyne: 12 blocks of 32 returns at 5 m, time, return mode and model."""
    block = b"\xff\xee" + bytes(2) + (2500).to_bytes(2, "little").ljust(3, b"\x20") * 32
    blocks = b"".join(block[:2] + (3000 * i).to_bytes(2, "little") + block[4:] for i in range(12))
    return blocks + bytes(4) + bytes((mode, model))


packets = st.tuples(
    st.sampled_from((0x37, 0x38, 0x39, 0)), st.sampled_from((0x21, 0x22, 0x28, 0x63, 0xA1, 0))
).flatmap(lambda kind: st.one_of(st.just(packet(*kind)), damaged(packet(*kind))))


@given(data=st.lists(st.tuples(packets, st.integers(-(10**10), 10**10)), max_size=8))
def test_packets(data: list[tuple[bytes, int]], sandbox: Sandbox) -> None:
    """A bag of three equal scans of packets of 1206 bytes."""
    types = make_typestore(1).types
    make, scan = types["velodyne_msgs/msg/VelodynePacket"], types["velodyne_msgs/msg/VelodyneScan"]
    entries: list[Any] = []
    for stamp in (START_NS, START_NS + PERIOD_NS, START_NS + 2 * PERIOD_NS):
        made = [
            make(
                header(types, stamp + later, "v").stamp,
                np.frombuffer(content.ljust(1206, b"\0")[:1206], np.uint8),
            )
            for content, later in data
        ]
        entries.append(("/packets", stamp + 1, scan(header(types, stamp, "v"), made)))
    read(sandbox, write_bag(fresh(sandbox.folder / "case") / "a.bag", entries))


RIG = """base = "base"
[[lidar]]
topic = "/h"
role = "horizontal"
translation = [ 0.1 , 0.0 , 0.9 ]
rpy_deg = [ 0 , 0 , 0 ]
[[lidar]]
frame = "v"
translation = [ 0.3 , 0.0 , 0.6 ]
quaternion_xyzw = [ 0.0 , 0.7071 , 0.0 , 0.7071 ]
"""


@given(text=damaged_text(RIG, ('"vertical"', '"/v"', '"h"')))
def test_rigs(text: bytes, sandbox: Sandbox, place: Path) -> None:
    path = fresh(sandbox.folder / "case") / "rig.toml"
    path.write_bytes(text)
    bag = whole_bag("ROS 1", place)
    sandbox.ffmap("info", bag, "--rig", path)
    sandbox.run(reading.read_every_scan, bag, path)


TUM = "".join(f"{1.7e9 + i / 10:.9f} {i / 10:.3f} 0.0 0.0 0.0 0.0 0.0 1.0\n" for i in range(6))


@given(text=damaged_text(TUM))
def test_trajectories(text: bytes, sandbox: Sandbox) -> None:
    path = fresh(sandbox.folder / "case") / "poses.tum"
    path.write_bytes(text)
    sandbox.run(reading.read_trajectory, path)


words = st.one_of(
    st.sampled_from(WORDS), st.integers().map(str), st.floats().map(str), st.text(max_size=30)
)
names = st.one_of(st.sampled_from(tuple(Settings().flat())), words)


@given(
    text=damaged_text(as_toml(Settings())),
    override=st.lists(st.builds("{}={}".format, names, words) | words, max_size=4),
    both=st.booleans(),
)
def test_settings(text: bytes, override: list[str], both: bool, sandbox: Sandbox) -> None:
    path = fresh(sandbox.folder / "case") / "config.toml"
    path.write_bytes(text)
    options = [f"--set={word}" for word in override]
    sandbox.ffmap("settings", "--config", path, *(options if both else ()))
    sandbox.ffmap("settings", *options)


MAP = """image: map.pgm
resolution: 0.05
origin: [ -3.0 , 2.0 , 0.0 ]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.25
mode: trinary
"""


@cache
def whole_image(name: str, folder: Path) -> bytes:
    pixels = np.full((60, 80), 254, np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = pixels[:, 40] = 0
    pixels[20:36, 40] = 254
    Image.fromarray(pixels).save(folder / name)
    return (folder / name).read_bytes()


@fewer
@given(
    data=st.data(),
    name=st.sampled_from(["pgm", "png", "tif", "bmp", "gif", "jpg", "webp"]).map("map.{}".format),
)
def test_maps(data: st.DataObject, name: str, sandbox: Sandbox, place: Path) -> None:
    folder = fresh(sandbox.folder / "case")
    text, image = MAP.replace("map.pgm", name).encode(), whole_image(name, place)
    if data.draw(st.booleans()):
        text = data.draw(damaged_text(text.decode(), ("scale", "raw")))
    else:
        image = data.draw(damaged(image))
    (folder / "map.yaml").write_bytes(text)
    (folder / name).write_bytes(image)
    sandbox.ffmap("rooms", folder / "map.yaml", "--out", folder / "rooms")


@cache
def whole_run(folder: Path) -> Path:
    """A run's folder with a file of each kind, made of a bag with its truth."""
    bag, classes = make_truth_bag(folder / "in.bag")
    run = make_run(folder / "run", bag, classes)
    write_json(
        run / "run.json",
        {
            "recording_id": "a run",
            "outcome": "complete",
            "bag": {"path": str(bag), "digest": "0"},
            "options": {"time_from": "auto"},
            "settings": Settings().model_dump(mode="json"),
            "rig": {"vertical": {"topic": "/vertical"}},
            "counts": {"walls": 3},
            "timings_s": {"total": 2.5},
        },
    )
    write_json(run / "metrics.json", {"wall.f1": 0.9})
    line = {"type": "LineString", "coordinates": [[0.0, 0.0], [1.0, 2.0]]}
    write_geojson(run / "walls.geojson", [{"properties": {"thickness": 0.1}, "geometry": line}])
    square = {"type": "Polygon", "coordinates": [[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 0.0]]]}
    room = {"properties": {"area": 2.0, "name": "1"}, "geometry": square}
    write_geojson(run / "rooms.geojson", [room])
    return run


@st.composite
def damaged_runs(draw: st.DrawFn, whole: Path, case: Path) -> Path:
    """The folder of a run in which one file is damaged, or missing."""
    shutil.copytree(whole, case)
    file = draw(st.sampled_from(sorted(path.name for path in whole.iterdir())))
    content = (whole / file).read_bytes()
    if draw(st.integers(0, 19)) == 0:
        (case / file).unlink()
    elif file.endswith("json"):
        (case / file).write_bytes(draw(damaged_json(content.decode())))
    elif file.endswith((".tum", ".yaml")):
        (case / file).write_bytes(draw(damaged_text(content.decode())))
    else:
        (case / file).write_bytes(draw(damaged(content)))
    return case


@fewer
@given(data=st.data(), command=st.sampled_from(("evaluate", "compare", "runs")))
def test_runs(data: st.DataObject, command: str, sandbox: Sandbox, place: Path) -> None:
    whole, folder = whole_run(place), fresh(sandbox.folder / "case")
    run = data.draw(damaged_runs(whole, folder / "run"))
    words = {
        "evaluate": ("evaluate", run, "--workers", 1),
        "compare": ("compare", whole, run, "--out", folder / "out", "--no-scans", "--quiet"),
        "runs": ("runs", folder),
    }
    sandbox.ffmap(*words[command])


@fewer
@given(building=damaged_json(json.dumps(BUILDING)))
def test_true_buildings(building: bytes, sandbox: Sandbox, place: Path) -> None:
    folder = fresh(sandbox.folder / "case")
    bag, _ = make_truth_bag(folder / "truth.bag", building=building.decode(errors="replace"))
    run = shutil.copytree(whole_run(place), folder / "run")
    sandbox.ffmap("evaluate", run, "--truth", bag, "--workers", 1)
