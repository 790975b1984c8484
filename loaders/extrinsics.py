"""Where the lidars are: by a rig file, by a built-in rig, or by the bag's transforms."""

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.loaders.bag import Bag
from ffmap.loaders.candidates import Candidate
from ffmap.loaders.errors import InputError
from ffmap.loaders.frames import FrameTree, StaticTransform, read_frame_tree
from ffmap.loaders.rig_file import RigFile, RigLidar, built_in_rigs
from ffmap.loaders.sensors import cloud_hint, sensor_of

_REACH_MAX_M = 100.0  # With more, float32 loses the millimetres
_ROBOT_FRAMES = ("base_footprint", "base_link")  # REP 105


@dataclass(frozen=True, eq=False)
class Placement:
    """Candidates with their T_base_sensor, the base's frame, and all static transforms."""

    candidates: list[Candidate]
    base: str
    edges: tuple[StaticTransform, ...]


def entries_of(bag: Bag, rig: RigFile, topics: Sequence[str]) -> dict[str, RigLidar]:
    """Find the topic of each lidar of a rig file: by its name, else by the frame of its clouds.

    Raises InputError if it is missing.
    """
    found: dict[str, RigLidar] = {}
    for lidar in rig.lidars:
        name = (lidar.topic or "").removeprefix("/")
        matches = [topic for topic in topics if topic.removeprefix("/") == name]
        if not matches and lidar.frame is not None:
            frames = {topic: _frame_of(bag, topic) for topic in topics}
            matches = [topic for topic, frame in frames.items() if frame == lidar.frame]
            if not matches and lidar.topic is None:
                raise InputError(
                    f"{rig.path}: frame {lidar.frame} is unknown; the bag's clouds have the "
                    f"frames: {', '.join(sorted(set(frames.values())))}"
                )
        if not matches:
            raise InputError(
                f"{rig.path}: topic {lidar.topic} has no clouds in the bag; {cloud_hint(bag)}"
            )
        for topic in matches:
            found.setdefault(topic, lidar)
    return found


def _frame_of(bag: Bag, topic: str) -> str:
    sensor = sensor_of(bag.topics[topic])
    assert sensor is not None
    return sensor.frame_of(bag, topic)


def find_built_in(
    bag: Bag, candidates: Sequence[Candidate], chosen: Set[str], warnings: list[str]
) -> tuple[RigFile, dict[str, RigLidar]] | None:
    """Find the one built-in rig whose topics and frames the bag has.

    None where the bag's own transforms place its lidars: they are of this robot, on this day.
    """
    fitting = [(rig, own) for rig in built_in_rigs() if (own := _fitting(bag, candidates, rig))]
    if len(fitting) != 1 or not chosen <= fitting[0][1].keys():
        return None
    rig, entries = fitting[0]
    frames = {topic: lidar.frame or "" for topic, lidar in entries.items()}
    tree = read_frame_tree(bag, frames)
    base = tree.root(rig.lidars[0].frame or "")[0]
    if tree.joins(set(frames.values())) and base not in frames.values():
        return None
    warnings.append(
        "the bag has no transforms of its lidars; by its topics and frames it belongs to "
        f"{rig.label} ({rig.description}), whose extrinsics are used; --rig FILE overrules that"
    )
    return rig, entries


def _fitting(bag: Bag, candidates: Sequence[Candidate], rig: RigFile) -> dict[str, RigLidar]:
    """The rig's lidars by the bag's topics; empty where topics or frames do not match."""
    present = {topic.name.removeprefix("/") for topic in bag.topics.values() if topic.count}
    if not {topic.removeprefix("/") for topic in rig.with_topics} <= present:
        return {}
    known = {(c.topic.removeprefix("/"), c.frame_id): c.topic for c in candidates}
    keys = [((lidar.topic or "").removeprefix("/"), lidar.frame or "") for lidar in rig.lidars]
    if not known.keys() >= set(keys):
        return {}
    return {known[key]: lidar for key, lidar in zip(keys, rig.lidars, strict=True)}


