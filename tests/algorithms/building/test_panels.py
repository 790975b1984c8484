"""The panels of a building: what is cut from them, and where."""

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.building.model import NO_DOORS, NO_WINDOWS, Blinds
from ffmap.algorithms.building.panels import KIND_WORDS, Kind, Panels, panels_of
from tests.algorithms.building.test_final_labels import (
    OPEN,
    TO_SENSOR,
    building,
    door,
    face,
    window,
)


def extents(panels: Panels, kind: Kind) -> list[tuple[float, ...]]:
    """x from and to, bottom and top of the panels of a kind that look to the sensor."""
    own = panels.select((panels.kind == kind) & (panels.normal[:, 1] < 0))
    x = np.sort(own.ends[:, :, 0], axis=1)
    return sorted(map(tuple, np.column_stack([x, own.bottom_m, own.top_m]).round(3).tolist()))


def test_a_wall_has_a_lintel_above_a_doorway() -> None:
    cut = panels_of(building(walls=face(), doors=OPEN))
    inf = np.inf
    assert extents(cut, Kind.WALL) == [
        (0.0, 0.98, -inf, 2.8),
        (0.98, 2.02, 2.1, 2.8),
        (2.02, 4.0, -inf, 2.8),
    ]
    assert extents(cut, Kind.LEAF) == []
    assert extents(panels_of(building(walls=face(), doors=door(0.04))), Kind.LEAF) == [
        (1.0, 2.0, -inf, 2.1)
    ]


def test_a_wall_is_cut_by_doors_of_its_other_face_only() -> None:
    far = panels_of(building(walls=face(y=0.6), doors=OPEN))
    assert extents(far, Kind.WALL) == [(0.0, 4.0, -np.inf, 2.8)]
    other_side = panels_of(building(walls=face(y=0.2), doors=OPEN))
    assert len(extents(other_side, Kind.WALL)) == 3


def test_a_blind_leaves_the_wall_above_and_below_it() -> None:
    values = (np.array([value]) for value in (2.0, 2.5, 0.0))
    blind = Blinds(window(0.0).ends, TO_SENSOR, *values)
    cut = panels_of(building(walls=face(), windows=window(0.1), blinds=blind))
    assert (1.0, 3.0, -np.inf, 2.0) in extents(cut, Kind.WALL)
    assert (1.0, 3.0, 2.5, np.inf) in extents(cut, Kind.WALL)
    assert extents(cut, Kind.RECESS) == [(1.0, 3.0, -np.inf, 2.0), (1.0, 3.0, 2.5, np.inf)]
    assert extents(cut, Kind.BLIND) == [(1.0, 3.0, 2.0, 2.5)]
    # In a glazed door there is no blind.
    glazed = panels_of(building(walls=face(), windows=window(0.1), blinds=blind, doors=door(0.04)))
    assert extents(glazed, Kind.BLIND) == []


def test_only_what_is_no_duplicate_of_a_wall_is_refused() -> None:
    refused = face(1.0, 6.0, y=-0.02)
    cut = panels_of(building(walls=face(), refused=refused))
    assert extents(cut, Kind.REFUSED) == [(4.0, 6.0, -np.inf, 2.8)]


def test_pieces_of_a_face_keep_their_columns() -> None:
    cut = panels_of(building(walls=face(), doors=OPEN))
    own = cut.select(cut.kind == Kind.WALL)
    np.testing.assert_allclose(own.column * 0.05, own.ends[:, 0, 0], atol=1e-9)
    assert set(own.wall.tolist()) == {0}
    assert set(own.label.tolist()) == {Label.WALL}


def test_nothing_has_no_panels_and_every_kind_has_words() -> None:
    assert len(panels_of(building(doors=NO_DOORS, windows=NO_WINDOWS))) == 0
    assert KIND_WORDS.keys() == set(Kind)
    assert len(set(KIND_WORDS.values())) == len(Kind)
