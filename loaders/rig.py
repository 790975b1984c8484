"""Which lidar sits where, and what each is for.

Names do not tell: in one public data set `vertical_velodyne` scans the walls, in another it drives the odometry. The
lidar whose spin axis is nearest to gravity drives odometry (the "horizontal" lidar: it scans horizontally). Labelled are
all that sweep walls from floor to ceiling (the "vertical" lidars): those that lie on their side, and those that stand upright
and open wide, among them the one that drives odometry.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory, seen_at_once
from ffmap.algorithms.scan.point_lines import COLUMN_PAIRS
from ffmap.loaders.bag import Bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.candidates import (
    UPRIGHT_DEG,
    Candidate,
    find_candidates,
    one_a_frame,
    opening_deg_of,
    tilt_deg_of,
    without_cameras,
)
from ffmap.loaders.cloud_index import CloudIndex, index_clouds
from ffmap.loaders.decoding import CloudDecoding, TimeFrom
from ffmap.loaders.errors import InputError
from ffmap.loaders.frames import FrameTree, StaticTransform, read_frame_tree
from ffmap.loaders.rig_file import RigEntry, RigFile, Role, built_in_rigs, read_rig_file
from ffmap.loaders.sensors import CLOUDS_WANTED, cloud_hint, cloud_topics, sensor_of, unread_topics
from ffmap.loaders.which_way_up import LidarView, find_upright_base

_OPENING_MIN_DEG = 55.0  # A column of less shows floor and ceiling together only where a wall is far away
_EQUAL_WITHIN_DEG = 5.0  # Lidars whose axes differ by less are equally upright: the one that sees more is taken
_SCAN_POINTS = 100_000  # of a scan without rings: as many as 128 rings have, a degree's third apart
_SCAN_MAX_NS = 500_000_000  # In more, people walk on and the robot leaves the room
_REACH_MAX_M = 100.0
_ROBOT_FRAMES = ("base_footprint", "base_link")
_SAME_DEG, _SAME_M = 2.0, 0.05  # Mounts that differ by less are the same one, measured twice


@dataclass(frozen=True, eq=False)
class Lidar:
    """A lidar of the rig. T_base_sensor: (4, 4). decoding: how its clouds become scans; for `read_scans`.

    points_per_cloud: valid points of a scan, the median of some. reasons: why it has its role, one line.
    clouds_a_scan: successive clouds that are labelled as one.
    """

    topic: str
    frame_id: str
    T_base_sensor: FloatArray
    decoding: CloudDecoding
    points_per_cloud: int
    reasons: str
    clouds_a_scan: int = 1

    def index(self, bag: Bag) -> CloudIndex:
        """Where its scans lie in a bag."""
        return index_clouds(bag, self.topic).gathered(self.clouds_a_scan)

    def seen(self, scan: Scan, trajectory: Trajectory) -> Scan:
        """The scan as the method takes it. trajectory: T_map_base, which covers it.

        Without rings, only what was seen from one place is in any order.
        """
        if not self.ringless:
            return scan
        return seen_at_once(scan, trajectory, self.T_base_sensor, self.decoding.rings.edge_tan)

    @property
    def ringless(self) -> bool:
        """Whether it stands upright, and its firings have times and no rings: its pattern does not repeat."""
        measured = self.decoding.time is not None and self.decoding.time_from == "auto"
        return self.column_pairs > 0 and self.decoding.rings.source == "bins" and measured

    @property
    def ring_count(self) -> int:
        """How many emitters it has."""
        return self.decoding.rings.count

    @property
    def tilt_deg(self) -> float:
        """Angle between its spin axis and the base's z axis, 0 to 90°."""
        return tilt_deg_of(self.T_base_sensor)

    @property
    def opening_deg(self) -> float:
        """Angle between its lowest and its highest ring."""
        return opening_deg_of(self.decoding)

    @property
    def column_pairs(self) -> int:
        """Pairs of columns that are its point lines where it stands upright; 0 where it lies, for its emitters are."""
        return COLUMN_PAIRS if self.tilt_deg <= UPRIGHT_DEG else 0

    @property
    def line_pairs(self) -> int:
        """Pairs of point lines, of columns or of emitters."""
        return self.column_pairs or self.ring_count


