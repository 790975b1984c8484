"""What differs between two runs of one drive, as it is counted, drawn and told."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.truth.poses import TrajectoryFigures
from ffmap.algorithms.truth.runs import CLASSES, DoorChange, GridChange, WallChange, changed_of

CLASS_NAMES = (*(label.name.lower() for label in Label), "no label")
COMPARABLE = ("labels", "planes", "trajectory", "walls", "doors", "grid")
TRANSITIONS = CLASSES**2


@dataclass(frozen=True)
class ScanChange:
    """One scan that both runs labelled.

    counts: (7, 7) points of class i in the first run and j in the second; by the final labels.
    changed_scan: how many labels of the scan alone differ.
    """

    scan: int
    stamp_ns: int
    counts: IntArray
    changed_scan: int

    @property
    def points(self) -> int:
        """How many points either run labelled."""
        return int(self.counts.sum())

    @property
    def changed(self) -> int:
        """How many of them differ."""
        return changed_of(self.counts)


@dataclass(frozen=True)
class ChangedPoints:
    """The points of one scan whose labels differ: places in the map (c, 3), `before` and `after` (c,) classes 0 to 6."""

    scan: int
    stamp_ns: int
    points_map: FloatArray
    before: UInt8Array
    after: UInt8Array

    @property
    def transition(self) -> UInt8Array:
        """(c,) 7 × before + after."""
        return np.asarray(self.before * CLASSES + self.after, np.uint8)


@dataclass(frozen=True)
class LabelChange:
    """The labels of all scans.

    only_a, only_b: clouds that one run labelled and the other did not. unlike: clouds whose number of points differs.
    cubes: votes of the changed points for their transitions, by cubes of 10 cm.
    """

    scans: tuple[ScanChange, ...]
    only_a: int
    only_b: int
    unlike: int
    cubes: VoxelVotes

    @property
    def confusion(self) -> IntArray:
        """(7, 7) summed over the scans."""
        return sum_counts(scan.counts for scan in self.scans)

    @property
    def points(self) -> int:
        """How many points either run labelled."""
        return sum(s.points for s in self.scans)

    @property
    def changed(self) -> int:
        """How many labels differ."""
        return sum(s.changed for s in self.scans)

    @property
    def changed_scan(self) -> int:
        """How many labels of the scans alone differ."""
        return sum(s.changed_scan for s in self.scans)

    @property
    def worst(self) -> ScanChange | None:
        """The scan with most changed labels; None where none changed."""
        worst = max(self.scans, key=lambda s: s.changed, default=None)
        return worst if worst is not None and worst.changed else None


@dataclass(frozen=True)
class PlaneChange:
    """Wall planes of single scans: (s,) scans, their stamps, how many were lost and gained in each."""

    scan: IntArray
    stamp_ns: IntArray
    lost: IntArray
    gained: IntArray


@dataclass(frozen=True)
class DoorsCompared:
    """Both runs' doors as GeoJSON features, and which are which."""

    before: list[Any]
    after: list[Any]
    change: DoorChange

    @property
    def altered(self) -> list[tuple[int, int, str]]:
        """Doors that both have and that differ: number in the first run, in the second, what differs."""
        found = []
        for i, j in enumerate(self.change.match.tolist()):
            if j < 0:
                continue
            a, b = self.before[i]["properties"], self.after[j]["properties"]
            parts = []
            if a.get("state") != b.get("state"):
                parts.append(f"{a.get('state')} → {b.get('state')}")
            if abs(_number(a.get("width")) - _number(b.get("width"))) >= 0.01:
                parts.append(f"width {_number(a.get('width')):.2f} → {_number(b.get('width')):.2f} m")
            if parts:
                found.append((i, j, ", ".join(parts)))
        return found


@dataclass(frozen=True)
class TrajectoryChange:
    """Poses at the same stamps: distances as they stand, and after the best rotation and shift."""

    stamp_ns: IntArray
    figures: TrajectoryFigures


@dataclass(kw_only=True)
class Changes:
    """What differs between two runs; what could not be compared is None."""

    labels: LabelChange | None = None
    planes: PlaneChange | None = None
    trajectory: TrajectoryChange | None = None
    walls: WallChange | None = None
    doors: DoorsCompared | None = None
    grid: GridChange | None = None

    @property
    def compared(self) -> list[str]:
        """What was compared."""
        return [name for name in COMPARABLE if getattr(self, name) is not None]

    @property
    def differing(self) -> list[str]:
        """Of what has a curve over the scans, what differs in any: labels of scans alone, planes, poses."""
        differs = {
            "labels": self.labels is not None and self.labels.changed_scan > 0,
            "planes": self.planes is not None and bool(self.planes.lost.any() or self.planes.gained.any()),
            "trajectory": self.trajectory is not None and bool(self.trajectory.figures.error_unaligned_m.any()),
        }
        return [name for name, differ in differs.items() if differ]


def name_transition(code: int) -> str:
    """As in wall → clutter."""
    return f"{CLASS_NAMES[code // CLASSES]} → {CLASS_NAMES[code % CLASSES]}"


def most_frequent(changes: Sequence[LabelChange], most: int) -> list[int]:
    """The transitions that changed most points over all comparisons, the largest first."""
    total = sum_counts(change.confusion for change in changes)
    np.fill_diagonal(total, 0)
    order = np.argsort(-total, axis=None, kind="stable")[:most]
    return [int(code) for code in order if total.flat[code] > 0]


def sum_counts(counts: Iterable[IntArray]) -> IntArray:
    """(7, 7) counts of transitions summed."""
    return sum(counts, np.zeros((CLASSES, CLASSES), np.int64))


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")
