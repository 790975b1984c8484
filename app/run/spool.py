"""The files of a run's spool, which appear whole: what workers and the run's own process tell one another of a block.

They are all that passes between processes, so that a killed run can go on.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.votes import Halo
from ffmap.algorithms.scan.summary import Features
from ffmap.app.folder.atomic import written_whole
from ffmap.app.run.arrays import Arrays, unpack, unpack_ragged

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    _T = TypeVar("_T", bound=DataclassInstance)

SUMMARY, FEATURES, VOTES, RIVALS = "summary_", "feature_", "votes_", "rivals_"
"""What the names of the arrays begin with: of `BlockSummary`, `Features`, and twice `VoxelVotes`, that of `RivalCounter` last."""
SCAN_LABELS, SCAN_CEILINGS = "label", "ceiling"
"""By scan: labels, one for each place in the cloud, and ceiling planes (k, 3); `scan` has the numbers."""


@dataclass(frozen=True)
class BlockSummary:
    """What the run's own process needs to know of a labelled block.

    scan: (s,) scans that were labelled; stamp_ns, T_map_base: (s,), (s, 4, 4) at their header stamps.
    skipped: number and reason of each cloud that was not.
    cloud_digest: (k, 16) uint8 of the bytes of every cloud of the block, skipped ones too.
    label_counts: (256,) returns by label. milliseconds: (s, 5), see `STAGES`.
    points_in_cloud, points_in_lines: (s,)
    beyond_range: (s,) returns that were left out because they lie too far away.
    """

    scan: IntArray
    stamp_ns: IntArray
    T_map_base: FloatArray
    skipped_scan: IntArray
    skipped_reason: tuple[str, ...]
    cloud_digest: UInt8Array
    label_counts: IntArray
    milliseconds: FloatArray
    points_in_cloud: IntArray
    points_in_lines: IntArray
    beyond_range: IntArray


def load(kind: "type[_T]", path: Path, prefix: str) -> "_T":
    """What a block's .npz holds of a dataclass, see `pack`."""
    with np.load(path) as spooled:
        return unpack(kind, spooled, prefix)


def load_features(path: Path) -> list[Features]:
    """The features of all scans in a block's .npz; nothing where it holds no scan."""
    with np.load(path) as spooled:
        return [unpack(Features, spooled, FEATURES)] if f"{FEATURES}scan" in spooled else []


def load_by_scan(path: Path, name: str) -> dict[int, Any]:
    """Arrays of single scans in a block's .npz, by the scans' numbers: see `SCAN_LABELS` and `SCAN_CEILINGS`."""
    with np.load(path) as spooled:
        return dict(zip(spooled["scan"].tolist(), unpack_ragged(name, spooled), strict=True))


@lru_cache(maxsize=1)
def load_halo(path: Path) -> Halo:
    """What `save` wrote of the halo; read once in a process."""
    return load(Halo, path, "")


def save(path: Path, arrays: Arrays) -> None:
    """Write a file of the spool."""
    with written_whole(path) as part, part.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
