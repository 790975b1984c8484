"""Roles by the spin axes, places by transforms or rig file, and what is said when they cannot be told."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import MountCorrection, find_rig
from ffmap.loaders.rig_file import read_rig_file
from tests.loaders.bag_builder import PERIOD_NS, START_NS, cloud, clouds, odometry, only, sweep, tf_message, write_bag

UPRIGHT = [0.0, 0.0, -0.7071067811865476, 0.7071067811865476]
LYING = [0.5, 0.5, 0.5, 0.5]
# The paper's own rig: the names tell the spin axis, not the role.
MARS = [
    ("base_link", "vertical_velodyne", [0.12, 0.01, 0.568], UPRIGHT),
    ("/base_link", "/horizontal_velodyne", [0.3, 0.01, 0.348], LYING),
]


def two_lidars(edges, tf="/tf_static", ros_version=1):
    entries = [
        *clouds("/v/points", 4, "vertical_velodyne", ros_version),
        *clouds("/h/points", 4, "/horizontal_velodyne", ros_version, late_ns=PERIOD_NS // 3),
    ]
    if edges:
        entries.append((tf, START_NS, tf_message(edges, ros_version)))
    return sorted(entries, key=lambda entry: entry[1])


def rig_of(path, **options):
    with open_bag(path) as bag:
        return find_rig(bag, **options)


def error_of(path, **options):
    with pytest.raises(InputError) as caught:
        rig_of(path, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", ["a.bag", "a_db3", "a_mcap"])
def test_roles_by_the_spin_axis_not_by_name(tmp_path, name):
    version = 1 if name.endswith(".bag") else 2
    rig = rig_of(write_bag(tmp_path / name, two_lidars(MARS, ros_version=version)))
    assert rig.base_frame == "base_link"
    assert (rig.horizontal.topic, rig.vertical.topic) == ("/v/points", "/h/points")
    assert rig.vertical.frame_id == "horizontal_velodyne"
    np.testing.assert_allclose(rig.horizontal.T_base_sensor[:3, 3], [0.12, 0.01, 0.568])
    np.testing.assert_allclose(rig.vertical.T_base_sensor[:3, 2], [1, 0, 0], atol=1e-12)
    assert "gravity" in rig.horizontal.reasons
    assert "level" in rig.vertical.reasons
    assert (rig.vertical.ring_count, rig.vertical.decoding.time.name) == (16, "time")
    assert {e.child for e in rig.static_transforms} == {"vertical_velodyne", "horizontal_velodyne"}
    assert not rig.warnings


def test_roles_may_be_overridden(tmp_path):
    path = write_bag(tmp_path / "a.bag", two_lidars(MARS))
    rig = rig_of(path, horizontal="h/points", verticals=["/v/points"])
    assert (rig.horizontal.topic, rig.vertical.topic) == ("/h/points", "/v/points")
    assert rig.horizontal.reasons == "--horizontal names it"
    rig = rig_of(path, verticals=["/v/points"])
    assert (rig.horizontal.topic, rig.vertical.topic) == ("/h/points", "/v/points")
    rig = rig_of(path, horizontal="/v/points", verticals=["/v/points"])
    assert rig.horizontal.topic == rig.vertical.topic == "/v/points"
    assert "--vertical /nothing is no topic with clouds; the bag's clouds are on: /h/points, /v/points" in error_of(
        path, verticals=["/nothing"]
    )


@pytest.mark.parametrize(
    ("top", "base", "height_m"),
    [("base_footprint", "base_footprint", 0.768), ("world", "base_link", 0.568), ("r1/base_footprint", "r1/base_footprint", 0.768)],
)
def test_base_is_the_topmost_frame_of_the_robot(tmp_path, top, base, height_m):
    edges = [(top, "base_link", [0, 0, 0.2], [0, 0, 0, 1]), *MARS]
    rig = rig_of(write_bag(tmp_path / "a.bag", two_lidars(edges)))
    assert rig.base_frame == base
    np.testing.assert_allclose(rig.horizontal.T_base_sensor[:3, 3], [0.12, 0.01, height_m])


def test_base_is_the_root_where_no_frame_has_a_robots_name(tmp_path):
    edges = [("chassis", "base_link", [0, 0, 0.2], [0, 0, 0, 1]), *MARS]
    edges = [(*(name.replace("base_link", "trunk") for name in edge[:2]), *edge[2:]) for edge in edges]
    rig = rig_of(write_bag(tmp_path / "a.bag", two_lidars(edges)))
    assert rig.base_frame == "chassis"
    np.testing.assert_allclose(rig.horizontal.T_base_sensor[:3, 3], [0.12, 0.01, 0.768])


def test_transforms_on_tf_that_never_change(tmp_path):
    entries = two_lidars([])
    for i in range(40):
        log_time_ns = START_NS + i * PERIOD_NS // 10
        moving = [("odom", "base_link", [0.1 * i, 0, 0], [0, 0, 0, 1])]
        entries.append(("/tf", log_time_ns, tf_message([*MARS, *moving])))
    rig = rig_of(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    assert rig.base_frame == "base_link"
    assert rig.vertical.topic == "/h/points"


def test_two_lidars_without_transforms(tmp_path):
    text = error_of(write_bag(tmp_path / "a.bag", two_lidars([])))
    for part in ("vertical_velodyne", "horizontal_velodyne", "/v/points", "--rig"):
        assert part in text


def test_an_unknown_frame(tmp_path):
    text = error_of(write_bag(tmp_path / "a.bag", two_lidars(MARS[:1])))
    assert "frame horizontal_velodyne of /h/points is unknown" in text
    assert "base_link, vertical_velodyne" in text


def test_two_trees_that_do_not_meet(tmp_path):
    apart = [MARS[0], ("elsewhere", "horizontal_velodyne", [0, 0, 0], LYING)]
    text = error_of(write_bag(tmp_path / "a.bag", two_lidars(apart)))
    assert "no transforms join" in text
    assert "elsewhere" in text


def test_a_transform_that_closes_a_loop_is_left_out(tmp_path):
    loop = [*MARS, ("vertical_velodyne", "base_link", [0, 0, 0], [0, 0, 0, 1])]
    rig = rig_of(write_bag(tmp_path / "a.bag", two_lidars(loop)))
    assert rig.base_frame == "base_link"
    assert {edge.child for edge in rig.static_transforms} == {"vertical_velodyne", "horizontal_velodyne"}
    np.testing.assert_allclose(rig.horizontal.T_base_sensor[:3, 3], [0.12, 0.01, 0.568])


def test_one_lidar_alone_needs_no_transforms(tmp_path):
    path = write_bag(tmp_path / "a.bag", clouds("/points", 3))
    rig = rig_of(path)
    assert (rig.base_frame, rig.vertical) == ("lidar", None)
    np.testing.assert_array_equal(rig.horizontal.T_base_sensor, np.eye(4))
    assert "nothing to label" in rig.warnings[0]
    assert "opens to 30 deg" in rig.warnings[0]
    rig = rig_of(path, verticals=["/points"])
    assert rig.horizontal.topic == rig.vertical.topic == "/points"
    assert rig.vertical.line_pairs == rig.vertical.column_pairs > 0
    assert any("stands upright and opens to 30 deg" in w for w in rig.warnings)


WIDE = tuple(range(-45, 46, 3))


def test_an_upright_lidar_that_opens_wide_has_both_roles(tmp_path):
    rig = rig_of(write_bag(tmp_path / "a.bag", clouds("/points", 3, elevations_deg=WIDE)))
    assert rig.horizontal.topic == rig.vertical.topic == "/points"
    assert rig.vertical.opening_deg == pytest.approx(90.0, abs=0.1)
    assert "columns" in rig.vertical.reasons
    assert not rig.warnings
    untimed = clouds("/points", 3, elevations_deg=WIDE)
    for _, _, message in untimed:
        message.fields[-1].name = "nothing"
    said = rig_of(write_bag(tmp_path / "b.bag", untimed)).warnings
    assert sum("no times" in w for w in said) == 1
    assert "(horizontal and vertical)" in said[0]


def test_emitters_are_the_lines_of_a_lidar_that_lies(tmp_path):
    rig = rig_of(write_bag(tmp_path / "a.bag", two_lidars(MARS)))
    assert (rig.vertical.column_pairs, rig.vertical.line_pairs) == (0, 16)


def test_two_upright_lidars_leave_nothing_to_label(tmp_path):
    edges = [(p, c, t, UPRIGHT) for p, c, t, _ in MARS]
    rig = rig_of(write_bag(tmp_path / "a.bag", two_lidars(edges)))
    assert rig.vertical is None
    assert any("nothing to label" in w for w in rig.warnings)


def test_of_two_upright_lidars_the_one_that_opens_wide_is_labelled(tmp_path):
    edges = [(p, c, t, UPRIGHT) for p, c, t, _ in MARS]
    entries = [*clouds("/v/points", 4, "vertical_velodyne"), ("/tf_static", START_NS, tf_message(edges, 1))]
    entries += clouds("/h/points", 4, "/horizontal_velodyne", late_ns=PERIOD_NS // 3, elevations_deg=WIDE)
    rig = rig_of(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    assert rig.vertical.topic == "/h/points"


def three_lidars(left, right, **options):
    """An upright lidar that opens to 30 degrees, and two more, their quaternions given."""
    edges = [MARS[0], ("base_link", "left", [0, 0.2, 0.5], left), ("base_link", "right", [0, -0.2, 0.5], right)]
    entries = [
        *clouds("/v/points", 4, "vertical_velodyne"),
        *clouds("/right/points", 4, "right", late_ns=PERIOD_NS // 4, **options),
        *clouds("/left/points", 4, "left", late_ns=PERIOD_NS // 3, **options),
        ("/tf_static", START_NS, tf_message(edges, 1)),
    ]
    return sorted(entries, key=lambda entry: entry[1])


def topics(rig):
    return rig.horizontal.topic, [lidar.topic for lidar in rig.verticals]


def test_all_lidars_that_lie_are_labelled(tmp_path):
    tilted = (Rotation.from_quat(LYING) * Rotation.from_euler("x", 7, degrees=True)).as_quat()
    path = write_bag(tmp_path / "a.bag", three_lidars(tilted, LYING))
    rig = rig_of(path)
    assert topics(rig) == ("/v/points", ["/right/points", "/left/points"])
    assert rig.vertical is rig.verticals[0]
    assert [lidar.column_pairs for lidar in rig.verticals] == [0, 0]
    assert "level (0.0 deg off)" in rig.verticals[0].reasons
    assert "7.0 deg off level" in rig.verticals[1].reasons
    assert not rig.warnings
    assert topics(rig_of(path, verticals=["/left/points"])) == ("/v/points", ["/left/points"])
    named = rig_of(path, verticals=["left/points", "/right/points", "/left/points"])
    assert topics(named) == ("/v/points", ["/left/points", "/right/points"])
    moved = rig.with_mount(MountCorrection("/left/points", tuple(map(tuple, np.diag([1.0, -1.0, -1.0, 1.0]))), 5))
    np.testing.assert_array_equal(moved.verticals[0].T_base_sensor, rig.verticals[0].T_base_sensor)
    assert (moved.verticals[0].decoding.clock_ns, moved.verticals[1].decoding.clock_ns) == (0, 5)
    np.testing.assert_array_equal(moved.tree.between("base_link", "left"), np.diag([1.0, -1.0, -1.0, 1.0]))


def test_of_upright_lidars_all_that_open_wide_are_labelled_that_of_the_poses_too(tmp_path):
    path = write_bag(tmp_path / "a.bag", three_lidars(UPRIGHT, UPRIGHT, elevations_deg=WIDE))
    rig = rig_of(path)
    horizontal, verticals = topics(rig)
    assert horizontal in verticals
    assert sorted(verticals) == ["/left/points", "/right/points"]
    assert all(lidar.column_pairs for lidar in rig.verticals)
    asked = rig_of(path, verticals=["/right/points", "/left/points"])
    assert topics(asked) == ("/v/points", ["/right/points", "/left/points"])


def test_one_that_lies_and_one_that_opens_wide_are_labelled_both(tmp_path):
    wide = three_lidars(LYING, UPRIGHT, elevations_deg=WIDE)
    rig = rig_of(write_bag(tmp_path / "a.bag", wide))
    assert topics(rig) == ("/right/points", ["/left/points", "/right/points"])
    assert [lidar.column_pairs > 0 for lidar in rig.verticals] == [False, True]


def test_a_rig_file_with_several_vertical_lidars(tmp_path):
    path = write_bag(tmp_path / "a.bag", three_lidars(LYING, UPRIGHT))
    file = tmp_path / "rig.toml"
    entry = '[[lidar]]\ntopic = "{}"\nrole = "{}"\n'
    named = {"/v/points": "both", "/left/points": "vertical", "/right/points": "vertical"}
    file.write_text("".join(entry.format(topic, role) for topic, role in named.items()))
    assert topics(rig_of(path, rig_file=file)) == ("/v/points", list(named))
    file.write_text("".join(entry.format(*item) for item in {**named, "/v/points": "horizontal"}.items()))
    rig = rig_of(path, rig_file=file)
    assert topics(rig) == ("/v/points", ["/left/points", "/right/points"])
    # The right one stands upright and opens to 30 degrees.
    assert [w.split(":")[0] for w in rig.warnings] == ["/right/points"]


def test_copies_and_cameras_are_passed_over(tmp_path):
    entries = two_lidars(MARS)
    for i in range(4):
        stamp_ns = START_NS + i * PERIOD_NS
        thin = only(sweep(columns=30, seed=i), "x", "y", "z")
        entries.append(("/v/filtered", stamp_ns + PERIOD_NS, cloud(thin, stamp_ns, "vertical_velodyne")))
        narrow = only(sweep(columns=30, seed=i), "x", "y", "z")
        narrow["x"] = np.abs(narrow["x"]) + 1
        narrow["y"] *= 0.3
        entries.append(("/camera/points", stamp_ns + PERIOD_NS, cloud(narrow, stamp_ns, "camera")))
    edges = [("base_link", "camera", [0, 0, 1], [0, 0, 0, 1])]
    entries.append(("/tf_static", START_NS + 1, tf_message(edges)))
    rig = rig_of(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    assert (rig.horizontal.topic, rig.vertical.topic) == ("/v/points", "/h/points")
    assert "/v/points is the better cloud" in next(line for line in rig.warnings if "/v/filtered" in line)
    assert "/camera/points (a depth camera" in rig.warnings[0]


def test_two_sensors_with_one_frame_need_a_rig_file(tmp_path):
    entries = [*clouds("/a", 4, "velodyne"), *clouds("/b", 4, "velodyne", late_ns=7)]
    path = write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1]))
    assert "both say frame velodyne" in error_of(path)
    file = tmp_path / "rig.toml"
    file.write_text('[[lidar]]\ntopic = "/a"\ntranslation = [0, 0, 1]\n[[lidar]]\ntopic = "b"\nrpy_deg = [90, 0, 0]\n')
    rig = rig_of(path, rig_file=file)
    assert (rig.base_frame, rig.horizontal.topic, rig.vertical.topic) == ("base_link", "/a", "/b")


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


def test_a_rig_file(tmp_path):
    path = write_bag(tmp_path / "a.bag", two_lidars([]))
    file = tmp_path / "rig.toml"
    file.write_text(CARTOGRAPHER)
    rig = rig_of(path, rig_file=file)
    assert (rig.base_frame, rig.horizontal.topic, rig.vertical.topic) == ("base_link", "/v/points", "/h/points")
    # Roll, pitch, yaw about fixed axes, as URDF and Cartographer mean them.
    expected = Rotation.from_euler("z", np.pi) * Rotation.from_euler("y", np.radians(-10))
    np.testing.assert_allclose(rig.horizontal.T_base_sensor[:3, :3], expected.as_matrix(), atol=1e-12)
    assert rig.horizontal.tilt_deg == pytest.approx(10.0)
    assert {e.child: e.parent for e in rig.static_transforms}["horizontal_velodyne"] == "base_link"
    file.write_text(CARTOGRAPHER.replace('topic = "/h/points"', 'topic = "/h/points"\nrole = "horizontal"'))
    assert rig_of(path, rig_file=file).horizontal.topic == "/h/points"


def test_a_rig_file_may_leave_places_to_the_bag(tmp_path):
    path = write_bag(tmp_path / "a.bag", two_lidars(MARS))
    file = tmp_path / "rig.toml"
    file.write_text(
        '[[lidar]]\nframe = "vertical_velodyne"\nrole = "vertical"\n[[lidar]]\nframe = "horizontal_velodyne"\n'
    )
    rig = rig_of(path, rig_file=file)
    assert (rig.base_frame, rig.vertical.topic, rig.horizontal.topic) == ("base_link", "/v/points", "/h/points")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base = ", "no valid TOML"),
        ('base = "b"\n', "no [[lidar]]"),
        ('bas = "b"\n', "unknown key bas; did you mean base?"),
        ('[[lidar]]\ntopic = "/v/points"\ntranslatoin = [0, 0, 0]\n', "did you mean translation?"),
        ("[[lidar]]\ntranslation = [0, 0, 0]\n", "neither topic nor frame"),
        ('[[lidar]]\ntopic = "/v/points"\ntranslation = [0, 0]\n', "translation must be 3 numbers"),
        ('[[lidar]]\ntopic = "/v/points"\nquaternion_xyzw = [0, 0, 0, 3]\n', "length 1"),
        ('[[lidar]]\ntopic = "/v/points"\nquaternion_xyzw = [0, 0, 0, 1]\nrpy_deg = [0, 0, 0]\n', "not both"),
        ('[[lidar]]\ntopic = "/v/points"\nrole = "up"\n', "role 'up'"),
        ('[[lidar]]\ntopic = "/v/points"\nrole = ["both"]\n', "role ['both']"),
        ("[[lidar]]\ntopic = 5\n", "topic must be a name"),
        ('[[lidar]]\ntopic = "/x"\ntranslation = [0, 0, 0]\n', "topic /x has no clouds in the bag"),
        (
            '[[lidar]]\nframe = "x"\ntranslation = [0, 0, 0]\n',
            "frame x is unknown; the bag's clouds have the frames: h",
        ),
        ('base = "odd"\n[[lidar]]\ntopic = "/v/points"\n', "no place for /v/points"),
    ],
)
def test_a_rig_file_that_is_not_understood(tmp_path, text, words):
    path = write_bag(tmp_path / "a.bag", two_lidars(MARS))
    file = tmp_path / "rig.toml"
    file.write_text(text)
    message = error_of(path, rig_file=file)
    assert words in message
    assert "rig.toml" in message


def test_no_such_rig_file(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml"):
        read_rig_file(tmp_path / "none.toml")


def test_bags_without_clouds(tmp_path):
    assert "the bag is empty" in error_of(write_bag(tmp_path / "empty.bag", []))
    entries = [("/odom", START_NS, odometry(START_NS, [0, 0, 0]))]
    text = error_of(write_bag(tmp_path / "odom.bag", entries))
    assert "no PointCloud2" in text
    assert "/odom" in text


def test_clouds_without_times_warn(tmp_path):
    entries = [
        ("/a", START_NS + i, cloud(only(sweep(seed=i), "x", "y", "z"), START_NS + i * PERIOD_NS)) for i in range(3)
    ]
    path = write_bag(tmp_path / "a.bag", entries)
    assert any("--time-from azimuth" in w and "compensated already" in w for w in rig_of(path).warnings)
    rig = rig_of(path, time_from="azimuth")
    assert rig.horizontal.decoding.timed
    assert not any("--time-from" in w for w in rig.warnings)


def test_a_base_that_no_robot_reaches_is_refused_and_a_rig_file_names_another(tmp_path):
    """Static transforms may go on to a frame of the town."""
    edges = [("utm", "trunk", [432_123.4, 5_412_345.6, 450.0], [0, 0, 0, 1])]
    edges += [(*(name.replace("base_link", "trunk") for name in edge[:2]), *edge[2:]) for edge in MARS]
    path = write_bag(tmp_path / "a.bag", two_lidars(edges))
    error = error_of(path)
    assert "away from utm, which no robot spans" in error
    assert 'base = "base_link"' in error
    file = tmp_path / "rig.toml"
    file.write_text('base = "trunk"\n[[lidar]]\ntopic = "/v/points"\n[[lidar]]\ntopic = "/h/points"\n')
    rig = rig_of(path, rig_file=file)
    np.testing.assert_allclose(rig.horizontal.T_base_sensor[:3, 3], [0.12, 0.01, 0.568], atol=1e-6)


TWO_ROBOTS = [(f"/robot{i}/tf_static", [*MARS[:1], ("base_link", "horizontal_velodyne", [0, i, 1], LYING)]) for i in (1, 2)]


@pytest.mark.parametrize("robot", [1, 2])
def test_a_lidar_takes_the_transforms_of_its_own_namespace(tmp_path, robot):
    entries = [(f"/robot{robot}{topic}", log, message) for topic, log, message in two_lidars([])]
    entries += [(topic, START_NS, tf_message(edges)) for topic, edges in TWO_ROBOTS]
    rig = rig_of(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    np.testing.assert_allclose(rig.vertical.T_base_sensor[:3, 3], [0, robot, 1])
    assert not rig.warnings


def test_two_transforms_that_place_one_lidar_differently_are_named(tmp_path):
    entries = [*two_lidars([]), *((topic, START_NS, tf_message(edges)) for topic, edges in TWO_ROBOTS)]
    rig = rig_of(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    (warning,) = rig.warnings
    assert "two transforms place horizontal_velodyne differently, on /robot1/tf_static in base_link and on" in warning
    np.testing.assert_allclose(rig.vertical.T_base_sensor[:3, 3], [0, 2, 1])


def test_a_depth_camera_that_looks_along_z_is_no_vertical_lidar(tmp_path):
    entries = two_lidars(MARS)
    for i in range(4):
        stamp_ns = START_NS + i * PERIOD_NS
        seen = only(sweep(columns=30, seed=i), "x", "y", "z")
        seen["z"] = 4.0
        entries.append(("/camera/points", stamp_ns + PERIOD_NS, cloud(seen, stamp_ns, "optical")))
    entries.append(("/tf_static", START_NS + 1, tf_message([("base_link", "optical", [0, 0, 1], LYING)])))
    rig = rig_of(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    assert [lidar.topic for lidar in rig.verticals] == ["/h/points"]
    assert "not used: /camera/points (a depth camera" in rig.warnings[0]


@pytest.mark.parametrize("frame", ["base_link", "vertical_velodyne", "horizontal_velodyne"])
def test_a_cloud_merged_of_the_lidars_is_not_used(tmp_path, frame):
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
            for name, points in zip(("vertical_velodyne", "horizontal_velodyne"), sensed, strict=True)
        ]
        seen["x"], seen["y"], seen["z"] = turn.inv().apply(np.concatenate(in_base) - origin).T
        entries.append(("/merged", stamp_ns + PERIOD_NS, cloud(seen, stamp_ns, frame)))
    rig = rig_of(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    assert (rig.horizontal.topic, [lidar.topic for lidar in rig.verticals]) == ("/v/points", ["/h/points"])
    assert "not used: /merged (a merged cloud" in rig.warnings[0]


def test_a_lidar_without_rings_is_no_merged_cloud(tmp_path):
    entries = two_lidars(MARS)
    for i in range(4):
        stamp_ns = START_NS + i * PERIOD_NS
        seen = only(sweep(seed=i, columns=180), "x", "y", "z")
        rays = np.random.default_rng(i).normal(size=(len(seen), 3))
        seen["x"], seen["y"], seen["z"] = 3 * rays.T / np.linalg.norm(rays, axis=1)
        entries.append(("/livox", stamp_ns + PERIOD_NS, cloud(seen, stamp_ns, "livox")))
    entries.append(("/tf_static", START_NS + 1, tf_message([("base_link", "livox", [0, 0, 1], UPRIGHT)])))
    rig = rig_of(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    assert "/livox" in [lidar.topic for lidar in rig.verticals]
    assert not any("not used" in warning for warning in rig.warnings)


def test_two_lidars_on_one_topic_are_named(tmp_path):
    def joined(left, right):
        entries = [*clouds("/points", 12, left), *clouds("/points", 12, right, late_ns=PERIOD_NS // 3)]
        return write_bag(tmp_path / f"{right}.bag", sorted(entries, key=lambda entry: entry[1]))

    assert "two lidars on one topic, with frames left and right" in error_of(joined("left", "right"))
    assert "its sweeps take 99 ms and begin every 50 ms" in error_of(joined("lidar", "lidar"))
