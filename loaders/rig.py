"""The lidars of a robot: their extrinsics and roles."""

from dataclasses import dataclass, replace

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory, seen_at_once
from ffmap.algorithms.scan.point_lines import COLUMN_PAIRS
from ffmap.loaders.bag import Bag
from ffmap.loaders.cloud_index import CloudIndex, index_clouds
from ffmap.loaders.decoding import CloudDecoding
from ffmap.loaders.frames import FrameTree, StaticTransform

UPRIGHT_DEG = 45.0


@dataclass(frozen=True, eq=False)
class Lidar:
    """A lidar of the rig.

    T_base_sensor: extrinsics (4, 4).
    decoding: how its clouds become scans; for `read_scans`.
    points_per_cloud: valid points of a scan, the median.
    reasons: why it has its role, one line; empty before it has one.
    clouds_a_scan: number of successive clouds that are labelled as one scan.
    """

    topic: str
    frame_id: str
    T_base_sensor: FloatArray
    decoding: CloudDecoding
    points_per_cloud: int
    reasons: str = ""
    clouds_a_scan: int = 1

    def index(self, bag: Bag) -> CloudIndex:
        """Index its scans in a bag."""
        return index_clouds(bag, self.topic).gathered(self.clouds_a_scan)

    def seen(self, scan: Scan, trajectory: Trajectory) -> Scan:
        """Correct the motion during a scan without rings, which have an order only at rest.

        trajectory: T_map_base, which covers the scan.
        """
        if not self.ringless:
            return scan
        return seen_at_once(scan, trajectory, self.T_base_sensor, self.decoding.rings.edge_tan)

    @property
    def ringless(self) -> bool:
        """Whether it is upright, and its firings have times but no rings."""
        measured = self.decoding.time is not None and self.decoding.time_from == "auto"
        return self.column_pairs > 0 and self.decoding.rings.source == "bins" and measured

    @property
    def ring_count(self) -> int:
        return self.decoding.rings.count

    @property
    def tilt_deg(self) -> float:
        """Angle between the spin axis and the base's z axis, 0 to 90°."""
        return float(np.degrees(np.arccos(np.clip(abs(self.T_base_sensor[2, 2]), 0.0, 1.0))))

    @property
    def upright(self) -> bool:
        return self.tilt_deg <= UPRIGHT_DEG

    @property
    def opening_deg(self) -> float:
        """The vertical field of view, from the lowest to the highest ring."""
        return float(np.ptp(self.decoding.rings.seen_deg))

    @property
    def column_pairs(self) -> int:
        """Pairs of columns that are the point lines of an upright lidar; 0 for emitters."""
        return COLUMN_PAIRS if self.upright else 0

    @property
    def line_pairs(self) -> int:
        """Pairs of point lines, of columns or of emitters."""
        return self.column_pairs or self.ring_count


@dataclass(frozen=True)
class MountCorrection:
    """Extrinsics and clock of a vertical lidar that replace those of the bag or rig file.

    T_base_sensor: (4, 4), row by row.
    clock_ns: added to its firing times.
    """

    topic: str
    T_base_sensor: tuple[tuple[float, ...], ...]
    clock_ns: int


@dataclass(frozen=True, eq=False)
class Rig:
    """The lidars with their roles.

    base_frame: the frame of the trajectory.
    horizontal: drives odometry; None where the bag has no such lidar.
    verticals: are labelled, the most level first; empty where there is nothing to label.
    static_transforms: all that are known, for the results' /tf_static.
    mounts_from: the source of the extrinsics.
    """

    base_frame: str
    horizontal: Lidar | None
    verticals: tuple[Lidar, ...]
    static_transforms: tuple[StaticTransform, ...]
    warnings: tuple[str, ...]
    mounts_from: str = "the bag's transforms"

    @property
    def vertical(self) -> Lidar | None:
        """The first vertical lidar, mostly the only one."""
        return next(iter(self.verticals), None)

    @property
    def tree(self) -> FrameTree:
        return FrameTree(self.static_transforms)

    def with_mount(self, mount: MountCorrection) -> "Rig":
        """Replace the extrinsics of a vertical lidar, in the static transforms too."""
        moved = next((lidar for lidar in self.verticals if lidar.topic == mount.topic), None)
        if moved is None:
            return self
        decoding = replace(moved.decoding, clock_ns=mount.clock_ns)
        found = replace(moved, T_base_sensor=np.array(mount.T_base_sensor), decoding=decoding)
        own = [edge for edge in self.static_transforms if edge.child == found.frame_id]
        others = (edge for edge in self.static_transforms if edge not in own)
        parent = own[0].parent if own else self.base_frame
        T_parent_base = self.tree.between(parent, self.base_frame)
        if T_parent_base is None:
            parent, T_parent_base = self.base_frame, np.eye(4)
        edge = StaticTransform(parent, found.frame_id, T_parent_base @ found.T_base_sensor)
        verticals = tuple(found if lidar is moved else lidar for lidar in self.verticals)
        return replace(self, verticals=verticals, static_transforms=(*others, edge))
