"""What each stretch of a wall face is: wall, doorway, window, furniture, found by one parse.

A face is parsed from one end to the other into stretches, each of a kind that says of which
material its cells are below a sill, up to a head, and above. The parse with the highest odds is
found by dynamic programming over the ends of stretches (a semi-Markov model: Sarawagi and Cohen,
2004), with sums over columns, so that a rectangle of one material costs two reads.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numba
import numpy as np
from pydantic import Field
from scipy.special import ndtr

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.evidence import BEFORE, DEEP, FOOT_ROW, LAYERS_M, ON, RECESS
from ffmap.algorithms.building.model import CELL_M, BuildingSettings, cells_in


class Material(IntEnum):
    """Of what a cell of a face is, by where the rays that cross it end."""

    SOLID = 0
    AIR = 1
    LEAF_RECESSED = 2
    LEAF_DEEP = 3
    LEAF_FAR = 4
    ANYTHING = 5
    """What lies behind an opening, whatever it is."""
    SET_BACK = 6
    """What closes an opening behind the face: a blind, a leaf."""
    BEHIND = 7
    """What is no part of this face, however far behind."""
    AWAY = 8
    """What is no part of this wall: air, and what stands behind it at more than a leaf's depth."""


SHARES = np.array(
    [
        [0.975, 0.008, 0.007, 0.01],
        [0.11, 0.25, 0.25, 0.8],
        [0.97, 0.01, 0.01, 0.01],
        [0.05, 0.92, 0.02, 0.01],
        [0.04, 0.03, 0.92, 0.01],
    ]
)
"""(5, 4) of the first five materials: the share of rays that end on the face or in its recess, deep
in it, far behind, and beyond, measured on drives with ground truth. Air does not sum to one: what
lies behind an opening is the scene's."""
RAY_M, CELL_MEAN_M = 0.015, 0.006
"""Standard deviation (m) of one return, and of a cell's mean however many returns it has."""
_OF_OPENINGS = list(range(Material.LEAF_RECESSED, Material.SET_BACK + 1))
_UNSEEN = 0.1
"""Odds (nats) of an unseen cell for being wall rather than an opening in it: most cells are."""
_LEAF_LESS = np.array([0.2, 0.1, 0.1])
"""How much less likely (nats) a leaf is than air where nothing is known of an opening."""


class Kind(IntEnum):
    """What a stretch of a face is."""

    WALL = 0
    GAP = 1
    """The face does not go on here."""
    HIDDEN = 2
    """Neither wall nor opening: what stands close before the face mixes with it."""
    DOORWAY = 3
    LEAF_RECESSED = 4
    LEAF_DEEP = 5
    LEAF_FAR = 6
    WINDOW = 7
    PANE = 8
    LOW = 9
    """Something ends below the ceiling: a cupboard, a parapet."""
    HANGING = 10
    """Something hangs from the ceiling: a duct, a beam."""
    PASSAGE = 11
    """An opening down to the floor, larger than doors are, that nothing closes."""


DOORS = Kind.DOORWAY, Kind.LEAF_RECESSED, Kind.LEAF_DEEP, Kind.LEAF_FAR
OPENINGS = (*DOORS, Kind.WINDOW, Kind.PANE, Kind.PASSAGE)
OF_WALLS = (Kind.WALL, *OPENINGS)
"""What a wall consists of."""


class ParseSettings(StepSettings):
    """Parsing wall faces into walls, openings and furniture."""

    rays_full: float = Field(
        4.0,
        gt=0,
        description="Rays of a cell beyond which more add hardly any odds: those of one scan err "
        "alike.",
    )
    odds_max: float = Field(
        6.0, gt=0, description="Maximum odds (nats) of one cell against a material: 1 in 400 errs."
    )
    cells_together: float = Field(
        4.0, ge=1, description="Neighbouring cells that err together, as drift moves them together."
    )
    change: float = Field(
        8.0, ge=0, description="Price (nats) of an edge between two stretches of a face."
    )
    opening: float = Field(
        4.0, ge=0, description="Price (nats) of a window, or of a thing that ends low."
    )
    door: float = Field(
        6.0, ge=0, description="Price (nats) of a door: where its foot is hidden it is a window."
    )
    pane: float = Field(
        12.0, ge=0, description="Price (nats) of glass down to the floor, or up to the ceiling."
    )
    hidden: float = Field(
        4.0, ge=0, description="Odds (nats) of a cell against being hidden, though it was seen."
    )
    window_sill_m: tuple[float, float] = Field(
        (0.35, 1.7), description="Height (m) of windows' sills above the floor."
    )
    window_size_m: float = Field(0.3, gt=0, description="Least width and height (m) of a window.")


