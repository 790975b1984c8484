"""Flush doors: leaves of another shade painted on faces of known depth."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.building.evidence import BEYOND, NEAR, ON, Evidence, joined
from ffmap.algorithms.building.flush_doors import find_flush_doors
from ffmap.algorithms.building.model import CELL_M, BuildingSettings, Doors
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.settle import ParsedFaces
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import faces, traced
from tests.painted import ROWS, evidence_of, wall

SETTINGS = BuildingSettings()
LENGTH_M = 6.0
Patch = tuple[float, float, float, float, float]
"""First and last place along the wall, bottom and top (m), and shade over the wall's."""
LEAF: Patch = (2.0, 2.9, 0.0, 2.1, 1.3)


def found(*patches: Patch, before_m: float = 0.0, seed: int = 0, mirrored: bool = False) -> Doors:
    """The doors of a wall in which patches differ; those stand before it by so much."""
    generator = np.random.default_rng(seed)
    face = wall(LENGTH_M)
    shade = np.full((face.columns, ROWS), 40.0)
    for first, last, bottom, top, ratio in patches:
        columns, rows = (
            slice(round(a / CELL_M), round(b / CELL_M)) for a, b in ((first, last), (bottom, top))
        )
        shade[columns, rows] *= ratio
        if before_m:
            face.paint((first, last), (bottom, top), ON, before_m=before_m)
    evidence = evidence_of(face)
    count = evidence.ended[..., : NEAR + 1].sum(axis=-1)
    cosine = np.linspace(0.3, 0.9, face.columns)[:, None]
    # Intensities fall with the angle, and a cell's mean scatters by 2 %.
    mean = shade * cosine * (1.0 + generator.normal(0.0, 0.02, shade.shape))
    light = np.stack([count, count * mean, count * cosine], axis=-1).astype(np.float32)
    order = slice(None, None, -1) if mirrored else slice(None)
    own = evidence.ended[order], evidence.depth_sum[order], evidence.depth_squares[order]
    parsed = parsed_of(Evidence(evidence.first, *own, light[order]), plain())
    return find_flush_doors(parsed, SETTINGS)


def plain() -> Evidence:
    """A long wall of one shade, seen at the same angles."""
    bare = evidence_of(wall(4 * LENGTH_M))
    count = bare.ended[..., : NEAR + 1].sum(axis=-1)
    cosine = np.linspace(0.3, 0.9, len(count))[:, None]
    light = np.stack([count, count * 40.0 * cosine, count * cosine], axis=-1)
    return replace(bare, light=light.astype(np.float32))


def parsed_of(*evidence: Evidence) -> ParsedFaces:
    ends = [((0.0, -y), (len(own.ended) * CELL_M, -y)) for y, own in enumerate(evidence)]
    known = traced(faces(*ends), joined(list(evidence), ROWS), 2.8)
    return ParsedFaces.of(known, np.zeros((0, 2)), SETTINGS, ParseSettings())


@pytest.mark.parametrize("ratio", [0.7, 0.9, 1.15, 1.6])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_leaf_of_another_shade_is_a_closed_door(ratio: float, mirrored: bool) -> None:
    for seed in range(3):
        doors = found((*LEAF[:4], ratio), seed=seed, mirrored=mirrored)
        assert doors.state.tolist() == [DoorState.CLOSED]
        jambs = [LENGTH_M - at for at in LEAF[1::-1]] if mirrored else LEAF[:2]
        np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), jambs, atol=CELL_M)
        assert doors.head_m[0] == pytest.approx(LEAF[3], abs=CELL_M)
        assert doors.confidence[0] > 0.9
        np.testing.assert_allclose(doors.support.contrast, abs(ratio - 1.0), rtol=0.1)


def test_two_leaves_are_two_doors_and_the_wall_between_is_none() -> None:
    doors = found(LEAF, (4.0, 4.9, 0.0, 2.1, 1.3))
    assert sorted(doors.ends[..., 0].mean(axis=1).round(1)) == pytest.approx([2.4, 4.4], abs=0.11)


@pytest.mark.parametrize(
    "patch",
    [
        (2.0, 2.9, 0.0, 2.1, 1.0),
        (2.0, 2.9, 0.0, 2.1, 1.01),
        (2.0, 2.9, 0.8, 1.9, 1.3),
        (2.0, 2.9, 0.0, 2.8, 1.3),
        (2.0, 2.9, 0.0, 1.4, 1.3),
        (2.0, 2.3, 0.0, 2.1, 1.3),
        (1.0, 4.9, 0.0, 2.1, 1.3),
        (0.0, 6.0, 0.0, 1.2, 1.3),
        (3.0, 6.0, 0.0, 2.8, 1.3),
    ],
    ids=[
        *("like the wall", "hardly another", "poster", "panel to the ceiling", "low cupboard"),
        *("strip", "wider than doors", "dado", "wall of another finish"),
    ],
)
def test_what_differs_but_is_no_leaf_is_no_door(patch: Patch) -> None:
    assert len(found(patch)) == 0


def test_what_stands_out_is_no_leaf_and_without_intensities_there_is_none() -> None:
    assert len(found(LEAF, before_m=0.03)) == 0
    assert len(find_flush_doors(parsed_of(evidence_of(wall(LENGTH_M))), SETTINGS)) == 0


def test_an_open_doorway_is_no_leaf() -> None:
    face = wall(LENGTH_M).paint(LEAF[:2], LEAF[2:4], BEYOND)
    assert len(find_flush_doors(parsed_of(evidence_of(face), plain()), SETTINGS)) == 0
