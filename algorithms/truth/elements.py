"""Labels and doors by the part of the building, where the ground truth describes its parts."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from ffmap.algorithms.base.labels import Label, Truth
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.truth.doors import DoorComparison
from ffmap.algorithms.truth.tally import majorities

REST = "wall, any other"
"""The walls that belong to no element."""


@dataclass(frozen=True)
class Element:
    """A part of a building: its area in the map, bottom and top (m), and class of its returns."""

    name: str
    truth: Truth
    area: shapely.Polygon
    z_m: tuple[float, float]


def tally_elements(elements: Sequence[Element], voxels: VoxelVotes) -> dict[str, dict[str, Any]]:
    """Count the voxels of elements by their labels; a voxel counts in every element that holds it.

    Returns by name and for `REST`: truth, the class; seen, how many such elements hold a voxel;
    cubes, how many voxels; recall, the share with the label of the class; labels, counts by label.
    """
    truth, label = majorities(voxels)
    names = np.array([*(own.name.lower() for own in Label), "unlabelled"])[label]
    place: FloatArray = voxels.mean_position
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    seen: Counter[str] = Counter()
    rest: BoolArray = truth == Truth.WALL
    tree = shapely.STRtree(shapely.points(place[:, :2]))
    for element in elements:
        within = tree.query(element.area, predicate="intersects")
        z = place[within, 2]
        inside = (truth[within] == element.truth) & (z >= element.z_m[0]) & (z <= element.z_m[1])
        own = within[inside]
        counts[element.name].update(names[own].tolist())
        seen[element.name] += len(own) > 0
        rest[own] = False
    counts[REST].update(names[rest].tolist())
    classes = {element.name: element.truth for element in elements} | {REST: Truth.WALL}
    found = {}
    for name in sorted(counts):
        own_class, cubes = classes[name].name.lower(), counts[name].total()
        if cubes:
            found[name] = {
                "truth": own_class,
                "seen": seen[name],
                "cubes": cubes,
                "recall": counts[name][own_class] / cubes,
                "labels": dict(counts[name]),
            }
    return found


def doors_by_design(designs: Sequence[str], doors: DoorComparison) -> dict[str, dict[str, int]]:
    """Count doors passed, found and with the right state, by design.

    designs: (D,) of the true doors; a design without a door that was passed is left out.
    """
    both = np.flatnonzero(doors.passed & (doors.match >= 0))
    right = dict(zip(both.tolist(), doors.state_right.tolist(), strict=True))
    found: dict[str, dict[str, int]] = {}
    for door in np.flatnonzero(doors.passed).tolist():
        own = found.setdefault(designs[door], {"passed": 0, "found": 0, "state_right": 0})
        own["passed"] += 1
        own["found"] += door in right
        own["state_right"] += right.get(door, False)
    return dict(sorted(found.items()))
