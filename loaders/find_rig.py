"""The rig of a bag: which topics are its lidars, where they are, and what each is for."""

from collections.abc import Sequence
from pathlib import Path

from ffmap.loaders.bag import Bag
from ffmap.loaders.candidates import find_candidates, one_a_frame, without_cameras
from ffmap.loaders.decoding import TimeFrom
from ffmap.loaders.errors import InputError
from ffmap.loaders.extrinsics import (
    Placement,
    check_reach,
    entries_of,
    find_built_in,
    place_by_file,
    place_by_transforms,
)
from ffmap.loaders.frames import read_frame_tree
from ffmap.loaders.rig import Rig
from ffmap.loaders.rig_file import RigLidar, Role, read_rig_file
from ffmap.loaders.roles import assign_roles
from ffmap.loaders.sensors import CLOUDS_WANTED, cloud_hint, cloud_topics, unread_topics
from ffmap.loaders.upright import make_upright


def find_rig(
    bag: Bag,
    rig_file: Path | None = None,
    horizontal: str | None = None,
    verticals: Sequence[str] = (),
    time_from: TimeFrom = "auto",
    unplaced: bool = False,
) -> Rig:
    """Find the lidars of a bag, their extrinsics and their roles.

    Args:
        rig_file: source of the extrinsics; None for the bag's transforms, or else a built-in rig.
        horizontal, verticals: topics with these roles; one topic may have both. Without them, the
            spin axes decide.
        time_from: source of the firing times.
        unplaced: whether lidars that are named for both roles may lack extrinsics; they are put
            where the horizontal one is.

    Raises InputError where there are no clouds, a topic or frame is unknown, or no extrinsics are
    known.
    """
    warnings = list(unread_topics(bag).values())
    topics = cloud_topics(bag)
    if not topics:
        raise _no_clouds(bag)
    named: dict[Role, Sequence[str]] = {
        "horizontal": () if horizontal is None else (horizontal,),
        "vertical": verticals,
    }
    requested = {role: _cloud_topics(bag, names, role) for role, names in named.items() if names}
    chosen = dict.fromkeys(topic for own in requested.values() for topic in own).keys()
    rig, entries = None, dict[str, RigLidar]()
    if rig_file:
        rig = read_rig_file(rig_file)
        entries = entries_of(bag, rig, topics)
        topics = [*dict.fromkeys([*entries, *chosen])]
    if len(requested) == 2:
        topics = [topic for topic in topics if topic in chosen]

    candidates = find_candidates(bag, topics, time_from, warnings)
    if rig is None and (fitting := find_built_in(bag, candidates, chosen, warnings)):
        rig, entries = fitting
        candidates = [c for c in candidates if c.topic in entries]
    candidates = without_cameras(bag, candidates, {*chosen, *entries}, warnings)
    candidates = one_a_frame(bag, candidates, {*chosen, *entries}, warnings)

    tree = read_frame_tree(bag, {c.topic: c.frame_id for c in candidates})
    warnings += tree.warnings
    unplaced = unplaced and len(requested) == 2
    if rig is not None:
        placement = place_by_file(candidates, rig, entries, tree)
    elif unplaced and len(candidates) > 1 and not tree.joins({c.frame_id for c in candidates}):
        base = next(c.frame_id for c in candidates if c.topic == requested["horizontal"][0])
        placement = Placement(candidates, base, ())
    else:
        placement = place_by_transforms(bag, candidates, chosen, tree, warnings)
    if not unplaced:
        placement = make_upright(placement, warnings, may_change=rig is None)
    check_reach(rig.path if rig else bag.path, placement)

    drives, labelled = assign_roles(placement.candidates, requested, warnings)
    source = "the bag's transforms"
    if rig is not None:
        source = rig.label
    elif [c.frame_id for c in placement.candidates] == [placement.base]:
        source = "nothing: the only lidar is the base"
    return Rig(placement.base, drives, labelled, placement.edges, tuple(warnings), source)


def _cloud_topics(bag: Bag, names: Sequence[str], role: Role) -> list[str]:
    """Look topics up, each once, with or without leading slash. Raises InputError without one."""
    known = {topic.removeprefix("/"): topic for topic in cloud_topics(bag)}
    found = dict[str, None]()
    for name in names:
        topic = known.get(name.removeprefix("/"))
        if topic is None:
            raise InputError(
                f"{bag.path.name}: --{role} {name} is no topic with clouds; {cloud_hint(bag)}"
            )
        found[topic] = None
    return list(found)


def _no_clouds(bag: Bag) -> InputError:
    if bag.start_ns is None:
        return InputError(f"{bag.path}: the bag is empty, it has no messages; record it again")
    if unread := unread_topics(bag):
        return InputError(f"{bag.path}: no lidar can be read; {'; '.join(unread.values())}")
    return InputError(
        f"{bag.path}: no {CLOUDS_WANTED} in the bag; its topics are: {', '.join(bag.topics)}. "
        "Record the lidars' clouds"
    )