_BY_BANDS = 3
"""Kinds before these are of one material from the floor to the ceiling."""
_STRETCH_MAX = 80
"""Longest stretch (columns) of one kind that is tried; longer things go on in another stretch."""
_CHAIN, _NEXT_PIECE = 4.0, 1.0
"""Prices (nats) of a mullion between two windows, and of a beam's or a shelf's next piece."""
_UNUSUAL, _RARE = 8.0, 40.0
"""Prices (nats) of what is unusual: a blind, what ends above 2.25 m or close to the ceiling; and of
what hardly exists: what hangs from the ceiling, a doorway without a lintel."""
_LOW_SILL, _OPEN_END = 4.0, 3.0
"""Prices (nats) of a sill below the knee, and of an opening at a face's end."""


@dataclass(frozen=True)
class Stretch:
    """A stretch of a face.

    first, after: its first column and the one after its last. sill, head: rows below and from
    which it is another material: see `Kind`. blind: the row from which, up to the head, something
    closes a window; the head where nothing does. odds: nats against the next best kind, second; of
    a wall, against what is no wall; of an opening down to the floor, against what is none.
    """

    kind: Kind
    first: int
    after: int
    sill: int
    head: int
    blind: int
    odds: float
    second: Kind

    @property
    def width_m(self) -> float:
        """Its width (m)."""
        return (self.after - self.first) * CELL_M

    @property
    def columns(self) -> slice:
        """Its columns."""
        return slice(self.first, self.after)


def material_odds(
    ended: FloatArray,
    depth_sum: FloatArray,
    top: IntArray,
    recess_min_m: float,
    settings: ParseSettings,
) -> FloatArray:
    """Log odds (c, rows, 9) of each cell for each material, against the likeliest of all.

    Where rays end tells materials apart but for what is recessed by centimetres: that the mean
    depth of a cell's returns tells, which is known better than any single one.

    ended, depth_sum: (c, rows, …) rays by layer, see `Evidence`. top: (c,) rows up to the
    ceiling; above, and below the foot, all odds are 0.
    """
    near = ended[..., ON : RECESS + 1].sum(axis=-1, dtype=np.float64)
    behind = np.concatenate([near[..., None], ended[..., DEEP:]], axis=-1).astype(np.float64)
    count = behind.sum(axis=-1)
    weight = settings.rays_full / (count + settings.rays_full)
    likely = (behind @ np.log(SHARES).T) * weight[..., None]
    depth_m = depth_sum[..., ON : RECESS + 1].sum(axis=-1, dtype=np.float64)
    recess = _recess_odds(near, depth_m, recess_min_m)
    recess *= near / np.maximum(count, 1.0)
    likely[..., Material.LEAF_RECESSED] += np.minimum(recess, 0.0)
    likely[..., Material.SOLID] -= np.maximum(recess, 0.0)
    likely -= likely.max(axis=-1, keepdims=True)
    odds = np.maximum(likely, -settings.odds_max)
    anything = np.maximum(odds[..., Material.AIR], (odds[..., 2:5] - _LEAF_LESS).max(axis=-1))
    rows = np.arange(ended.shape[1])
    asked = (rows >= FOOT_ROW) & (rows < top[:, None])
    seen = asked & (count > 0)
    set_back = odds[..., Material.LEAF_RECESSED : Material.LEAF_FAR].max(axis=-1)
    no_part = odds[..., Material.AIR :].max(axis=-1)
    away = np.maximum(odds[..., Material.AIR], odds[..., Material.LEAF_FAR])
    more = [layer[..., None] for layer in (anything, set_back, no_part, away)]
    all_odds = np.concatenate([odds, *more], axis=-1) * seen[..., None]
    all_odds[..., _OF_OPENINGS] -= _UNSEEN * (asked & ~seen)[..., None]
    return np.asarray(all_odds / settings.cells_together)


