"""Topics that could be a rig's lidars, without depth cameras, merged clouds and copies."""

from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.loaders.bag import Bag
from ffmap.loaders.cloud_checks import check_one_lidar
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.decoding import CloudDecoding, TimeFrom, decode, settle_decoding
from ffmap.loaders.errors import CloudError, InputError
from ffmap.loaders.frames import read_frame_tree
from ffmap.loaders.rig_file import Role
from ffmap.loaders.rings import on_rings
from ffmap.loaders.scans import sample_messages

UPRIGHT_DEG = 45.0
_SAMPLES = 8
_VIEW_MIN_DEG = 150.0  # Of a lidar whose turn is half hidden; cameras and solid-state lidars see up to 120
_LOOKED_AT = 5000  # Points of a cloud
_MOVED_M = 0.3  # From ring to ring, at the ranges of a room
_ON_RINGS_MIN = 0.875  # Minimum share of the returns near a ring of one lidar; by chance it is a half


@dataclass(frozen=True, eq=False)
class Candidate:
    """A topic that could be one of the rig's lidars.

    points: valid ones of a cloud, the median. clouds: some points (n, 3) of each of several clouds, in the sensor's frame.
    """

    topic: str
    frame_id: str
    stamp_ns: IntArray
    decoding: CloudDecoding
    points: int
    clouds: list[FloatArray]
    roles: tuple[Role, ...] = ()
    T_base_sensor: FloatArray = field(default_factory=lambda: np.eye(4))

    @property
    def worth(self) -> tuple[bool, bool, bool, int]:
        """Better clouds compare greater: whole turns, times and rings, more points."""
        rings = self.decoding.rings.source in ("field", "row", "column")
        return self.turns, self.decoding.time is not None, rings, self.points

    @cached_property
    def view_deg(self) -> float:
        """Opening of the cone that holds its directions: a camera's field of view, more than 180 of a turning lidar."""
        points = np.concatenate([np.zeros((0, 3)), *self.clouds])
        directions = points / np.linalg.norm(points, axis=1, keepdims=True)
        middle = directions.sum(axis=0)
        off = directions @ (middle / max(float(np.linalg.norm(middle)), 1e-12))
        return 2 * float(np.degrees(np.arccos(np.clip(np.percentile(off, 1), -1.0, 1.0)))) if len(off) else 0.0

    @cached_property
    def ringed(self) -> bool:
        """Whether its returns are on rings about its own axis."""
        shares = [float(np.mean(on_rings(points, self.decoding.rings))) for points in self.clouds]
        return max(shares, default=0.0) > _ON_RINGS_MIN

    @property
    def turns(self) -> bool:
        """Whether it looks round about."""
        return self.view_deg >= _VIEW_MIN_DEG

    @property
    def tilt_deg(self) -> float:
        """As of the lidar; 0 where its place is unknown."""
        return tilt_deg_of(self.T_base_sensor)

    @property
    def upright(self) -> bool:
        """Whether its columns are the lines that run from floor to ceiling; else its emitters are."""
        return self.tilt_deg <= UPRIGHT_DEG

    @property
    def opening_deg(self) -> float:
        """As of the lidar."""
        return opening_deg_of(self.decoding)


def opening_deg_of(decoding: CloudDecoding) -> float:
    """Angle between a lidar's lowest and highest ring."""
    return float(np.ptp(decoding.rings.elevation_deg[np.isfinite(decoding.rings.elevation_deg)]))


def tilt_deg_of(T_base_sensor: FloatArray) -> float:
    """Angle between a lidar's spin axis and the base's z axis, 0 to 90°."""
    return float(np.degrees(np.arccos(np.clip(abs(T_base_sensor[2, 2]), 0.0, 1.0))))


def find_candidates(bag: Bag, topics: list[str], time_from: TimeFrom, warnings: list[str]) -> list[Candidate]:
    """The topics whose clouds can be read. Raises CloudError where there is none."""
    found = []
    failure: CloudError | None = None
    for topic in topics:
        index = index_clouds(bag, topic)
        try:
            messages = sample_messages(bag, index, _SAMPLES)
            decoding = settle_decoding(messages, topic, time_from, index.period_ns)
            check_one_lidar(index, decoding)
        except CloudError as error:
            failure = error
            warnings.append(str(error))
            continue
        points, clouds = _look(messages, decoding)
        found.append(Candidate(topic, decoding.layout.frame_id, index.stamp_ns, decoding, points, clouds))
    if failure and not found:
        raise failure
    return found


