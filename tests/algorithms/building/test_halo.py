"""The halo of surfaces: their scatter, but not what scans took for walls that the building does not have."""

from dataclasses import replace

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.building.face_columns import Storey
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.halo import HaloSettings, find_halo, halo_at_walls
from ffmap.algorithms.building.model import CELL_M, NO_DOORS
from tests.faces import faces
from tests.voting import vote

EDGE_M = 0.05
LENGTH_M = 6.0
FACE = faces(((0.0, 0.0), (LENGTH_M, 0.0)))
GROUND = Storey(np.zeros((9, 3)), np.zeros((0, 3)))


def bare() -> Foreground:
    """Nothing stands before the face."""
    columns = round(LENGTH_M / CELL_M)
    return Foreground(np.array([0, columns]), np.full(columns, 2.8), np.zeros(columns), np.zeros((columns, 60), bool))


def test_the_scatter_of_a_ceiling_is_ceiling_and_a_lamp_below_it_is_not() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.01, 2, 0.01), np.arange(0.01, 2, 0.01)))
    ceiling = np.column_stack([x, y, np.full(len(x), 2.71)])
    scatter = np.array([[0.5, 0.5, 2.66], [1.5, 1.2, 2.77]])
    lamp = np.column_stack([x, y, np.full(len(x), 2.66)])[(x > 0.8) & (x < 1.2) & (y > 0.8) & (y < 1.2)]
    stray = np.array([[0.5, 0.5, 2.4]])  # two cubes away from any surface
    points = np.concatenate([ceiling, scatter, lamp, stray]).astype(np.float32)
    label = np.repeat(
        [Label.CEILING, Label.CLUTTER, Label.CLUTTER, Label.CLUTTER], [len(ceiling), 2, len(lamp), 1]
    ).astype(np.uint8)
    halo = find_halo(vote(points, label, len(Label), EDGE_M), HaloSettings(ratio=6.0))
    final = np.split(halo.label_of(points, label), np.cumsum([len(ceiling), 2, len(lamp)]))
    assert (final[1] == Label.CEILING).all()
    assert (final[2] == Label.CLUTTER).all()
    assert (final[3] == Label.CLUTTER).all()
    # What no scan had a vote for is within the halo just the same.
    unseen = np.array([[0.3, 0.3, 2.67]], np.float32)
    assert halo.label_of(unseen, np.zeros(1, np.uint8)) == Label.CEILING


def test_nothing_seen_has_no_halo() -> None:
    halo = find_halo(vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), EDGE_M), HaloSettings(ratio=6.0))
    assert len(halo.keys) == 0
    assert halo.label_of(np.zeros((1, 3), np.float32), np.zeros(1, np.uint8)) == Label.CLUTTER


def test_only_the_buildings_own_walls_have_a_halo() -> None:
    """Two cubes that scans took for wall, with a stray return beside each: on the face, and a metre before it."""
    on, off = np.array([3.02, 0.02, 1.02]), np.array([3.02, 1.02, 1.02])
    beside = np.array([0.0, 0.05, 0.0])
    points = np.concatenate([np.repeat([on, off], 20, axis=0), [on + beside, off + beside]])
    label = np.array([Label.WALL] * 40 + [Label.CLUTTER] * 2, np.uint8)
    halo = find_halo(vote(points, label, len(Label), 0.05), HaloSettings(ratio=6.0))
    stray = np.array([on + beside, off + beside])
    clutter = np.full(2, Label.CLUTTER, np.uint8)
    np.testing.assert_array_equal(halo.label_of(stray, clutter), [Label.WALL, Label.WALL])
    before = bare()
    np.testing.assert_array_equal(
        halo_at_walls(halo, FACE, NO_DOORS, before, GROUND, HaloSettings()).label_of(stray, clutter),
        [Label.WALL, Label.CLUTTER],
    )
    before.covered[:] = True
    np.testing.assert_array_equal(
        halo_at_walls(halo, FACE, NO_DOORS, before, GROUND, HaloSettings()).label_of(stray, clutter),
        [Label.CLUTTER, Label.CLUTTER],
    )


def test_the_leaf_of_an_open_door_is_no_halo_of_its_wall() -> None:
    """What scans took for wall next to the wall, straight before a doorway and beside it."""
    leaf, wall = np.array([3.02, 0.08, 1.02]), np.array([4.02, 0.08, 1.02])
    points = np.repeat([leaf, wall], 20, axis=0)
    halo = find_halo(vote(points, np.full(40, Label.WALL, np.uint8), len(Label), 0.05), HaloSettings(ratio=6.0))
    before = bare()
    doors = replace(
        NO_DOORS,
        ends=np.array([[[2.9, 0.0], [3.8, 0.0]]]),
        normal=np.array([[0.0, 1.0]]),
        head_m=np.array([2.1]),
        reveal_m=np.array([0.2]),
    )
    clutter = np.full(2, Label.CLUTTER, np.uint8)
    stray = np.array([leaf, wall])
    found = halo_at_walls(halo, FACE, doors, before, GROUND, HaloSettings()).label_of(stray, clutter)
    np.testing.assert_array_equal(found, [Label.CLUTTER, Label.WALL])
    # Above its head a wall goes on.
    low = replace(doors, head_m=np.array([0.9]))
    np.testing.assert_array_equal(
        halo_at_walls(halo, FACE, low, before, GROUND, HaloSettings()).label_of(stray, clutter), [Label.WALL] * 2
    )


def test_on_a_raised_floor_heights_are_measured_from_it() -> None:
    """A leaf covers its wall up to 1 m above a floor that a ramp has raised by 0.6 m; a doorway's head is 0.9 m above it."""
    low, high = np.array([3.02, 0.02, 1.42]), np.array([3.02, 0.02, 1.82])
    leaf, lintel = np.array([5.02, 0.08, 1.42]), np.array([5.02, 0.08, 1.82])
    places = np.array([low, high, leaf, lintel])
    votes = vote(np.repeat(places, 20, axis=0), np.full(80, Label.WALL, np.uint8), len(Label), 0.05)
    halo = find_halo(votes, HaloSettings(ratio=6.0))
    raised = Storey(np.column_stack([np.linspace(0, LENGTH_M, 50), np.zeros(50), np.full(50, 0.6)]), np.zeros((0, 3)))
    before = replace(bare(), ground_m=np.full(120, 0.6))
    before.covered[:80, : round(1.0 / CELL_M)] = True
    door = replace(
        NO_DOORS,
        ends=np.array([[[4.5, 0.0], [5.4, 0.0]]]),
        normal=np.array([[0.0, 1.0]]),
        head_m=np.array([0.9]),
        reveal_m=np.array([0.2]),
    )
    found = halo_at_walls(halo, FACE, door, before, raised, HaloSettings())
    clutter = np.full(4, Label.CLUTTER, np.uint8)
    np.testing.assert_array_equal(
        found.label_of(places, clutter), [Label.CLUTTER, Label.WALL, Label.CLUTTER, Label.WALL]
    )
