"""The files of a run's spool, which appear whole: what workers and the run's own process tell one another of a block.

They are all that passes between processes, so that a killed run can go on.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, UInt8Array
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.building.halo import Halo
from ffmap.algorithms.maps.rivals import RivalReturns
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.summary import NO_INTENSITY, Features
from ffmap.app.folder.atomic import written_whole
from ffmap.app.run.arrays import Arrays, pack_rows, unpack, unpack_ragged, unpack_rows
from ffmap.app.run.arrays_file import map_arrays, write_arrays
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    _T = TypeVar("_T", bound=DataclassInstance)

SUMMARY, FEATURES, VOTES, RIVALS = "summary_", "feature_", "votes_", "rivals_"
"""What the names of the arrays begin with: of `BlockSummary`, `Features`, and twice `VoxelVotes`, that of `RivalCounter` last."""
PLACED = ".placed.arrow"
"""How the file of a block ends that holds what depends on where its scans lie in the map."""
FINAL = ".final.arrow"
"""How the file of a block ends that holds its final labels."""
LABEL = "label"
"""By scan, in the order of time: the final labels, one for each place in the cloud."""
_GRID_M = 0.001
_RAGGED = ("ceiling", "point", "place", "label_cloud", "ray", "ray_intensity", "rival_row", "rival")
"""What each `SpooledScan` has another number of."""


@dataclass(frozen=True)
class SpooledScan:
    """What is left of a scan when it is labelled: its returns where it placed them, on a grid of a millimetre.

    Nothing of it depends on where the scan lies in the map, which is known when the last loop is closed.

    scan: its number. stamp_ns: of its header. origin_level: (3,) the sensor.
    floor: (2, 3), floor_is_foot: as `heights_above_pieces` takes them. ceiling: (c, 3), see `plane_rows`. All in the level frame.
    point: (n, 3) int16, in multiples of grid_m, which is more than a millimetre where a return is farther than 32 m.
    place: (n,) int32, of each return in the cloud; empty where they have the cloud's order.
    label_cloud: (cloud_size,) uint8, the scan's own label of each place in the cloud, see `full_labels`.
    ray: (r,) int32, see `ray_rows`; ray_intensity: (r,) of these, see `Features`. rival_row, rival: see `RivalReturns`.
    """

    scan: int
    stamp_ns: int
    origin_level: FloatArray
    floor: FloatArray
    floor_is_foot: bool
    ceiling: FloatArray
    grid_m: float
    point: IntArray
    place: IntArray
    label_cloud: UInt8Array
    ray: IntArray
    ray_intensity: FloatArray
    rival_row: IntArray
    rival: UInt8Array

    @classmethod
    def of(
        cls,
        index: int,
        scan: Scan,
        placed: PlacedScan,
        labelling: ScanLabelling,
        rivals: RivalReturns,
        ray: IntArray,
    ) -> "SpooledScan":
        """A scan as it was labelled."""
        farthest_m = float(np.abs(placed.points_level).max(initial=0.0))
        grid_m = max(_GRID_M, farthest_m / np.iinfo(np.int16).max)
        return cls(
            scan=index,
            stamp_ns=scan.stamp_ns,
            origin_level=placed.origin_level,
            floor=labelling.floor.both_pieces,
            floor_is_foot=labelling.floor.is_foot,
            ceiling=labelling.ceiling_planes,
            grid_m=grid_m,
            point=np.rint(placed.points_level * np.float32(1.0 / grid_m)).astype(np.int16),
            place=scan.cloud_index[:0] if np.all(np.diff(scan.cloud_index) > 0) else scan.cloud_index,
            label_cloud=full_labels(scan.cloud_size, scan.cloud_index, labelling.label),
            ray=ray,
            ray_intensity=NO_INTENSITY if scan.intensity is None else scan.intensity[ray],
            rival_row=rivals.row,
            rival=rivals.rival,
        )

    @property
    def points_level(self) -> FloatArray:
        """(n, 3) float32, metres."""
        return np.asarray(self.point * np.float32(self.grid_m))

    @property
    def cloud_index(self) -> IntArray:
        """(n,) the place of each return in the cloud."""
        return self.place if len(self.place) else np.flatnonzero(self.label_cloud != NO_RETURN)

    @property
    def label(self) -> UInt8Array:
        """(n,) the scan's own label of each return."""
        return self.label_cloud[self.cloud_index]

    @property
    def rivals(self) -> RivalReturns:
        """What counts for the rivals of the map."""
        return RivalReturns(self.rival_row, self.rival)


