"""Topics that may be a rig's lidars, without depth cameras, merged clouds and copies."""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.loaders.bag import Bag
from ffmap.loaders.cloud_checks import check_one_lidar
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.decoding import TimeFrom, decode, settle_decoding
from ffmap.loaders.errors import CloudError, InputError
from ffmap.loaders.frames import read_frame_tree
from ffmap.loaders.rig import Lidar
from ffmap.loaders.rig_file import Role
from ffmap.loaders.rings import on_rings
from ffmap.loaders.scans import sample_messages

_SAMPLES = 8
_VIEW_MIN_DEG = 150.0  # Of a lidar that is half covered; cameras and solid-state lidars see 120
_SAMPLE_POINTS = 5000
_MOVED_M = 0.3  # From ring to ring, at the ranges of a room
_ON_RINGS_MIN = 0.875  # Minimum share of returns near a ring of one lidar; by chance it is a half
_COPY_SHARE = 0.5  # Minimum share of equal stamps of a cloud and its copy


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate(Lidar):
    """A topic that may be one of the rig's lidars.

    stamp_ns: of its clouds.
    clouds: some points (n, 3) of each of several clouds, in the sensor's frame.
    roles: by the rig file.
    """

    stamp_ns: IntArray
    clouds: list[FloatArray]
    roles: tuple[Role, ...] = ()

    @property
    def worth(self) -> tuple[bool, bool, bool, int]:
        """Sort key; better clouds are greater: whole turns, times, rings, more points."""
        rings = self.decoding.rings.source in ("field", "row", "column")
        return self.turns, self.decoding.time is not None, rings, self.points_per_cloud

    @cached_property
    def view_deg(self) -> float:
        """Angle of the cone that contains its directions; more than 180 of a spinning lidar."""
        points = np.concatenate([np.zeros((0, 3)), *self.clouds])
        directions = points / np.linalg.norm(points, axis=1, keepdims=True)
        middle = directions.sum(axis=0)
        off = directions @ (middle / max(float(np.linalg.norm(middle)), 1e-12))
        if not len(off):
            return 0.0
        return 2 * float(np.degrees(np.arccos(np.clip(np.percentile(off, 1), -1.0, 1.0))))

    @cached_property
    def ringed(self) -> bool:
        """Whether its returns are on rings about its own axis."""
        shares = [float(np.mean(on_rings(points, self.decoding.rings))) for points in self.clouds]
        return max(shares, default=0.0) > _ON_RINGS_MIN

    @property
    def turns(self) -> bool:
        return self.view_deg >= _VIEW_MIN_DEG


def find_candidates(
    bag: Bag, topics: list[str], time_from: TimeFrom, warnings: list[str]
) -> list[Candidate]:
    """Select the topics whose clouds can be read. Raises CloudError if none can."""
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
        clouds = []
        for message in messages:
            with suppress(CloudError):
                clouds.append(decode(message, decoding).points_sensor)
        count = int(np.median([len(points) for points in clouds])) if clouds else 0
        draw = np.random.default_rng(0)
        some = [p[draw.permutation(len(p))[:_SAMPLE_POINTS]] for p in clouds if len(p)]
        lidar = topic, decoding.layout.frame_id, np.eye(4), decoding, count
        found.append(Candidate(*lidar, stamp_ns=index.stamp_ns, clouds=some))
    if failure and not found:
        raise failure
    return found


def without_cameras(
    bag: Bag, candidates: list[Candidate], chosen: set[str], warnings: list[str]
) -> list[Candidate]:
    """Remove depth cameras, where there is a lidar, and clouds merged from those of others."""
    kept = turning = [c for c in candidates if c.turns or c.topic in chosen] or candidates
    for c in candidates:
        if c not in turning:
            warnings.append(
                f"not used: {c.topic} (a depth camera or no turning lidar, its field of view is "
                f"{c.view_deg:.0f} deg); --vertical {c.topic} uses it"
            )
        elif c.topic not in chosen and (lidars := _merged_from(bag, c, turning)):
            kept = [other for other in kept if other is not c]
            warnings.append(
                f"not used: {c.topic} (a merged cloud, its returns are on the rings of "
                f"{' and '.join(lidars)})"
            )
    return kept


def _merged_from(bag: Bag, merged: Candidate, candidates: list[Candidate]) -> list[str]:
    """List the topics on whose rings the returns of a cloud are that has no rings of its own."""
    if len(candidates) == 1 or merged.ringed:
        return []
    lidars = [c for c in candidates if c.ringed]
    tree = read_frame_tree(bag, {c.topic: c.frame_id for c in (merged, *lidars)})
    T_of = {c.topic: tree.between(c.frame_id, merged.frame_id) for c in lidars}
    placed = [(c, T) for c in lidars if (T := T_of[c.topic]) is not None]

    def share(points: FloatArray) -> float:
        on = [on_rings(transforms.apply(T, points), c.decoding.rings) for c, T in placed]
        return float(np.mean(np.any(on, axis=0)))

    draw = np.random.default_rng(0)
    for points in merged.clouds if placed else ():
        # The share by chance is that of the same returns, moved; the limit is halfway to all.
        by_chance = share(points + draw.normal(0, _MOVED_M, points.shape))
        if share(points) > (1 + by_chance) / 2:
            return [c.topic for c, _ in placed]
    return []


def one_a_frame(
    bag: Bag, candidates: list[Candidate], chosen: set[str], warnings: list[str]
) -> list[Candidate]:
    """Select the best of several clouds of one sensor: dual returns, filtered copies."""
    best: dict[str, Candidate] = {}
    for candidate in candidates:
        known = best.get(candidate.frame_id)
        if known is None:
            best[candidate.frame_id] = candidate
            continue
        if not {known.topic, candidate.topic} & chosen and not _is_copy(known, candidate):
            raise InputError(
                f"{bag.path.name}: {known.topic} and {candidate.topic} both have frame "
                f"{candidate.frame_id} but are two sensors; pass --rig FILE, or name one with "
                "--horizontal"
            )
        best[candidate.frame_id] = max(
            known, candidate, key=lambda each: (each.topic in chosen, each.worth)
        )
    kept = [c for c in candidates if c.topic in chosen or best[c.frame_id] is c]
    warnings += [
        f"not used: {c.topic} ({best[c.frame_id].topic} is the better cloud of frame {c.frame_id})"
        for c in candidates
        if c not in kept
    ]
    return kept


def _is_copy(one: Candidate, other: Candidate) -> bool:
    shared = len(np.intersect1d(one.stamp_ns, other.stamp_ns))
    return shared >= _COPY_SHARE * min(len(one.stamp_ns), len(other.stamp_ns))