def _recess_odds(count: FloatArray, depth_sum: FloatArray, least_m: float) -> FloatArray:
    """Log odds of each cell for being recessed against lying in the face, by its mean depth.

    A recess is equally likely of each depth from `least_m` on; noise blurs its ends.
    """
    most_m = -LAYERS_M[DEEP]
    behind_m = -depth_sum / np.maximum(count, 1.0)
    sigma_m = np.sqrt(RAY_M**2 / np.maximum(count, 1.0) + CELL_MEAN_M**2)
    in_face = -0.5 * (behind_m / sigma_m) ** 2 - np.log(sigma_m * np.sqrt(2.0 * np.pi))
    within = ndtr((most_m - behind_m) / sigma_m) - ndtr((least_m - behind_m) / sigma_m)
    recessed = np.log(np.maximum(within, 1e-6) / (most_m - least_m))
    return np.where(count > 0, recessed - in_face, 0.0)


def parse_face(
    ended: FloatArray,
    depth_sum: FloatArray,
    top: IntArray,
    driven: BoolArray,
    building: BuildingSettings,
    settings: ParseSettings,
) -> list[Stretch]:
    """The stretches of one face, from end to end.

    ended, depth_sum: (c, rows, …) rays by layer, see `Evidence`. top: (c,) rows up to the
    ceiling. driven: (c,) where the robot drove through. building: the sizes of doors.
    """
    columns, rows = len(ended), int(min(top.max(initial=0) + 1, ended.shape[1]))
    if not columns:
        return []
    own = ended[:, :rows], depth_sum[:, :rows]
    odds = material_odds(*own, top, building.recess_min_m, settings)
    sums = np.concatenate([np.zeros((1, rows, odds.shape[2])), np.cumsum(odds, axis=0)])
    count = ended[:, :rows, BEFORE + 1 :].sum(axis=-1)
    between = (np.arange(rows) >= FOOT_ROW) & (np.arange(rows) < top[:, None])
    seen = (count / (count + settings.rays_full) * between).sum(axis=1)
    hidden = -settings.hidden / settings.cells_together * seen
    grammar = _grammar(building, settings)
    found = _parse(sums, top.astype(np.int64), hidden, driven.astype(np.bool_), grammar)
    stretches = [
        Stretch(Kind(kind), first, after, sill, head, blind, odds_, Kind(second))
        for (first, after, kind, sill, head, blind, second), odds_ in zip(*found, strict=True)
    ]
    return _joined(stretches)


def _joined(stretches: list[Stretch]) -> list[Stretch]:
    """Stretches of one kind without sill and head, next to each other, as one."""
    joined: list[Stretch] = []
    for own in stretches:
        last = joined[-1] if joined else None
        if last is not None and last.kind == own.kind and own.kind <= Kind.HIDDEN:
            odds = last.odds + own.odds
            joined[-1] = replace(last, after=own.after, odds=odds)
        else:
            joined.append(own)
    return joined


_THING_ROWS, _BLIND_ROWS = 6, 4
"""Least height (rows) of an opening or of a thing that ends low, and of a blind."""
_LINTEL = 0.3
"""Least odds (nats) a column of wall above an opening against its going on."""
_CEILING = 10_000
"""A row higher than any ceiling: the band goes on up to that."""