@dataclass(frozen=True)
class MountCorrection:
    """Where a vertical lidar was found to sit and by which clock to run, in place of what bag or rig file say.

    topic: the lidar's. T_base_sensor: (4, 4), row by row. clock_ns: what is added to its firings' times.
    """

    topic: str
    T_base_sensor: tuple[tuple[float, ...], ...]
    clock_ns: int


@dataclass(frozen=True, eq=False)
class Rig:
    """The lidars with their roles.

    base_frame: the frame whose pose the trajectory gives.
    horizontal: drives odometry; None where the bag has none.
    verticals: are labelled, the most level one first; none where there is nothing to label.
    static_transforms: all that are known, for the results' /tf_static.
    warnings: what a user must know about the choice.
    mounts_from: what says where the lidars sit, in words.
    """

    base_frame: str
    horizontal: Lidar | None
    verticals: tuple[Lidar, ...]
    static_transforms: tuple[StaticTransform, ...]
    warnings: tuple[str, ...]
    mounts_from: str = "the bag's transforms"

    @property
    def vertical(self) -> Lidar | None:
        """The first of those that are labelled, and mostly the only one."""
        return next(iter(self.verticals), None)

    def with_mount(self, mount: MountCorrection) -> "Rig":
        """The same with a vertical lidar where it was found to sit, in the static transforms too; as it is without that lidar."""
        moved = next((lidar for lidar in self.verticals if lidar.topic == mount.topic), None)
        if moved is None:
            return self
        decoding = replace(moved.decoding, clock_ns=mount.clock_ns)
        found = replace(moved, T_base_sensor=np.array(mount.T_base_sensor), decoding=decoding)
        others = tuple(edge for edge in self.static_transforms if edge.child != found.frame_id)
        parent = next((e.parent for e in self.static_transforms if e.child == found.frame_id), self.base_frame)
        T_parent_base = self.tree.between(parent, self.base_frame)
        if T_parent_base is None:
            parent, T_parent_base = self.base_frame, np.eye(4)
        edge = StaticTransform(parent, found.frame_id, T_parent_base @ found.T_base_sensor)
        verticals = tuple(found if lidar is moved else lidar for lidar in self.verticals)
        return replace(self, verticals=verticals, static_transforms=(*others, edge))

    @property
    def tree(self) -> FrameTree:
        """The static transforms as a tree."""
        return FrameTree(self.static_transforms)


def find_rig(
    bag: Bag,
    rig_file: Path | None = None,
    horizontal: str | None = None,
    verticals: Sequence[str] = (),
    time_from: TimeFrom = "auto",
    unplaced: bool = False,
) -> Rig:
    """The rig of a bag.

    rig_file: where the lidars sit; None to ask the bag's transforms, and where these do not place them the built-in rigs.
    horizontal, verticals: topics that are to have these roles; None, or none, to decide by the spin axes. One topic may have
        both.
    time_from: where the firings' times come from. unplaced: whether lidars that are named for both roles may be joined by nothing;
        they are put where the horizontal one is.
    Raises InputError: no clouds, an unknown topic or frame, several lidars and no transforms that join them, a rig file
    that is not understood.
    """
    warnings = list(unread_topics(bag).values())
    described = read_rig_file(rig_file) if rig_file else None
    named: dict[Role, Sequence[str]] = {"horizontal": () if horizontal is None else (horizontal,), "vertical": verticals}
    asked = {role: _cloud_topics(bag, names, role) for role, names in named.items() if names}
    chosen = {topic for topics in asked.values() for topic in topics}
    topics = cloud_topics(bag)
    if not topics:
        raise _no_clouds(bag)
    entries: dict[str, RigEntry] = {}
    if described:
        entries = _named_topics(bag, described, topics)
        topics = [*dict.fromkeys([*entries, *(topic for own in asked.values() for topic in own)])]
    if len(asked) == 2:
        topics = [t for t in topics if t in chosen]
    candidates = find_candidates(bag, topics, time_from, warnings)
    if described is None and (fitting := _fitting_built_in(bag, candidates, chosen, warnings)):
        described, entries = fitting
        candidates = [c for c in candidates if c.topic in entries]
    candidates = without_cameras(bag, candidates, {*chosen, *entries}, warnings)
    candidates = one_a_frame(bag, candidates, {*chosen, *entries}, warnings)
    first = asked["horizontal"][0] if unplaced and len(asked) == 2 else None
    candidates, base, edges = _place(bag, candidates, described, entries, chosen, warnings, first)
    if first is None:
        candidates, base, edges = _upright(candidates, base, edges, warnings, described is None)
    _check_reach(described.path if described else bag.path, candidates, base)
    drives, sweeping = _roles(candidates, asked, warnings)
    labelled = tuple(map(_gathering, sweeping))
    _warn_of_clouds(drives, labelled, warnings)
    placed = len(candidates) > 1 or base != candidates[0].frame_id
    mounts_from = (
        described.said if described else "the bag's transforms" if placed else "nothing: the only lidar is the base"
    )
    return Rig(base, drives, labelled, edges, tuple(warnings), mounts_from)


