"""Which kinds of walls, doors and ceilings a method misses: labels by the part of the building that they lie on.

The truth may say where its parts are: polygons in the plan with a height range and the class that their returns have.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from ffmap.algorithms.base.labels import Label, Truth
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.truth.doors import DoorFigures
from ffmap.algorithms.truth.labels import ratio
from ffmap.algorithms.truth.tally import majorities

REST = "wall, any other"
"""The walls that lie on no element: what the elements are measured against."""


@dataclass(frozen=True)
class Element:
    """A part of a building. area: in the map (m). z_m: its lowest and highest place. truth: class of its returns."""

    name: str
    truth: Truth
    area: shapely.Polygon
    z_m: tuple[float, float]


@dataclass(frozen=True)
class ElementFigures:
    """How the cubes of all elements of a name were labelled, and how many such elements were seen at all."""

    truth: Truth
    seen: int
    labels: Mapping[str, int]

    @property
    def cubes(self) -> int:
        return sum(self.labels.values())

    @property
    def recall(self) -> float:
        """The share of cubes with the label of their class."""
        return ratio(self.labels.get(self.truth.name.lower(), 0), self.cubes)


def tally_elements(elements: Sequence[Element], cubes: VoxelVotes) -> dict[str, ElementFigures]:
    """By name, and `REST`; cubes count in every element that holds them."""
    truth, label = majorities(cubes)
    names = np.array([*(own.name.lower() for own in Label), "unlabelled"])[label]
    place: FloatArray = cubes.mean_position
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    seen: Counter[str] = Counter()
    classes = {element.name: element.truth for element in elements} | {REST: Truth.WALL}
    rest: BoolArray = truth == Truth.WALL
    tree = shapely.STRtree(shapely.points(place[:, :2]))
    for element in elements:
        within = tree.query(element.area, predicate="intersects")
        z = place[within, 2]
        own = within[(truth[within] == element.truth) & (z >= element.z_m[0]) & (z <= element.z_m[1])]
        counts[element.name].update(names[own].tolist())
        seen[element.name] += len(own) > 0
        rest[own] = False
    counts[REST].update(names[rest].tolist())
    return {name: ElementFigures(classes[name], seen[name], counts[name]) for name in sorted(counts) if counts[name]}


@dataclass(frozen=True)
class DesignFigures:
    """Doors of one design: how many were passed, how many of those found, and how many of those with the right state."""

    passed: int
    found: int
    state_right: int

    @property
    def recall(self) -> float:
        return ratio(self.found, self.passed)


def doors_by_design(designs: Sequence[str], figures: DoorFigures) -> dict[str, DesignFigures]:
    """designs: (D,) of the true doors, in words."""
    both = np.flatnonzero(figures.passed & (figures.match >= 0))
    right = {int(door): bool(state) for door, state in zip(both, figures.state_right, strict=True)}
    found = {}
    for design in sorted(set(designs)):
        own = [i for i, name in enumerate(designs) if name == design and figures.passed[i]]
        found[design] = DesignFigures(len(own), sum(i in right for i in own), sum(right.get(i, False) for i in own))
    return {design: figures for design, figures in found.items() if figures.passed}