class _Grammar(NamedTuple):
    """What kinds of stretches there are, but for the simple ones, for compiled code.

    materials: (k, 3) below the sill, up to the head, and above. limits: (k, 6) lowest and highest
    sill and head (rows), least and greatest width (columns). price: (k,) of each kind. change,
    to_ceiling: prices of an edge, and of glass up to the ceiling. knee: the row of usual sills.
    """

    materials: IntArray
    limits: IntArray
    price: FloatArray
    change: float
    to_ceiling: float
    knee: int


def _grammar(building: BuildingSettings, settings: ParseSettings) -> _Grammar:
    solid, away, anything = Material.SOLID, Material.AWAY, Material.ANYTHING
    foot, ceiling, all_m = (FOOT_ROW, FOOT_ROW), (_CEILING, _CEILING), _STRETCH_MAX * CELL_M
    width_m = building.door_width_min_m, building.door_width_max_m
    head = cells_in(building.door_height_min_m), cells_in(building.door_height_max_m)
    size = cells_in(settings.window_size_m)
    sill = cells_in(settings.window_sill_m[0]), cells_in(settings.window_sill_m[1])
    wide = settings.window_size_m, all_m
    any_sill, any_width = (_THING_ROWS, _CEILING - 1), (0.15, all_m)
    table = {
        Kind.DOORWAY: (anything, foot, head, width_m, settings.door),
        Kind.LEAF_RECESSED: (Material.LEAF_RECESSED, foot, head, width_m, settings.door),
        Kind.LEAF_DEEP: (Material.LEAF_DEEP, foot, head, width_m, settings.door),
        Kind.LEAF_FAR: (Material.LEAF_FAR, foot, head, width_m, settings.door),
        Kind.WINDOW: (anything, sill, (sill[0] + size, _CEILING - 1), wide, settings.opening),
        Kind.PANE: (anything, foot, (sill[1], _CEILING - 1), wide, settings.pane),
        Kind.LOW: (away, any_sill, ceiling, any_width, settings.opening),
        Kind.HANGING: (away, foot, (head[0], _CEILING - 1), any_width, _RARE),
    }
    materials = np.array([[solid, middle, solid] for middle, *_ in table.values()], np.int64)
    limits = np.array([(*s, *h, *map(cells_in, w)) for _, s, h, w, _ in table.values()], np.int64)
    prices = np.array([price for *_, price in table.values()])
    knee = cells_in(building.knee_m)
    return _Grammar(materials, limits, prices, settings.change, settings.pane, knee)


# For compiled code.
_WALL, _GAP, _DOORWAY, _WINDOW, _LOW, _HANGING = map(
    int, (Kind.WALL, Kind.GAP, Kind.DOORWAY, Kind.WINDOW, Kind.LOW, Kind.HANGING)
)
_SOLID, _ANYTHING, _SET_BACK, _BEHIND = map(
    int, (Material.SOLID, Material.ANYTHING, Material.SET_BACK, Material.BEHIND)
)