def place_by_file(
    candidates: Sequence[Candidate], rig: RigFile, entries: dict[str, RigLidar], tree: FrameTree
) -> Placement:
    """Place the candidates by a rig file, those without extrinsics by the bag's transforms."""
    base = rig.base or tree.root(candidates[0].frame_id)[0]
    placed, edges = [], {edge.child: edge for edge in tree.edges}
    for c in candidates:
        lidar = entries.get(c.topic)
        T = lidar.T_base_sensor if lidar else None
        if T is not None:
            edges[c.frame_id] = StaticTransform(base, c.frame_id, T)
        else:
            T = tree.between(base, c.frame_id)
        if T is None:
            known = ", ".join(tree.frames) or "none"
            raise InputError(
                f"{rig.path}: no extrinsics for {c.topic} (frame {c.frame_id}) in {base}; give "
                f"translation and quaternion_xyzw. The bag has the frames: {known}"
            )
        clock_ns = round(1e9 * lidar.clock_s) if lidar else 0
        decoding = replace(c.decoding, clock_ns=clock_ns)
        roles = lidar.roles if lidar else ()
        placed.append(replace(c, T_base_sensor=T, roles=roles, decoding=decoding))
    return Placement(placed, base, tuple(edges.values()))


def place_by_transforms(
    bag: Bag,
    candidates: Sequence[Candidate],
    chosen: Set[str],
    tree: FrameTree,
    warnings: list[str],
) -> Placement:
    """Place the candidates that the bag's transforms join.

    Raises InputError where these are fewer than two, or lack a chosen one.
    """
    by_root: dict[str, list[Candidate]] = {}
    for c in candidates:
        known = c.frame_id in tree.frames
        by_root.setdefault(tree.root(c.frame_id)[0] if known else c.topic, []).append(c)
    together = max(by_root.values(), key=lambda group: (len(group), [c.worth for c in group]))
    apart = [c for c in candidates if c not in together]
    if missing := [c for c in apart if c.topic in chosen] or (apart if len(together) < 2 else []):
        frames = {c.frame_id for c in candidates}
        alike = [rig for rig in built_in_rigs() if {lidar.frame for lidar in rig.lidars} <= frames]
        named = f"--rig {alike[0].name} (a built-in rig with these frames), " if alike else ""
        raise InputError(
            f"{bag.path.name}: no extrinsics: no transforms join frame {together[0].frame_id} "
            f"({together[0].topic}) with {missing[0].frame_id} ({missing[0].topic}); the bag has "
            f"the frames: {', '.join(tree.frames) or 'none'}. Pass {named}--rig FILE, "
            "or record /tf_static"
        )
    if apart:
        names = ", ".join(c.topic for c in apart)
        warnings.append(f"not used: {names} (no transforms join their frames with the others)")
    above = [tree.above(c.frame_id) for c in together]
    common = [frame for frame in reversed(above[0]) if all(frame in own for own in above)]
    robots = (frame for frame in common if frame.rpartition("/")[2] in _ROBOT_FRAMES)
    base = next(robots, common[0])
    T_base_root = transforms.invert(tree.root(base)[1])
    placed = [
        replace(c, T_base_sensor=T_base_root @ tree.root(c.frame_id)[1]) for c in together
    ]
    return Placement(placed, base, tree.edges)


def check_reach(source: object, placement: Placement) -> None:
    """Raise InputError where a lidar is farther from the base than any robot is long."""
    for c in placement.candidates:
        away_m = float(np.linalg.norm(c.T_base_sensor[:3, 3]))
        if away_m > _REACH_MAX_M:
            raise InputError(
                f"{source}: puts {c.frame_id} ({c.topic}) {away_m:.6g} m away from "
                f"{placement.base}, which no robot spans; name the robot's frame in --rig FILE, "
                'as in base = "base_link", or give the extrinsics there'
            )