@dataclass(frozen=True)
class BlockSummary:
    """What the run's own process needs to know of a labelled block.

    scan: (s,) scans that were labelled; stamp_ns: (s,) of their headers.
    reference_ns: (s,) the middle of each sweep; T_level_base: (s, 4, 4) the base there, once the scan is level.
    skipped: number and reason of each cloud that was not, and the trace of what it raised, see `SkippedScan`.
    cloud_digest: (k, 16) uint8 of every message of the block's clouds, skipped ones too, lidar by lidar; digest_lidar: (k,) the
    place of its lidar.
    label_counts: (256,) returns by label. milliseconds: (s, 5), see `STAGES`. metrics: (s, m), see `METRICS`.
    points_in_cloud, points_in_lines: (s,)
    beyond_range: (s,) returns that were left out because they lie too far away. rejected_m: (s,) see `Floor`.
    """

    scan: IntArray
    stamp_ns: IntArray
    reference_ns: IntArray
    T_level_base: FloatArray
    skipped_scan: IntArray
    skipped_reason: tuple[str, ...]
    skipped_trace: tuple[str, ...]
    cloud_digest: UInt8Array
    digest_lidar: IntArray
    label_counts: IntArray
    milliseconds: FloatArray
    metrics: FloatArray
    points_in_cloud: IntArray
    points_in_lines: IntArray
    beyond_range: IntArray
    rejected_m: FloatArray


    @property
    def failed(self) -> list[SkippedScan]:
        """The clouds whose data raised an exception."""
        skipped = zip(self.skipped_scan.tolist(), self.skipped_reason, self.skipped_trace, strict=True)
        return [SkippedScan(index, 0, reason, trace) for index, reason, trace in skipped if trace]


def load(kind: "type[_T]", path: Path, prefix: str) -> "_T":
    """What a block's file holds of a dataclass, see `pack`."""
    return unpack(kind, map_arrays(path), prefix)


def load_features(path: Path) -> list[Features]:
    """The features of all scans in a block's file; nothing where it holds no scan."""
    spooled = map_arrays(path)
    return [unpack(Features, spooled, FEATURES)] if f"{FEATURES}scan" in spooled else []


def pack_scans(scans: Sequence[SpooledScan]) -> Arrays:
    """Scans as a block's file holds them."""
    return pack_rows(scans, _RAGGED) if scans else {}


def load_scans(path: Path) -> list[SpooledScan]:
    """The scans of a block's file, in the order of time."""
    spooled = map_arrays(path)
    return unpack_rows(SpooledScan, spooled, _RAGGED) if "scan" in spooled else []


def load_labels(path: Path, final: Path) -> Iterator[tuple[int, UInt8Array, UInt8Array]]:
    """Number, final label and the scan's own of the clouds in a block's two files, in the order of time."""
    for scan, label in zip(load_scans(path), unpack_ragged(LABEL, map_arrays(final)), strict=True):
        yield scan.scan, label, scan.label_cloud


@lru_cache(maxsize=1)
def load_halo(path: Path, _recording_id: str) -> Halo:
    """What `save` wrote of the halo; read once in a process for each run, for the next may lie where the last one did."""
    return load(Halo, path, "")


def save(path: Path, arrays: Arrays) -> None:
    """Write a file of the spool."""
    with written_whole(path) as part:
        write_arrays(part, arrays)