@numba.njit(cache=True, nogil=True)
def _fit(
    sums: FloatArray,
    first: int,
    after: int,
    limit: int,
    grammar: _Grammar,
    total: FloatArray,
    score: FloatArray,
    band: IntArray,
) -> None:  # pragma: no cover
    """Write the best odds of each kind by bands over some columns, and its sill and head.

    limit: rows up to the lowest ceiling of these. total: (m,) of materials, for the sums over all
    rows. score, band: (k,) odds and (k, 3) sill, head and blind.
    """
    columns, rows = after - first, sums.shape[1]
    below = np.zeros((min(limit, rows) + 1, sums.shape[2]))
    for row in range(len(below) - 1):
        for m in range(sums.shape[2]):
            below[row + 1, m] = below[row, m] + sums[after, row, m] - sums[first, row, m]
    for m in range(sums.shape[2]):
        total[m] = below[-1, m]
        for row in range(len(below) - 1, rows):
            total[m] += sums[after, row, m] - sums[first, row, m]
    top = len(below) - 1
    for k in range(len(grammar.materials)):
        kind, limits = k + _BY_BANDS, grammar.limits[k]
        score[k] = -np.inf
        if columns < limits[4] or columns > limits[5]:
            continue
        low, middle, high = grammar.materials[k]
        to_ceiling = limits[2] >= _CEILING
        best, sill = -np.inf, -1
        closed, closed_from, closed_sill = -np.inf, -1, -1
        last = top - 2 if limits[1] >= _CEILING - 1 else limits[1]
        for row in range(limits[0], top + 1):
            # A sill at this row, with the band between it and the head.
            if row <= min(last, top):
                start = below[row, low] - below[row, middle]
                if limits[0] == limits[1]:
                    start = 0.0
                elif kind == _WINDOW and row < grammar.knee:
                    start -= _LOW_SILL
                if start > best:
                    best, sill = start, row
            if sill < 0 or to_ceiling:
                continue
            if kind == _WINDOW:
                start = best + below[row, middle] - below[row, _SET_BACK] - _UNUSUAL
                # What hangs is higher than a frame, and than what the lintel's underside returns.
                if start > closed and row <= top - _BLIND_ROWS:
                    closed, closed_from, closed_sill = start, row, sill
            if row < limits[2] or row > limits[3] or row < sill + _THING_ROWS:
                continue
            above = total[high] - below[row, high]
            value = best + below[row, middle] + above
            with_blind = closed + below[row, _SET_BACK] + above
            if row >= closed_from + _BLIND_ROWS and with_blind > max(value, score[k]):
                score[k] = with_blind
                band[k, 0], band[k, 1], band[k, 2] = closed_sill, row, closed_from
                continue
            if kind <= _WINDOW:
                open_above = total[_ANYTHING] - below[row, _ANYTHING]
                if row > top - 3 or above - open_above < _LINTEL * columns:
                    value -= grammar.to_ceiling if kind == _WINDOW else _RARE
            elif kind == _HANGING and row > top - 2:  # hanging down from nothing
                continue
            if value > score[k]:
                score[k], band[k, 0], band[k, 1], band[k, 2] = value, sill, row, row
        if to_ceiling and sill >= 0:
            # Few things end so near the ceiling, or so high.
            high_end = _UNUSUAL if sill > min(top - 7, 45) else 0.0
            score[k] = best + total[middle] - high_end
            band[k, 0], band[k, 1], band[k, 2] = sill, top, top
        score[k] -= grammar.price[k]


@numba.njit(cache=True, nogil=True)
def _gains(sums: FloatArray) -> FloatArray:  # pragma: no cover
    """(c + 1,) by how much the likeliest materials of all cells beat a wall, summed over columns.

    No kind beats a wall by more over these columns.
    """
    gains = np.zeros(len(sums))
    for c in range(len(sums) - 1):
        gain = 0.0
        for row in range(sums.shape[1]):
            solid, most = sums[c + 1, row, 0] - sums[c, row, 0], -np.inf
            for m in range(sums.shape[2]):
                most = max(most, sums[c + 1, row, m] - sums[c, row, m])
            gain += most - solid
        gains[c + 1] = gains[c] + gain
    return gains


@numba.njit(cache=True, nogil=True)
def _is_down(kind: int) -> bool:  # pragma: no cover
    """Whether a kind is an opening down to the floor."""
    return _DOORWAY <= kind < _LOW and kind != _WINDOW