def _warn_of_clouds(horizontal: Lidar, verticals: tuple[Lidar, ...], warnings: list[str]) -> None:
    """Warn of what the clouds of each lidar with a role lack, and of upright ones that see little of floor and ceiling together."""
    by_role = {"horizontal": [horizontal.topic], "vertical": [lidar.topic for lidar in verticals]}
    for lidar in {lidar.topic: lidar for lidar in (horizontal, *verticals)}.values():
        name = f"{lidar.topic} ({' and '.join(role for role, topics in by_role.items() if lidar.topic in topics)})"
        if not lidar.decoding.timed:
            warnings.append(
                f"{name}: its points have no times, or none whose unit can be told; motion compensation is "
                "off; --time-from azimuth recovers them, but must not be used where the clouds are compensated already"
            )
        if lidar.decoding.rings.source == "bins" and not lidar.ringless:
            warnings.append(f"{name}: no ring field, and the elevations tell no rings apart")
        if lidar.decoding.dual:
            warnings.append(f"{name}: firings return twice; only the farther return of each is used")
    for lidar in verticals:
        if lidar.column_pairs and lidar.opening_deg < _OPENING_MIN_DEG:
            warnings.append(
                f"{lidar.topic}: stands upright and opens to {lidar.opening_deg:.0f} deg: its columns seldom show floor and "
                f"ceiling together (that takes {_OPENING_MIN_DEG:.0f}), and near walls are told by less; where it lies, "
                "--rig FILE tells its mount"
            )


def _fitting_built_in(
    bag: Bag, candidates: list[Candidate], chosen: set[str], warnings: list[str]
) -> tuple[RigFile, dict[str, RigEntry]] | None:
    """The built-in rig whose topics and frames the bag has, with the lidars by their topics, unless the bag's own transforms
    place them: these are of this very robot, the rig is of the data set.
    """
    fitting = [(rig, entries) for rig in built_in_rigs() if (entries := _fitting_entries(bag, candidates, rig))]
    if len(fitting) != 1 or not chosen <= fitting[0][1].keys():
        return None
    rig, entries = fitting[0]
    tree = read_frame_tree(bag, {topic: entry.frame for topic, entry in entries.items() if entry.frame})
    off = _off_from_bag(tree, rig)
    if off is None:
        warnings.append(
            f"the bag has no transforms that place its lidars; by its topics and frames it is of {rig.said} "
            f"({rig.description}), whose mounts are used; --rig FILE overrules that"
        )
        return rig, entries
    off_deg, off_m = off
    if off_deg > _SAME_DEG or off_m > _SAME_M:
        warnings.append(
            f"by topics and frames the bag is of {rig.said} ({rig.description}), but its own transforms put the lidars "
            f"{off_deg:.1f} deg and {100 * off_m:.0f} cm elsewhere: they are used; --rig {rig.name} takes the rig's mounts"
        )
    return None


