"""Roles by the spin axes, extrinsics by transforms or rig file, and errors without them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.rig import MountCorrection
from tests.loaders.bag_builder import (
    PERIOD_NS,
    START_NS,
    cloud,
    clouds,
    odometry,
    only,
    sweep,
    tf_message,
    write_bag,
)

UPRIGHT = [0.0, 0.0, -0.7071067811865476, 0.7071067811865476]
LYING = [0.5, 0.5, 0.5, 0.5]
# The paper's own rig: the names describe the spin axis, not the role.
MARS = [
    ("base_link", "vertical_velodyne", [0.12, 0.01, 0.568], UPRIGHT),
    ("/base_link", "/horizontal_velodyne", [0.3, 0.01, 0.348], LYING),
]
WIDE = tuple(range(-45, 46, 3))


def two_lidars(edges, ros_version=1, **options):
    entries = [
        *clouds("/v/points", 4, "vertical_velodyne", ros_version),
        *clouds("/h/points", 4, "/horizontal_velodyne", ros_version, PERIOD_NS // 3, **options),
    ]
    if edges:
        entries.append(("/tf_static", START_NS, tf_message(edges, ros_version)))
    return entries


def three_lidars(left, right, **options):
    """An upright lidar that opens to 30 degrees, and two more, with their quaternions."""
    edges = [
        MARS[0],
        ("base_link", "left", [0, 0.2, 0.5], left),
        ("base_link", "right", [0, -0.2, 0.5], right),
    ]
    return [
        *clouds("/v/points", 4, "vertical_velodyne"),
        *clouds("/right/points", 4, "right", late_ns=PERIOD_NS // 4, **options),
        *clouds("/left/points", 4, "left", late_ns=PERIOD_NS // 3, **options),
        ("/tf_static", START_NS, tf_message(edges, 1)),
    ]


@pytest.fixture
def bag_of(tmp_path):
    """Write a bag of entries."""

    def write(entries, name="a.bag"):
        return write_bag(tmp_path / name, sorted(entries, key=lambda entry: entry[1]))

    return write


def rig_of(path, **options):
    with open_bag(path) as bag:
        return find_rig(bag, **options)


def error_of(path, **options):
    with pytest.raises(InputError) as caught:
        rig_of(path, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def topics(rig):
    return rig.horizontal.topic, [lidar.topic for lidar in rig.verticals]


def test_roles_by_the_spin_axis_not_by_name(bag_of):
    rig = rig_of(bag_of(two_lidars(MARS)))
    assert rig.base_frame == "base_link"
    assert topics(rig) == ("/v/points", ["/h/points"])
    assert rig.vertical.frame_id == "horizontal_velodyne"
    np.testing.assert_allclose(rig.horizontal.T_base_sensor[:3, 3], [0.12, 0.01, 0.568])
    np.testing.assert_allclose(rig.vertical.T_base_sensor[:3, 2], [1, 0, 0], atol=1e-12)
    assert (rig.vertical.column_pairs, rig.vertical.line_pairs) == (0, 16)
    children = {edge.child for edge in rig.static_transforms}
    assert children == {"vertical_velodyne", "horizontal_velodyne"}
    assert not rig.warnings
    loop = [*MARS, ("vertical_velodyne", "base_link", [0, 0, 0], [0, 0, 0, 1])]
    assert rig_of(bag_of(two_lidars(loop, 2), "loop_mcap")).base_frame == "base_link"


def test_roles_may_be_overridden(bag_of):
    path = bag_of(two_lidars(MARS))
    rig = rig_of(path, horizontal="h/points", verticals=["/v/points"])
    assert topics(rig) == ("/h/points", ["/v/points"])
    assert rig.horizontal.reasons == "--horizontal names it"
    assert topics(rig_of(path, verticals=["/v/points"])) == ("/h/points", ["/v/points"])
    both = rig_of(path, horizontal="/v/points", verticals=["/v/points"])
    assert topics(both) == ("/v/points", ["/v/points"])
    error = error_of(path, verticals=["/nothing"])
    assert "--vertical /nothing is no topic with clouds; the bag's clouds are on: /h" in error


@pytest.mark.parametrize(
    ("top", "below", "base", "height_m"),
    [
        ("base_footprint", "base_link", "base_footprint", 0.768),
        ("world", "base_link", "base_link", 0.568),
        ("r1/base_footprint", "base_link", "r1/base_footprint", 0.768),
        ("chassis", "trunk", "chassis", 0.768),
    ],
)
def test_base_is_the_topmost_frame_of_the_robot(bag_of, top, below, base, height_m):
    edges = [(*(n.replace("base_link", below) for n in edge[:2]), *edge[2:]) for edge in MARS]
    rig = rig_of(bag_of(two_lidars([(top, below, [0, 0, 0.2], [0, 0, 0, 1]), *edges])))
    assert rig.base_frame == base
    np.testing.assert_allclose(rig.horizontal.T_base_sensor[:3, 3], [0.12, 0.01, height_m])


def test_transforms_on_tf_that_never_change(bag_of):
    entries = two_lidars([])
    for i in range(40):
        moving = [("odom", "base_link", [0.1 * i, 0, 0], [0, 0, 0, 1])]
        entries.append(("/tf", START_NS + i * PERIOD_NS // 10, tf_message([*MARS, *moving])))
    rig = rig_of(bag_of(entries))
    assert (rig.base_frame, rig.vertical.topic) == ("base_link", "/h/points")


def test_lidars_without_transforms_between_them(bag_of):
    elsewhere = ("elsewhere", "horizontal_velodyne", [0, 0, 0], LYING)
    for number, edges in enumerate(([], MARS[:1], [MARS[0], elsewhere])):
        text = error_of(bag_of(two_lidars(edges), f"{number}.bag"))
        for part in ("no transforms join", "vertical_velodyne", "(/h/points)", "--rig FILE"):
            assert part in text


def test_one_narrow_lidar_is_labelled_only_by_name(bag_of):
    path = bag_of(clouds("/points", 3))
    rig = rig_of(path)
    assert (rig.base_frame, rig.vertical) == ("lidar", None)
    np.testing.assert_array_equal(rig.horizontal.T_base_sensor, np.eye(4))
    assert rig.warnings[0].startswith("nothing to label: no lidar is on its side, and /points")
    rig = rig_of(path, verticals=["/points"])
    assert topics(rig) == ("/points", ["/points"])
    assert rig.vertical.line_pairs == rig.vertical.column_pairs > 0
    assert any("upright, and opens to 30 deg" in warning for warning in rig.warnings)


def test_one_wide_lidar_has_both_roles(bag_of):
    entries = clouds("/points", 3, elevations_deg=WIDE)
    rig = rig_of(bag_of(entries))
    assert topics(rig) == ("/points", ["/points"])
    assert rig.vertical.opening_deg == pytest.approx(90.0, abs=0.1)
    assert not rig.warnings
    for _, _, message in entries:
        message.fields[-1].name = "nothing"
    (warning,) = rig_of(bag_of(entries, "untimed.bag")).warnings
    assert warning.startswith("/points (horizontal and vertical): its points have no times")
    timed = rig_of(bag_of(entries, "azimuth.bag"), time_from="azimuth")
    assert timed.horizontal.decoding.timed
    assert not timed.warnings


def test_of_two_upright_lidars_wide_ones_are_labelled(bag_of):
    edges = [(p, c, t, UPRIGHT) for p, c, t, _ in MARS]
    narrow = rig_of(bag_of(two_lidars(edges), "narrow.bag"))
    assert narrow.vertical is None
    assert any("nothing to label" in warning for warning in narrow.warnings)
    wide = rig_of(bag_of(two_lidars(edges, elevations_deg=WIDE)))
    assert wide.vertical.topic == "/h/points"
    mixed = rig_of(bag_of(three_lidars(LYING, UPRIGHT, elevations_deg=WIDE), "mixed.bag"))
    assert topics(mixed) == ("/right/points", ["/left/points", "/right/points"])
    assert [lidar.column_pairs > 0 for lidar in mixed.verticals] == [False, True]


def test_all_lidars_on_their_side_are_labelled(bag_of):
    tilted = (Rotation.from_quat(LYING) * Rotation.from_euler("x", 7, degrees=True)).as_quat()
    path = bag_of(three_lidars(tilted, LYING))
    rig = rig_of(path)
    assert topics(rig) == ("/v/points", ["/right/points", "/left/points"])
    assert [lidar.column_pairs for lidar in rig.verticals] == [0, 0]
    assert "level (0.0 deg off)" in rig.verticals[0].reasons
    assert "7.0 deg off level" in rig.verticals[1].reasons
    assert not rig.warnings
    named = rig_of(path, verticals=["left/points", "/right/points", "/left/points"])
    assert topics(named) == ("/v/points", ["/left/points", "/right/points"])
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    moved = rig.with_mount(MountCorrection("/left/points", tuple(map(tuple, turned)), 5))
    before, after = rig.verticals[0], moved.verticals[0]
    np.testing.assert_array_equal(after.T_base_sensor, before.T_base_sensor)
    assert [lidar.decoding.clock_ns for lidar in moved.verticals] == [0, 5]
    np.testing.assert_array_equal(moved.tree.between("base_link", "left"), turned)


def camera(columns, place):
    """Clouds of a depth camera that looks along x, or along z as REP 103 has it."""
    seen = only(sweep(columns=columns), "x", "y", "z")
    if place == "z":
        seen["z"] = 4.0
    else:
        seen["x"] = np.abs(seen["x"]) + 1
        seen["y"] *= 0.3
    return seen


@pytest.mark.parametrize("axis", ["x", "z"])
def test_copies_and_cameras_are_not_used(bag_of, axis):
    entries = two_lidars([*MARS, ("base_link", "camera", [0, 0, 1], LYING)])
    for i in range(4):
        stamp_ns = START_NS + i * PERIOD_NS
        copy = only(sweep(columns=30, seed=i), "x", "y", "z")
        for topic, points, frame in (
            ("/v/filtered", copy, "vertical_velodyne"),
            ("/camera/points", camera(30, axis), "camera"),
        ):
            entries.append((topic, stamp_ns + PERIOD_NS, cloud(points, stamp_ns, frame)))
    rig = rig_of(bag_of(entries))
    assert topics(rig) == ("/v/points", ["/h/points"])
    assert "not used: /camera/points (a depth camera" in rig.warnings[0]
    assert "not used: /v/filtered (/v/points is the better cloud" in rig.warnings[1]


def test_two_sensors_with_one_frame_need_a_rig_file(bag_of, tmp_path):
    path = bag_of([*clouds("/a", 4, "velodyne"), *clouds("/b", 4, "velodyne", late_ns=7)])
    assert "/a and /b both have frame velodyne" in error_of(path)
    file = tmp_path / "rig.toml"
    file.write_text(
        '[[lidar]]\ntopic = "/a"\ntranslation = [0, 0, 1]\n'
        '[[lidar]]\ntopic = "b"\nrpy_deg = [90, 0, 0]\n'
    )
    rig = rig_of(path, rig_file=file)
    assert (rig.base_frame, *topics(rig)) == ("base_link", "/a", ["/b"])


CARTOGRAPHER = """
base = "base_link"
[[lidar]]
frame = "/vertical_velodyne"
translation = [0.01, 0.0, 0.19]
rpy_deg = [0.0, -10.0, 180.0]
[[lidar]]
topic = "/h/points"
translation = [0.19, 0.0, 0.04]
rpy_deg = [0.0, 80.0, 0.0]
"""


def test_a_rig_file(bag_of, tmp_path):
    path = bag_of(two_lidars([]))
    file = tmp_path / "rig.toml"
    file.write_text(CARTOGRAPHER)
    rig = rig_of(path, rig_file=file)
    assert (rig.base_frame, *topics(rig)) == ("base_link", "/v/points", ["/h/points"])
    # Roll, pitch, yaw about fixed axes, as in URDF and Cartographer.
    expected = Rotation.from_euler("z", np.pi) * Rotation.from_euler("y", np.radians(-10))
    np.testing.assert_allclose(
        rig.horizontal.T_base_sensor[:3, :3], expected.as_matrix(), atol=1e-12
    )
    assert rig.horizontal.tilt_deg == pytest.approx(10.0)
    file.write_text(CARTOGRAPHER.replace('"/h/points"', '"/h/points"\nrole = "horizontal"'))
    assert rig_of(path, rig_file=file).horizontal.topic == "/h/points"
    # Without extrinsics in the file, the bag's transforms place the lidars.
    lines = '[[lidar]]\nframe = "vertical_velodyne"\nrole = "both"\n'
    file.write_text(lines + '[[lidar]]\nframe = "horizontal_velodyne"\nrole = "vertical"\n')
    rig = rig_of(bag_of(two_lidars(MARS), "mars.bag"), rig_file=file)
    assert (rig.base_frame, *topics(rig)) == ("base_link", "/v/points", ["/v/points", "/h/points"])


LIDAR = '[[lidar]]\ntopic = "/v/points"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base = ", "no valid TOML"),
        ('base = "b"\n', "lidar: Field required"),
        ('bas = "b"\n', "unknown key bas; did you mean base?"),
        (f"{LIDAR}translatoin = [0, 0, 0]\n", "did you mean translation?"),
        ("[[lidar]]\ntranslation = [0, 0, 0]\n", "neither topic nor frame"),
        (f"{LIDAR}translation = [0, 0]\n", "lidar.0.translation: List should have at least 3"),
        (f"{LIDAR}translation = [0, 0, nan]\n", "lidar.0.translation.2: Input should be a finite"),
        (f"{LIDAR}quaternion_xyzw = [0, 0, 0, 3]\n", "length 1"),
        (f"{LIDAR}quaternion_xyzw = [0, 0, 0, 1]\nrpy_deg = [0, 0, 0]\n", "not both"),
        (f'{LIDAR}role = "up"\n', "lidar.0.role: Input should be 'horizontal', 'vertical'"),
        (f"{LIDAR}clock_s = true\n", "lidar.0.clock_s: Input should be a valid number"),
        ("[[lidar]]\ntopic = 5\n", "lidar.0.topic: Input should be a valid string"),
        ('[[lidar]]\ntopic = "/x"\n', "topic /x has no clouds in the bag"),
        ('[[lidar]]\nframe = "x"\n', "frame x is unknown; the bag's clouds have the frames: h"),
        (f'base = "odd"\n{LIDAR}', "no extrinsics for /v/points"),
    ],
)
def test_a_rig_file_with_an_error(bag_of, tmp_path, text, words):
    file = tmp_path / "rig.toml"
    file.write_text(text)
    message = error_of(bag_of(two_lidars(MARS)), rig_file=file)
    assert words in message
    assert "rig.toml" in message


def test_bags_without_clouds(bag_of):
    assert "the bag is empty" in error_of(bag_of([], "empty.bag"))
    text = error_of(bag_of([("/odom", START_NS, odometry(START_NS, [0, 0, 0]))]))
    assert "no PointCloud2" in text
    assert "/odom" in text


def test_a_base_far_away_is_refused_and_a_rig_file_names_another(bag_of, tmp_path):
    """Static transforms may continue to a frame of the town."""
    edges = [("utm", "trunk", [432_123.4, 5_412_345.6, 450.0], [0, 0, 0, 1])]
    edges += [(*(n.replace("base_link", "trunk") for n in edge[:2]), *edge[2:]) for edge in MARS]
    path = bag_of(two_lidars(edges))
    assert "away from utm, which no robot spans" in error_of(path)
    file = tmp_path / "rig.toml"
    file.write_text(f'base = "trunk"\n{LIDAR}[[lidar]]\ntopic = "/h/points"\n')
    T = rig_of(path, rig_file=file).horizontal.T_base_sensor
    np.testing.assert_allclose(T[:3, 3], [0.12, 0.01, 0.568], atol=1e-6)


TWO_ROBOTS = [
    (f"/robot{i}/tf_static", [MARS[0], ("base_link", "horizontal_velodyne", [0, i, 1], LYING)])
    for i in (1, 2)
]


@pytest.mark.parametrize("robot", [1, 2, None])
def test_a_lidar_takes_the_transforms_of_its_own_namespace(bag_of, robot):
    prefix = f"/robot{robot}" if robot else ""
    entries = [(prefix + topic, log, message) for topic, log, message in two_lidars([])]
    entries += [(topic, START_NS, tf_message(edges)) for topic, edges in TWO_ROBOTS]
    rig = rig_of(bag_of(entries))
    np.testing.assert_allclose(rig.vertical.T_base_sensor[:3, 3], [0, robot or 2, 1])
    assert len(rig.warnings) == (robot is None)
    if robot is None:
        words = "two transforms place horizontal_velodyne differently, on /robot1/tf_static in base"
        assert rig.warnings[0].startswith(words)


@pytest.mark.parametrize("frame", ["base_link", "horizontal_velodyne"])
def test_a_cloud_merged_from_the_lidars_is_not_used(bag_of, frame):
    entries = two_lidars(MARS)
    poses = {child.strip("/"): (Rotation.from_quat(q), np.array(p)) for _, child, p, q in MARS}
    poses["base_link"] = Rotation.identity(), np.zeros(3)
    turn, origin = poses[frame]
    for i in range(4):
        stamp_ns = START_NS + i * PERIOD_NS + 7_000_000
        seen = np.concatenate([sweep(seed=i), sweep(seed=i)])
        sensed = np.column_stack([seen["x"], seen["y"], seen["z"]]).reshape(2, -1, 3)
        in_base = [
            poses[name][0].apply(points) + poses[name][1]
            for name, points in zip(poses, sensed, strict=False)
        ]
        seen["x"], seen["y"], seen["z"] = turn.inv().apply(np.concatenate(in_base) - origin).T
        entries.append(("/merged", stamp_ns + PERIOD_NS, cloud(seen, stamp_ns, frame)))
    rig = rig_of(bag_of(entries))
    assert topics(rig) == ("/v/points", ["/h/points"])
    assert "not used: /merged (a merged cloud" in rig.warnings[0]


def test_a_lidar_without_rings_is_no_merged_cloud(bag_of):
    entries = two_lidars([*MARS, ("base_link", "livox", [0, 0, 1], UPRIGHT)])
    for i in range(4):
        stamp_ns = START_NS + i * PERIOD_NS
        seen = only(sweep(seed=i, columns=180), "x", "y", "z")
        rays = np.random.default_rng(i).normal(size=(len(seen), 3))
        seen["x"], seen["y"], seen["z"] = 3 * rays.T / np.linalg.norm(rays, axis=1)
        entries.append(("/livox", stamp_ns + PERIOD_NS, cloud(seen, stamp_ns, "livox")))
    rig = rig_of(bag_of(entries))
    assert "/livox" in [lidar.topic for lidar in rig.verticals]
    assert not any("not used" in warning for warning in rig.warnings)


def test_two_lidars_on_one_topic_are_named(bag_of):
    def error(left, right):
        late = clouds("/points", 12, right, late_ns=PERIOD_NS // 3)
        return error_of(bag_of([*clouds("/points", 12, left), *late], f"{right}.bag"))

    assert "two lidars on one topic, with frames left and right" in error("left", "right")
    assert "its sweeps take 99 ms and begin every 50 ms" in error("lidar", "lidar")
