"""Panes of open doors' leaves, told from windows."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.building.model import NO_WALLS
from ffmap.algorithms.building.windows import is_in_wall, join_windows, panes_of_open_leaves
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import doors, faces, window


@pytest.mark.parametrize(
    ("hinge_y", "state", "is_leaf"),
    [
        (0.0, DoorState.OPEN, True),
        (-0.3, DoorState.OPEN, True),
        (-0.8, DoorState.OPEN, False),
        (0.0, DoorState.CLOSED, False),
    ],
    ids=["at the face", "at the wall's other face", "farther", "of a closed door"],
)
def test_the_pane_of_an_open_leaf_hangs_in_either_face_of_its_wall(
    hinge_y: float, state: DoorState, is_leaf: bool
) -> None:
    doorway = doors(((1.0, 0.0), (1.9, 0.0)), normal=[[0.0, 1.0]], state=[state], reveal_m=[0.3])
    outwards = -1.0 if hinge_y else 1.0
    pane = window((1.0, hinge_y + 0.1 * outwards), (1.0, hinge_y + 0.95 * outwards))
    pane = replace(pane, normal=np.array([[1.0, 0.0]]))
    assert panes_of_open_leaves(pane, doorway).tolist() == [is_leaf]
    aside = replace(pane, normal=np.array([[0.0, 1.0]]))
    assert panes_of_open_leaves(aside, doorway).tolist() == [False]


def test_a_pane_between_mullions_lies_in_no_wall_and_one_in_a_wall_does() -> None:
    pane = window((1.0, 0.0), (2.5, 0.0))
    mullions = faces(((0.95, 0.01), (1.05, 0.01)), ((2.45, 0.01), (2.55, 0.01)))
    assert is_in_wall(pane, mullions).tolist() == [False]
    assert is_in_wall(pane, faces(((0.0, 0.01), (4.0, 0.01)))).tolist() == [True]
    assert is_in_wall(pane, NO_WALLS).tolist() == [False]


@pytest.mark.parametrize("odds", [(3.0, 9.0), (9.0, 3.0), (np.nan, 9.0)])
def test_of_two_windows_that_are_one_the_surer_is_its_evidence(odds: tuple[float, float]) -> None:
    first, last = (
        replace(pane, support=replace(pane.support, odds=np.array([own])))
        for pane, own in zip(
            (window((1.0, 0.0), (2.5, 0.0)), window((1.2, 0.0), (2.6, 0.0))), odds, strict=True
        )
    )
    assert join_windows(first.append(last)).support.odds.tolist() == [9.0]