def _fitting_entries(bag: Bag, candidates: list[Candidate], rig: RigFile) -> dict[str, RigEntry]:
    """The rig's lidars by the bag's topics; none where the bag lacks a topic of the rig, or has it with another frame."""
    present = {topic.name.removeprefix("/") for topic in bag.topics.values() if topic.count}
    entries = {
        candidate.topic: entry
        for entry in rig.lidars
        for candidate in candidates
        if entry.topic is not None
        and (entry.topic.removeprefix("/"), entry.frame) == (candidate.topic.removeprefix("/"), candidate.frame_id)
    }
    known = {topic.removeprefix("/") for topic in rig.with_topics} <= present
    return entries if known and len(entries) == len(rig.lidars) else {}


def _off_from_bag(tree: FrameTree, rig: RigFile) -> tuple[float, float] | None:
    """By how many degrees and metres the bag's transforms put the rig's lidars elsewhere, seen from its first; None where they
    do not place all of them.
    """
    frames = [entry.frame or "" for entry in rig.lidars]
    alone = len(frames) == 1 and tree.root(frames[0])[0] == frames[0]
    if alone or not set(frames) <= set(tree.frames):
        return None
    off_deg, off_m = 0.0, 0.0
    first = rig.lidars[0].T_base_sensor
    for entry, frame in zip(rig.lidars[1:], frames[1:], strict=True):
        T_bag = tree.between(frames[0], frame)
        if T_bag is None or first is None or entry.T_base_sensor is None:
            return None
        T_off = transforms.invert(T_bag) @ transforms.invert(first) @ entry.T_base_sensor
        twist = transforms.to_twist(T_off)
        off_deg = max(off_deg, float(np.degrees(np.linalg.norm(twist[:3]))))
        off_m = max(off_m, float(np.linalg.norm(twist[3:])))
    return off_deg, off_m


def _cloud_topics(bag: Bag, names: Sequence[str], role: str) -> list[str]:
    """The topics that a user names, each once, with or without their leading slash."""
    return list(dict.fromkeys(_cloud_topic(bag, name, role) for name in names))


def _cloud_topic(bag: Bag, name: str, role: str) -> str:
    topics = cloud_topics(bag)
    for candidate in (name, f"/{name}", name.removeprefix("/")):
        if candidate in topics:
            return candidate
    raise InputError(f"{bag.path.name}: --{role} {name} is no topic with clouds; {cloud_hint(bag)}")


def _no_clouds(bag: Bag) -> InputError:
    if bag.start_ns is None:
        return InputError(f"{bag.path}: the bag is empty, it has no messages; record it again")
    if unread := unread_topics(bag):
        return InputError(f"{bag.path}: no lidar can be read; {'; '.join(unread.values())}")
    return InputError(
        f"{bag.path}: no {CLOUDS_WANTED} in the bag; its topics are: {', '.join(bag.topics)}. Record the lidars' clouds"
    )