@numba.njit(cache=True, nogil=True)
def _parse(
    sums: FloatArray, top: IntArray, hidden: FloatArray, driven: BoolArray, grammar: _Grammar
) -> tuple[IntArray, FloatArray]:  # pragma: no cover
    """Stretches (n, 7): first, after, kind, sill, head, blind, second kind, and odds (n,).

    sums: (c + 1, rows, m) odds of each cell's materials, summed over columns.
    """
    bands = len(grammar.materials)
    columns, rows, kinds = len(sums) - 1, sums.shape[1], _BY_BANDS + bands
    value = np.full((columns + 1, kinds), -np.inf)
    begin, before = np.zeros((columns + 1, kinds), np.int64), np.full((columns + 1, kinds), -1)
    limits_of = np.zeros((columns + 1, kinds, 3), np.int64)
    # The best parse up to here, of those that end with no opening.
    closed, closed_kind = np.full(columns + 1, -np.inf), np.full(columns + 1, -1)
    best, best_kind = np.full(columns + 1, -np.inf), np.full(columns + 1, -1)
    closed[0], best[0] = 0.0, 0.0
    whole, gains = sums.sum(axis=1), _gains(sums)
    total, score, band = np.zeros(sums.shape[2]), np.zeros(bands), np.zeros((bands, 3), np.int64)
    for j in range(1, columns + 1):
        for k in range(_BY_BANDS):
            own = hidden[j - 1]
            if k == _WALL:
                own = whole[j, _SOLID] - whole[j - 1, _SOLID]
                own -= 1e6 if driven[j - 1] else 0.0
            elif k == _GAP:
                own = whole[j, _BEHIND] - whole[j - 1, _BEHIND]
            since = best[j - 1] if k == _WALL else closed[j - 1]
            enter = since - (0.0 if j == 1 else grammar.change)
            if value[j - 1, k] >= enter:
                value[j, k], begin[j, k], before[j, k] = value[j - 1, k] + own, j - 1, k
            else:
                value[j, k], begin[j, k] = enter + own, j - 1
                before[j, k] = best_kind[j - 1] if k == _WALL else closed_kind[j - 1]
        limit, crossed = rows, 0
        for i in range(j - 1, max(j - _STRETCH_MAX - 1, -1), -1):
            limit, crossed = min(limit, top[i]), crossed + int(driven[i])
            if j - i < 3 or (gains[j] - gains[i] < grammar.change and crossed == 0):
                continue
            _fit(sums, i, j, limit, grammar, total, score, band)
            for b in range(bands):
                k, own = _BY_BANDS + b, score[b]
                passable = k in (_DOORWAY, _HANGING)
                if own == -np.inf or (crossed > 0 and not passable):
                    continue
                is_opening = k < _LOW
                if is_opening:
                    since, last = value[i, _WALL] - grammar.change, _WALL
                    if i == 0:
                        since, last = -_OPEN_END, -1
                    if j == columns:
                        own -= _OPEN_END
                else:
                    since = closed[i] - (grammar.change if i > 0 else 0.0)
                    last = closed_kind[i]
                if i > 0 and k >= _WINDOW:
                    next_ = value[i, k] - (_CHAIN if is_opening else _NEXT_PIECE)
                    if next_ > since:
                        since, last = next_, k
                if since + own > value[j, k]:
                    value[j, k], begin[j, k], before[j, k] = since + own, i, last
                    limits_of[j, k] = band[b]
        for k in range(kinds):
            if value[j, k] > best[j]:
                best[j], best_kind[j] = value[j, k], k
            is_opening = _DOORWAY <= k < _LOW
            if not is_opening and value[j, k] > closed[j]:
                closed[j], closed_kind[j] = value[j, k], k
    found = np.zeros((columns, 7), np.int64)
    odds, count = np.zeros(columns), 0
    j, k = columns, best_kind[columns]
    while j > 0 and k >= 0:
        i, last = begin[j, k], before[j, k]
        while last == k and k < _BY_BANDS and i > 0:  # a run, column by column
            i, last = begin[i, k], before[i, k]
        _fit(sums, i, j, min(rows, top[i:j].min()), grammar, total, score, band)
        simple = total[_SOLID], total[_BEHIND], hidden[i:j].sum()
        every = np.concatenate((np.array(simple), score))
        most, second = -np.inf, _WALL
        for other in range(kinds):
            # A wall's openings are its own: what it competes with is what is no wall.
            own = k == _WALL and _DOORWAY <= other < _LOW
            # What closes an opening down to the floor is told later.
            own |= _is_down(k) and _is_down(other)
            if other != k and not own and every[other] > most:
                most, second = every[other], other
        found[count, :3] = i, j, k
        found[count, 3:6], found[count, 6] = limits_of[j, k], second
        odds[count] = every[k] - most
        count, j, k = count + 1, i, last
    return found[:count][::-1], odds[:count][::-1]