def _look(messages: list[Any], decoding: CloudDecoding) -> tuple[int, list[FloatArray]]:
    """Median number of valid points of a cloud, and some of them (k, 3) of each cloud that has any."""
    clouds = []
    for message in messages:
        with suppress(CloudError):
            clouds.append(decode(message, decoding).points_sensor)
    draw = np.random.default_rng(0)
    some = [points[draw.permutation(len(points))[:_LOOKED_AT]] for points in clouds if len(points)]
    return int(np.median([len(points) for points in clouds])) if clouds else 0, some


def without_cameras(bag: Bag, candidates: list[Candidate], chosen: set[str], warnings: list[str]) -> list[Candidate]:
    """The candidates without depth cameras, where there is a lidar, and without clouds that were merged of the others'."""
    kept = turning = [c for c in candidates if c.turns or c.topic in chosen] or candidates
    for c in candidates:
        if c not in turning:
            warnings.append(
                f"not used: {c.topic} (a depth camera or no turning lidar, its field of view is {c.view_deg:.0f} deg); "
                f"--vertical {c.topic} uses it"
            )
        elif c.topic not in chosen and (lidars := _merged_of(bag, c, turning)):
            kept = [other for other in kept if other is not c]
            warnings.append(f"not used: {c.topic} (a merged cloud, its returns are on the rings of {' and '.join(lidars)})")
    return kept


def _merged_of(bag: Bag, merged: Candidate, candidates: list[Candidate]) -> list[str]:
    """The topics on whose lidars' rings the returns of a cloud without rings of its own are; none where they are not."""
    if len(candidates) == 1 or merged.ringed:
        return []
    lidars = [c for c in candidates if c.ringed]
    tree = read_frame_tree(bag, {c.topic: c.frame_id for c in (merged, *lidars)})
    placed = [(c, T) for c in lidars if (T := tree.between(c.frame_id, merged.frame_id)) is not None]

    def share(points: FloatArray) -> float:
        on = [on_rings(transforms.apply(T, points), c.decoding.rings) for c, T in placed]
        return float(np.mean(np.any(on, axis=0)))

    draw = np.random.default_rng(0)
    # Halfway between all returns and as many as are there by chance, which is the share of the same returns moved.
    found = placed and any(share(p) > (1 + share(p + draw.normal(0, _MOVED_M, p.shape))) / 2 for p in merged.clouds)
    return [c.topic for c, _ in placed] if found else []


def _unlike(stamps: IntArray, others: IntArray) -> bool:
    """Whether two clouds are of two sensors: a copy has its original's stamps."""
    return len(np.intersect1d(stamps, others)) < 0.5 * min(len(stamps), len(others))


def one_a_frame(bag: Bag, candidates: list[Candidate], chosen: set[str], warnings: list[str]) -> list[Candidate]:
    """Of several clouds of one sensor (dual returns, filtered copies) the best."""
    best: dict[str, Candidate] = {}
    for candidate in candidates:
        known = best.get(candidate.frame_id)
        if known and not {known.topic, candidate.topic} & chosen and _unlike(known.stamp_ns, candidate.stamp_ns):
            raise InputError(
                f"{bag.path.name}: {known.topic} and {candidate.topic} both say frame {candidate.frame_id} but are two "
                "sensors; give --rig FILE.toml, or name one with --horizontal"
            )
        if known is None or (candidate.topic in chosen, candidate.worth) > (known.topic in chosen, known.worth):
            best[candidate.frame_id] = candidate
    kept = [c for c in candidates if c.topic in chosen or best[c.frame_id] is c]
    warnings += [
        f"not used: {c.topic} ({best[c.frame_id].topic} is the better cloud of frame {c.frame_id})"
        for c in candidates
        if c not in kept
    ]
    return kept