def _place(
    bag: Bag,
    candidates: list[Candidate],
    described: RigFile | None,
    entries: dict[str, RigEntry],
    chosen: set[str],
    warnings: list[str],
    first: str | None,
) -> tuple[list[Candidate], str, tuple[StaticTransform, ...]]:
    """The candidates with their T_base_sensor, the base's frame, and all static transforms.

    first: topic of the lidar that the chosen ones are put at where no transforms join them; None to refuse these.
    """
    tree = read_frame_tree(bag, {c.topic: c.frame_id for c in candidates})
    warnings += tree.warnings
    if described:
        return _place_by_file(candidates, described, entries, tree)
    roots = {c.topic: tree.root(c.frame_id) for c in candidates}
    if len(candidates) == 1:
        return *_in_base(candidates, roots[candidates[0].topic][0], tree), tree.edges
    known = [c for c in candidates if c.frame_id in tree.frames]
    unknown = [c for c in candidates if c not in known]
    wanted = [c for c in candidates if c.topic in chosen]
    if first and (any(c in unknown for c in wanted) or len({roots[c.topic][0] for c in wanted}) > 1):
        return wanted, next(c.frame_id for c in wanted if c.topic == first), ()
    if not known:
        pairs = " and ".join(f"{c.frame_id} ({c.topic})" for c in candidates)
        frames = {c.frame_id for c in candidates}
        alike = [rig for rig in built_in_rigs() if {entry.frame for entry in rig.lidars} <= frames]
        known_rig = f", --rig {alike[0].name}, a built-in rig with these frames," if alike else ""
        raise InputError(
            f"{bag.path.name}: no transforms say where the lidars' frames {pairs} are; give --rig FILE.toml{known_rig} or "
            "record /tf_static"
        )
    needed = [c for c in unknown if c.topic in chosen] or (unknown if len(known) < 2 else [])
    if needed:
        raise InputError(
            f"{bag.path.name}: frame {needed[0].frame_id} of {needed[0].topic} is unknown; the bag's transforms know: "
            f"{', '.join(tree.frames)}. Give --rig FILE.toml"
        )
    if unknown:
        warnings.append(f"not used: {', '.join(c.topic for c in unknown)} (their frames are unknown)")
    by_root: dict[str, list[Candidate]] = {}
    for candidate in known:
        by_root.setdefault(roots[candidate.topic][0], []).append(candidate)
    root, together = max(by_root.items(), key=lambda item: (len(item[1]), [c.worth for c in item[1]]))
    apart = [c for c in known if c not in together]
    if apart and (len(together) < 2 or any(c.topic in chosen for c in apart)):
        raise InputError(
            f"{bag.path.name}: no transforms join frame {together[0].frame_id} ({together[0].topic}) with "
            f"{apart[0].frame_id} ({apart[0].topic}); the bag's frames are: {', '.join(tree.frames)}. "
            "Give --rig FILE.toml"
        )
    return *_in_base(together, root, tree), tree.edges


def _in_base(candidates: list[Candidate], root: str, tree: FrameTree) -> tuple[list[Candidate], str]:
    """The candidates in the robot's own frame (REP 105) above all of them, or else in the topmost frame."""
    above = [tree.above(c.frame_id) for c in candidates]
    common = [frame for frame in reversed(above[0]) if all(frame in own for own in above)]
    base = next((frame for frame in common if frame.rpartition("/")[2] in _ROBOT_FRAMES), root)
    T_base_root = transforms.invert(tree.root(base)[1])
    return [replace(c, T_base_sensor=T_base_root @ tree.root(c.frame_id)[1]) for c in candidates], base


def _upright(
    candidates: list[Candidate],
    base: str,
    edges: tuple[StaticTransform, ...],
    warnings: list[str],
    may_change: bool,
) -> tuple[list[Candidate], str, tuple[StaticTransform, ...]]:
    """The candidates in a base whose z points up, as the clouds show it."""
    views = [LidarView(c.topic, c.frame_id, c.clouds, c.T_base_sensor) for c in candidates]
    found = find_upright_base(base, FrameTree(edges), views, may_change)
    if found is None:
        return candidates, base, edges
    warnings.append(found.warning)
    T_new_base = transforms.invert(found.T_base_frame)
    placed = [replace(c, T_base_sensor=T_new_base @ c.T_base_sensor) for c in candidates]
    return placed, found.frame, (*edges, found.edge) if found.edge else edges


def _check_reach(source: Path | BagPath, candidates: list[Candidate], base: str) -> None:
    """Raises InputError where a lidar is farther from the base than any robot is long: float32 would lose the millimetres."""
    for candidate in candidates:
        away_m = float(np.linalg.norm(candidate.T_base_sensor[:3, 3]))
        if away_m > _REACH_MAX_M:
            raise InputError(
                f"{source}: puts {candidate.frame_id} ({candidate.topic}) {away_m:.6g} m away from {base}, which no robot "
                'spans; say in --rig FILE.toml which frame is the robot\'s, as in base = "base_link", or where the lidar sits'
            )


