"""A bag's truth, whole or in part."""

import json

import numpy as np
import pytest

from ffmap.loaders.bag import make_typestore, open_bag
from ffmap.loaders.errors import CloudError, InputError
from ffmap.loaders.truth import TruthClasses, read_truth
from tests.loaders.bag_builder import (
    PERIOD_NS,
    START_NS,
    cloud,
    clouds,
    odometry,
    point_dtype,
    write_bag,
)


def classes(i):
    points = np.zeros(20, point_dtype([("truth", "u1")]))
    points["truth"] = (np.arange(20) + i) % 11
    return points


def truth_bag(path, building='{"type": "FeatureCollection", "features": []}', field=None):
    text = make_typestore(1).types["std_msgs/msg/String"](data=building)
    entries = [("/truth/building", START_NS, text)]
    for i in range(5):
        stamp_ns = START_NS + i * PERIOD_NS
        message = cloud(classes(i) if field is None else field, stamp_ns)
        # Two clouds share a log time: the stamp tells them apart.
        entries.append(("/truth/classes", START_NS + i // 2 * PERIOD_NS, message))
        entries.append(("/truth/pose", stamp_ns, odometry(stamp_ns, [i, 0, 0])))
    return write_bag(path, sorted(entries, key=lambda entry: entry[1]))


def test_truth(tmp_path):
    with open_bag(truth_bag(tmp_path / "a.bag")) as bag:
        truth = read_truth(bag)
        assert truth.trajectory.T_map_base[:, 0, 3].tolist() == [0, 1, 2, 3, 4]
        assert truth.building == json.loads('{"type": "FeatureCollection", "features": []}')
        assert truth.classes == {"lidar": "/truth/classes"}
        of_lidar = TruthClasses(bag)
        for i in range(5):
            found = of_lidar.at(START_NS + i * PERIOD_NS)
            np.testing.assert_array_equal(found, classes(i)["truth"])
        assert of_lidar.at(START_NS + 1) is None


def test_no_truth_and_truth_in_part(tmp_path):
    with open_bag(write_bag(tmp_path / "a.bag", clouds("/a", 2))) as bag:
        assert read_truth(bag) is None
    pose = ("/truth/pose", START_NS, odometry(START_NS, [0, 0, 0]))
    with open_bag(write_bag(tmp_path / "b.bag", [pose])) as bag:
        truth = read_truth(bag)
        assert len(truth.trajectory) == 1
        assert (truth.classes, truth.building) == ({}, None)


@pytest.mark.parametrize("building", ["{", "[]", '{"type": "Point"}'])
def test_a_damaged_building(tmp_path, building):
    path = truth_bag(tmp_path / "a.bag", building)
    with open_bag(path) as bag, pytest.raises(InputError, match="/truth/building"):
        read_truth(bag)


def test_classes_without_the_field(tmp_path):
    field = np.zeros(20, point_dtype([("label", "u1")]))
    path = truth_bag(tmp_path / "a.bag", field=field)
    with open_bag(path) as bag, pytest.raises(CloudError, match="no field truth among label"):
        TruthClasses(bag).at(START_NS)
