"""The files of a run's spool, which appear whole: what workers and the run's own process tell one another of a block.

They are all that passes between processes, so that a killed run can go on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.votes import Halo, VoxelVotes
from ffmap.algorithms.scan.summary import Features
from ffmap.app.folder.atomic import write_atomically

Arrays = Mapping[str, npt.NDArray[Any]]


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


def summary_arrays(summary: BlockSummary) -> Arrays:
    """As `load_summary` reads it."""
    return {f"summary_{f.name}": np.asarray(getattr(summary, f.name)) for f in fields(BlockSummary)}


def load_summary(path: Path) -> BlockSummary:
    """The summary in a block's .npz."""
    with np.load(path) as spooled:
        values = {f.name: spooled[f"summary_{f.name}"] for f in fields(BlockSummary)}
    values["skipped_reason"] = tuple(str(reason) for reason in values["skipped_reason"])
    return BlockSummary(**values)


def load_features(path: Path) -> Features | None:
    """The features in a block's .npz; None where it holds no scan."""
    with np.load(path) as spooled:
        if f"feature_{fields(Features)[0].name}" not in spooled:
            return None
        return Features(**{f.name: spooled[f"feature_{f.name}"] for f in fields(Features)})


def load_labels(path: Path) -> dict[int, UInt8Array]:
    """Labels of each cloud in a block's .npz, by its number, one for each place in the cloud."""
    with np.load(path) as spooled:
        parts = np.split(spooled["label"], np.cumsum(spooled["label_size"])[:-1])
        return (
            {int(scan): part for scan, part in zip(spooled["label_scan"], parts, strict=True)}
            if len(spooled["label_scan"])
            else {}
        )


def load_ceilings(path: Path) -> dict[int, FloatArray]:
    """The ceiling planes (k, 3) of each scan in a block's .npz, by its number."""
    with np.load(path) as spooled:
        parts = np.split(spooled["ceiling_planes"], np.cumsum(spooled["ceiling_count"]))
        return {int(scan): part for scan, part in zip(spooled["label_scan"], parts, strict=False)}


def load_votes(path: Path) -> VoxelVotes:
    """The voxel votes in a block's .npz, of the scans' own labels or of the final ones."""
    return _load_votes(path, "votes")


def load_rivals(path: Path) -> VoxelVotes:
    """What `RivalCounter` counted of a block, from its .npz."""
    return _load_votes(path, "rivals")


def _load_votes(path: Path, name: str) -> VoxelVotes:
    with np.load(path) as spooled:
        values = {f.name: spooled[f"{name}_{f.name}"] for f in fields(VoxelVotes)}
    return VoxelVotes(**{**values, "voxel_m": float(values["voxel_m"])})


def vote_arrays(name: str, votes: VoxelVotes) -> Arrays:
    """As `load_votes` and `load_rivals` read them."""
    return {f"{name}_{f.name}": np.asarray(getattr(votes, f.name)) for f in fields(VoxelVotes)}


def save_halo(path: Path, halo: Halo) -> None:
    """Write what `FinishJob.halo` names."""
    save(path, {f.name: np.asarray(getattr(halo, f.name)) for f in fields(Halo)})


@lru_cache(maxsize=1)
def load_halo(path: Path) -> Halo:
    """Read what `save_halo` wrote; once in a process."""
    with np.load(path) as stored:
        return Halo(stored["keys"], stored["label"], float(stored["voxel_m"]))


def label_arrays(labels: Sequence[UInt8Array], scan: IntArray) -> Arrays:
    """As `load_labels` reads them: the labels of each cloud, and the clouds' numbers."""
    return {
        "label": np.concatenate([np.zeros(0, np.uint8), *labels]),
        "label_size": np.array([len(label) for label in labels], np.int64),
        "label_scan": scan,
    }


def ceiling_arrays(ceilings: Sequence[FloatArray]) -> Arrays:
    """As `load_ceilings` reads them: the ceiling planes (k, 3) of each scan."""
    count = np.array([len(planes) for planes in ceilings], np.int64)
    return {"ceiling_count": count, "ceiling_planes": np.concatenate([np.zeros((0, 3)), *ceilings])}


def feature_arrays(features: Features) -> Arrays:
    """As `load_features` reads them."""
    return {f"feature_{f.name}": getattr(features, f.name) for f in fields(Features)}


def save(path: Path, arrays: Arrays) -> None:
    """Write a file of the spool."""

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]

    write_atomically(path, write)