def _place_by_file(
    candidates: list[Candidate], described: RigFile, entries: dict[str, RigEntry], tree: FrameTree
) -> tuple[list[Candidate], str, tuple[StaticTransform, ...]]:
    base = described.base or tree.root(candidates[0].frame_id)[0]
    placed, edges = [], {edge.child: edge for edge in tree.edges}
    for candidate in candidates:
        entry = entries.get(candidate.topic)
        T = entry.T_base_sensor if entry else None
        if T is None:
            T = tree.between(base, candidate.frame_id)
            if T is None:
                known = ", ".join(tree.frames) or "none"
                raise InputError(
                    f"{described.path}: no place for {candidate.topic} (frame {candidate.frame_id}) in {base}; give "
                    f"translation and quaternion_xyzw. Frames that the bag knows: {known}"
                )
        else:
            edges[candidate.frame_id] = StaticTransform(base, candidate.frame_id, T)
        decoding = replace(candidate.decoding, clock_ns=round(1e9 * entry.clock_s) if entry else 0)
        roles = entry.roles if entry else ()
        placed.append(replace(candidate, T_base_sensor=T, roles=roles, decoding=decoding))
    return placed, base, tuple(edges.values())


def _roles(
    candidates: list[Candidate], asked: dict[Role, list[str]], warnings: list[str]
) -> tuple[Lidar, tuple[Lidar, ...]]:
    """The lidar that drives odometry, and those that are labelled: as they were named, by what they are where none was."""
    by_topic = {c.topic: c for c in candidates}
    horizontals, verticals = (
        [_lidar(by_topic[topic], f"--{role} names it") for topic in asked[role]]
        if role in asked
        else [_lidar(c, "the rig file gives it this role") for c in candidates if role in c.roles]
        for role in get_args(Role)
    )
    horizontal: Lidar | None = next(iter(horizontals), None)
    if len(candidates) == 1:
        return _roles_of_one(candidates[0], horizontal, tuple(verticals), warnings)
    if horizontal is None:
        labelled = [lidar.topic for lidar in verticals]
        free = [c for c in candidates if c.topic not in labelled] or candidates
        chosen, reasons = _most_aligned(free, {c.topic: c.tilt_deg for c in free}, "gravity")
        horizontal = _lidar(chosen, reasons)
        if not chosen.upright:
            warnings.append(f"{chosen.topic}: no lidar stands upright; odometry has to do with one that does not")
    if verticals:
        return horizontal, tuple(verticals)
    lying = [c for c in candidates if not c.upright and c.topic != horizontal.topic]
    upright = [c for c in candidates if c.upright]
    swept = [*_lying(lying), *_sweeping_by_columns(upright)]
    if not swept and upright:
        warnings.append(_nothing_to_label(upright))
    return horizontal, tuple(swept)


def _lidar(candidate: Candidate, reasons: str) -> Lidar:
    c = candidate
    return Lidar(c.topic, c.frame_id, c.T_base_sensor, c.decoding, c.points, reasons)


def _lying(candidates: list[Candidate]) -> list[Lidar]:
    """Lidars on their side, whose emitters sweep the walls: the most level first."""
    lidars: list[Lidar] = []
    while candidates:
        chosen, reasons = _most_aligned(candidates, {c.topic: 90.0 - c.tilt_deg for c in candidates}, "level")
        also = f"on its side, its spin axis {90.0 - chosen.tilt_deg:.1f} deg off level"
        lidars.append(_lidar(chosen, also if lidars else reasons))
        candidates = [c for c in candidates if c is not chosen]
    return lidars


def _sweeping_by_columns(upright: list[Candidate]) -> list[Lidar]:
    """Upright lidars that open wide enough for their columns to sweep the walls: the widest first."""
    widest_first = sorted(upright, key=lambda c: (c.opening_deg, c.worth), reverse=True)
    return [
        _lidar(c, f"upright, it opens to {c.opening_deg:.0f} deg: its columns sweep the walls")
        for c in widest_first
        if c.opening_deg >= _OPENING_MIN_DEG
    ]


