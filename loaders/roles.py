"""The role of each lidar, by its spin axis.

Names are misleading: in one public data set `vertical_velodyne` scans the walls, in another it
drives the odometry. The lidar whose spin axis is nearest to gravity drives the odometry (the
"horizontal" lidar: it scans horizontally). All that sweep walls from floor to ceiling are labelled
(the "vertical" lidars): those on their side, and upright ones with a wide field of view.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ffmap.loaders.candidates import Candidate
from ffmap.loaders.rig import Lidar
from ffmap.loaders.rig_file import Role

_OPENING_MIN_DEG = 55.0  # A column of less shows floor and ceiling only where a wall is far away
_EQUAL_WITHIN_DEG = 5.0  # Lidars whose axes differ by less are equally upright
_SCAN_POINTS = 100_000  # Of a scan without rings; 128 rings have as many, a third of a degree apart
_SCAN_MAX_NS = 500_000_000  # In more, people walk on and the robot leaves the room


def assign_roles(
    candidates: Sequence[Candidate], requested: Mapping[Role, list[str]], warnings: list[str]
) -> tuple[Lidar, tuple[Lidar, ...]]:
    """Choose the lidar that drives odometry, and those that are labelled.

    requested: topics that the user named for a role; these, and the roles of a rig file, are kept.
    """
    horizontals, verticals = (_named(candidates, requested, role) for role in _ROLES)
    if horizontals:
        horizontal = horizontals[0]
    else:
        labelled = {lidar.topic for lidar in verticals}
        free = [c for c in candidates if c.topic not in labelled] or candidates
        chosen, reason = _most_aligned(free, {c.topic: c.tilt_deg for c in free}, "gravity")
        horizontal = _lidar(chosen, "the only lidar" if len(candidates) == 1 else reason)
        if not (chosen.upright or (verticals and len(candidates) == 1)):
            warnings.append(f"{chosen.topic}: no lidar is upright; odometry uses one on its side")
    if not verticals:
        alone = len(candidates) == 1 and not horizontals
        lying = [c for c in candidates if not c.upright and (alone or c.topic != horizontal.topic)]
        upright = [c for c in candidates if c.upright or len(candidates) == 1]
        verticals = [*_lying(lying), *(_wide(upright) if not (alone and lying) else ())]
        if not verticals and upright:
            widest = max(upright, key=lambda c: (c.opening_deg, c.worth))
            warnings.append(
                f"nothing to label: no lidar is on its side, and {widest.topic}, upright, opens to "
                f"{widest.opening_deg:.0f} deg: floor and ceiling are seldom in one view (that "
                f"takes {_OPENING_MIN_DEG:.0f}). --vertical {widest.topic} labels it nevertheless; "
                "where a lidar is on its side, --rig FILE sets its extrinsics"
            )
    labelled_lidars = tuple(map(_gathering, verticals))
    _warn_of_clouds(horizontal, labelled_lidars, warnings)
    return horizontal, labelled_lidars


_ROLES: tuple[Role, Role] = ("horizontal", "vertical")


def _named(
    candidates: Sequence[Candidate], requested: Mapping[Role, list[str]], role: Role
) -> list[Lidar]:
    by_topic = {c.topic: c for c in candidates}
    if role in requested:
        return [_lidar(by_topic[topic], f"--{role} names it") for topic in requested[role]]
    return [
        _lidar(c, "the rig file gives it this role") for c in candidates if role in c.roles
    ]


def _lidar(c: Candidate, reasons: str) -> Lidar:
    return Lidar(c.topic, c.frame_id, c.T_base_sensor, c.decoding, c.points_per_cloud, reasons)


def _lying(candidates: list[Candidate]) -> list[Lidar]:
    """Lidars on their side, whose emitters sweep the walls, the most level first."""
    lidars: list[Lidar] = []
    while candidates:
        off_deg = {c.topic: 90.0 - c.tilt_deg for c in candidates}
        chosen, reason = _most_aligned(candidates, off_deg, "level")
        also = f"on its side, its spin axis {off_deg[chosen.topic]:.1f} deg off level"
        lidars.append(_lidar(chosen, also if lidars else reason))
        candidates = [c for c in candidates if c is not chosen]
    return lidars


def _wide(upright: list[Candidate]) -> list[Lidar]:
    """Upright lidars whose columns sweep the walls, the widest first."""
    return [
        _lidar(c, f"upright, it opens to {c.opening_deg:.0f} deg: its columns sweep the walls")
        for c in sorted(upright, key=lambda c: (c.opening_deg, c.worth), reverse=True)
        if c.opening_deg >= _OPENING_MIN_DEG
    ]


def _most_aligned(
    candidates: Sequence[Candidate], off_deg: dict[str, float], direction: str
) -> tuple[Candidate, str]:
    """Choose the candidate with the smallest angle; of equal ones the best cloud."""
    smallest_deg = min(off_deg.values())
    equal = [c for c in candidates if off_deg[c.topic] <= smallest_deg + _EQUAL_WITHIN_DEG]
    chosen = max(equal, key=lambda c: c.worth)
    more = " and sees the most" if len(equal) > 1 else ""
    off = f"{off_deg[chosen.topic]:.1f} deg off"
    return chosen, f"its spin axis is nearest to {direction} ({off}){more}"


def _gathering(lidar: Lidar) -> Lidar:
    """Join clouds of a pattern that does not repeat, until they show surfaces."""
    period_ns = lidar.decoding.period_ns
    if not lidar.ringless or not period_ns or not lidar.points_per_cloud:
        return lidar
    clouds = min(round(_SCAN_POINTS / lidar.points_per_cloud), round(_SCAN_MAX_NS / period_ns))
    clouds = max(clouds, 1)
    return replace(
        lidar,
        decoding=replace(lidar.decoding, period_ns=clouds * period_ns),
        points_per_cloud=clouds * lidar.points_per_cloud,
        reasons=f"{lidar.reasons}; its pattern does not repeat, {clouds} clouds make a scan",
        clouds_a_scan=clouds,
    )


def _warn_of_clouds(
    horizontal: Lidar, verticals: Sequence[Lidar], warnings: list[str]
) -> None:
    """Warn of clouds without times or rings, and of a narrow field of view."""
    for lidar in {lidar.topic: lidar for lidar in (horizontal, *verticals)}.values():
        roles = ["horizontal"] if lidar.topic == horizontal.topic else []
        roles += ["vertical"] if any(lidar.topic == each.topic for each in verticals) else []
        name = f"{lidar.topic} ({' and '.join(roles)})"
        if not lidar.decoding.timed:
            warnings.append(
                f"{name}: its points have no times, or none in a known unit; motion compensation "
                "is off; --time-from azimuth computes them, unless the clouds are compensated "
                "already"
            )
        if lidar.decoding.rings.source == "bins" and not lidar.ringless:
            warnings.append(f"{name}: no ring field, and the elevations show no rings")
        if lidar.decoding.dual:
            warnings.append(
                f"{name}: firings return twice; only the farther return of each is used"
            )
    for lidar in verticals:
        if lidar.column_pairs and lidar.opening_deg < _OPENING_MIN_DEG:
            warnings.append(
                f"{lidar.topic}: upright, and opens to {lidar.opening_deg:.0f} deg: its columns "
                f"seldom show floor and ceiling together (that takes {_OPENING_MIN_DEG:.0f}); "
                "where it is on its side, --rig FILE sets its extrinsics"
            )