def _nothing_to_label(upright: list[Candidate]) -> str:
    widest = max(upright, key=lambda c: (c.opening_deg, c.worth))
    return (
        f"nothing to label: no lidar lies on its side, and {widest.topic}, upright, opens to {widest.opening_deg:.0f} deg: floor "
        f"and ceiling are seldom in one view (that takes {_OPENING_MIN_DEG:.0f}). --vertical {widest.topic} labels it "
        "nevertheless; where a lidar does lie, --rig FILE tells its mount"
    )


def _gathering(lidar: Lidar) -> Lidar:
    """The lidar that is labelled, with as many clouds a scan as it takes to see surfaces, where its pattern does not repeat."""
    period_ns = lidar.decoding.period_ns
    if not lidar.ringless or not period_ns or not lidar.points_per_cloud:
        return lidar
    clouds = max(min(round(_SCAN_POINTS / lidar.points_per_cloud), round(_SCAN_MAX_NS / period_ns)), 1)
    return replace(
        lidar,
        decoding=replace(lidar.decoding, period_ns=clouds * period_ns),
        points_per_cloud=clouds * lidar.points_per_cloud,
        reasons=f"{lidar.reasons}; its pattern does not repeat, {clouds} clouds make a scan",
        clouds_a_scan=clouds,
    )


def _most_aligned(candidates: list[Candidate], off_deg: dict[str, float], direction: str) -> tuple[Candidate, str]:
    """The candidate whose spin axis is nearest to a direction, and in words why; of equals the one that sees most.

    off_deg: angle between each candidate's spin axis and the direction, by topic.
    """
    smallest_deg = min(off_deg.values())
    equal = [c for c in candidates if off_deg[c.topic] <= smallest_deg + _EQUAL_WITHIN_DEG]
    chosen = max(equal, key=lambda c: c.worth)
    more = " and sees the most" if len(equal) > 1 else ""
    return chosen, f"its spin axis is nearest to {direction} ({off_deg[chosen.topic]:.1f} deg off){more}"


def _roles_of_one(
    only: Candidate, horizontal: Lidar | None, verticals: tuple[Lidar, ...], warnings: list[str]
) -> tuple[Lidar, tuple[Lidar, ...]]:
    if verticals:
        return horizontal or _lidar(only, "the only lidar: it drives odometry too"), verticals
    if horizontal is None and not only.upright:
        warnings.append(f"{only.topic}: the only lidar lies on its side; odometry has to do with it")
        labelled = _lidar(only, f"the only lidar, its spin axis {90 - only.tilt_deg:.1f} deg off level")
        return _lidar(only, "the only lidar: it drives odometry too"), (labelled,)
    swept = _sweeping_by_columns([only])
    if not swept:
        warnings.append(_nothing_to_label([only]))
    return horizontal or _lidar(only, "the only lidar, its spin axis upright or unknown"), tuple(swept)


def _named_topics(bag: Bag, described: RigFile, topics: list[str]) -> dict[str, RigEntry]:
    """The topics that a rig file's entries mean, with or without their leading slash; where an entry names none that the bag
    has, its frame tells, which is looked up in the clouds' first messages.
    """
    named: dict[str, RigEntry] = {}
    for entry in described.lidars:
        matches = [
            t for t in topics if entry.topic is not None and t.removeprefix("/") == entry.topic.removeprefix("/")
        ]
        if not matches and entry.frame is not None:
            frames = {topic: _frame_of(bag, topic) for topic in topics}
            matches = [topic for topic, frame in frames.items() if frame == entry.frame]
            if not matches and entry.topic is None:
                raise InputError(
                    f"{described.path}: frame {entry.frame} is unknown; the bag's clouds have the frames: "
                    f"{', '.join(sorted(set(frames.values())))}"
                )
        if not matches:
            raise InputError(f"{described.path}: topic {entry.topic} has no clouds in the bag; {cloud_hint(bag)}")
        for topic in matches:
            named.setdefault(topic, entry)
    return named


def _frame_of(bag: Bag, topic: str) -> str:
    sensor = sensor_of(bag.topics[topic])
    assert sensor is not None
    return sensor.frame_of(bag, topic)
