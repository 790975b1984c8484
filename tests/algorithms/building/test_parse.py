"""Faces drawn as rectangles of materials, with seeded noise, and what the parse finds in them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.building.evidence import BEYOND, FOOT_ROW, LAYERS_M, ON
from ffmap.algorithms.building.model import CELL_M, BuildingSettings
from ffmap.algorithms.building.parse import (
    SHARES,
    Kind,
    Material,
    ParseSettings,
    Stretch,
    material_odds,
    parse_face,
)

SIZES, SETTINGS = BuildingSettings(), ParseSettings()
COLUMNS, CEILING, ROWS = 80, 54, 64
"""A face of 4 m in a room of 2.7 m, and rows of cells in all."""
NOISE_M = 0.015

Mixture = tuple[tuple[float, float, float], ...]
"""Where rays end: shares of them, each evenly between two distances before the face (m)."""
SOLID: Mixture = ((0.985, 0.0, 0.0), (0.015, -9.0, -1.5))
AIR: Mixture = ((0.02, -0.12, -0.03), (0.09, -0.35, -0.12), (0.17, -1.0, -0.35), (0.72, -9.0, -1.5))
EMPTY: Mixture = ((1.0, -9.0, -2.0),)
RECESSED: Mixture = ((0.98, -0.03, -0.03), (0.02, -9.0, -1.5))
DEEPER: Mixture = ((0.98, -0.08, -0.08), (0.02, -9.0, -1.5))
DEEP: Mixture = ((0.98, -0.2, -0.2), (0.02, -9.0, -1.5))
FAR: Mixture = ((0.98, -0.6, -0.6), (0.02, -9.0, -1.5))
BEFORE: Mixture = ((0.92, 0.07, 0.07), (0.08, -9.0, -1.5))
"""A leaf hung before a doorway; what passes it goes far."""
GLASS: Mixture = ((0.1, -0.1, -0.1), (0.9, -9.0, -1.5))
UNSEEN: Mixture = ()


@dataclass(frozen=True)
class Patch:
    """A rectangle of one material: first column, the one after the last, and the same of rows."""

    material: Mixture
    first: int
    after: int
    bottom: int = 0
    top: int = CEILING


@dataclass(frozen=True)
class Face:
    """What rays found of a face, and its ceiling; see `parse_face`."""

    ended: FloatArray
    depth_sum: FloatArray
    top: IntArray
    driven: BoolArray

    def parse(self) -> list[Stretch]:
        return parse_face(self.ended, self.depth_sum, self.top, self.driven, SIZES, SETTINGS)

    def odds(self, settings: ParseSettings = SETTINGS) -> FloatArray:
        return material_odds(self.ended, self.depth_sum, self.top, SIZES.recess_min_m, settings)

    def where(self, known: BoolArray) -> "Face":
        """The same, of which only some cells (columns, rows) were seen."""
        kept = known[..., None]
        return replace(self, ended=self.ended * kept, depth_sum=self.depth_sum * kept)

    def mirrored(self) -> "Face":
        arrays = self.ended, self.depth_sum, self.top, self.driven
        return Face(*(array[::-1] for array in arrays))

    def add(self, more: "Face") -> "Face":
        ended, depth_sum = self.ended + more.ended, self.depth_sum + more.depth_sum
        return replace(self, ended=ended, depth_sum=depth_sum)

    def drive(self, first: int, after: int) -> "Face":
        driven = self.driven.copy()
        driven[first:after] = True
        return replace(self, driven=driven)


def draw(
    *patches: Patch,
    columns: int = COLUMNS,
    ceiling: int = CEILING,
    rays: float = 8.0,
    seed: int = 0,
    noise_m: float = NOISE_M,
) -> Face:
    """A wall with patches, the later ones before the earlier; about `rays` rays cross each cell."""
    generator = np.random.default_rng(seed)
    ended = np.zeros((columns, ROWS, BEYOND + 1), np.float32)
    depth_sum = np.zeros((columns, ROWS, BEYOND), np.float32)
    left = np.zeros((columns, ROWS), bool)
    left[:, :ceiling] = True
    for patch in [*patches[::-1], Patch(SOLID, 0, columns)]:
        here = np.zeros_like(left)
        here[patch.first : patch.after, patch.bottom : patch.top] = True
        here &= left
        left &= ~here
        if patch.material:
            book(np.argwhere(here), patch.material, rays, noise_m, generator, ended, depth_sum)
    none = np.zeros(columns, bool)
    return Face(ended, depth_sum, np.full(columns, ceiling), none)


def book(
    cells: IntArray,
    material: Mixture,
    rays: float,
    noise_m: float,
    generator: np.random.Generator,
    ended: FloatArray,
    depth_sum: FloatArray,
) -> None:
    """Let rays through cells (n, 2) end in a material."""
    shares, near_m, far_m = np.array(material).T
    cells = np.repeat(cells, generator.poisson(rays, len(cells)), axis=0)
    part = generator.choice(len(shares), len(cells), p=shares / shares.sum())
    before_m = generator.uniform(near_m[part], far_m[part])
    before_m += generator.normal(0, noise_m, len(cells))
    cells, before_m = cells[before_m <= LAYERS_M[0]], before_m[before_m <= LAYERS_M[0]]
    layer = np.searchsorted(-np.array(LAYERS_M), -before_m, "right") - 1
    np.add.at(ended, (*cells.T, layer), 1.0)
    in_layer = layer < BEYOND
    np.add.at(depth_sum, (*cells[in_layer].T, layer[in_layer]), before_m[in_layer])


def doorway(first: int, after: int, material: Mixture = AIR, head: int = 42) -> Patch:
    return Patch(material, first, after, 0, head)


def window(first: int, after: int, sill: int = 18, head: int = 44) -> Patch:
    return Patch(AIR, first, after, sill, head)


def only(stretches: list[Stretch], *kinds: Kind) -> list[Stretch]:
    return [own for own in stretches if own.kind in kinds]


def kinds_of(stretches: list[Stretch]) -> list[Kind]:
    return [own.kind for own in stretches]


def assert_spans(own: Stretch, first: int, after: int, columns: int = 1) -> None:
    assert abs(own.first - first) <= columns, own
    assert abs(own.after - after) <= columns, own


def assert_covers(stretches: list[Stretch], columns: int) -> None:
    """Stretches follow each other from end to end."""
    edges = [0, *(own.after for own in stretches)]
    assert [own.first for own in stretches] == edges[:-1]
    assert edges[-1] == columns
    assert all(own.first < own.after for own in stretches)


WALL, DOORWAY, WINDOW = Kind.WALL, Kind.DOORWAY, Kind.WINDOW
LEAF_KINDS = Kind.LEAF_RECESSED, Kind.LEAF_DEEP, Kind.LEAF_FAR
LEAVES = (
    (RECESSED, Kind.LEAF_RECESSED),
    (DEEPER, Kind.LEAF_RECESSED),
    (DEEP, Kind.LEAF_DEEP),
    (FAR, Kind.LEAF_FAR),
)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("width", [13, 18, 36, 50])
@pytest.mark.parametrize("head", [39, 42, 48])
def test_a_doorway_has_jambs_and_a_head(width: int, head: int, seed: int) -> None:
    stretches = draw(doorway(15, 15 + width, head=head), seed=seed).parse()
    assert kinds_of(stretches) == [WALL, DOORWAY, WALL]
    assert_spans(stretches[1], 15, 15 + width)
    assert abs(stretches[1].head - head) <= 1
    assert stretches[1].sill == FOOT_ROW
    assert all(own.odds > 0 for own in stretches)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("material", "kind"), LEAVES)
def test_a_leaf_is_told_by_its_depth(material: Mixture, kind: Kind, seed: int) -> None:
    stretches = draw(doorway(30, 48, material), seed=seed).parse()
    assert kinds_of(stretches) == [WALL, kind, WALL]
    assert_spans(stretches[1], 30, 48)
    assert abs(stretches[1].head - 42) <= 1
    assert stretches[1].odds > 0


@pytest.mark.parametrize("seed", range(3))
def test_a_window_has_a_sill_and_a_head(seed: int) -> None:
    stretches = draw(window(20, 50), seed=seed).parse()
    assert kinds_of(stretches) == [WALL, WINDOW, WALL]
    own = stretches[1]
    assert_spans(own, 20, 50)
    assert abs(own.sill - 18) <= 1
    assert abs(own.head - 44) <= 1
    assert own.blind == own.head


@pytest.mark.parametrize("material", [RECESSED, DEEPER, DEEP])
def test_a_blind_closes_the_upper_part_of_a_window(material: Mixture) -> None:
    own = draw(window(20, 50), Patch(material, 20, 50, 31, 44)).parse()[1]
    assert own.kind == WINDOW
    assert_spans(own, 20, 50)
    assert abs(own.sill - 18) <= 1
    assert abs(own.blind - 31) <= 1
    assert abs(own.head - 44) <= 1


def test_windows_follow_each_other_between_mullions() -> None:
    panes = [window(5 + 22 * k, 25 + 22 * k) for k in range(3)]
    found = only(draw(*panes).parse(), WINDOW)
    assert [round(own.head / 44) for own in found] == [1] * len(found)
    assert_spans(replace(found[0], after=found[-1].after), 5, 69)


@pytest.mark.parametrize("head", [46, 50])
def test_a_pane_from_the_floor_is_wider_than_doors_are(head: int) -> None:
    stretches = draw(doorway(10, 70, GLASS, head)).parse()
    assert kinds_of(stretches) == [WALL, Kind.PANE, WALL]
    assert_spans(stretches[1], 10, 70)
    assert abs(stretches[1].head - head) <= 1


@pytest.mark.parametrize(
    ("height", "behind"),
    [
        (16, AIR),
        (30, AIR),
        (30, FAR),
        (40, FAR),
        (16, EMPTY),
        (30, EMPTY),
        (40, EMPTY),
        (40, AIR),
    ],
)
def test_a_low_cupboard_has_air_above_it(height: int, behind: Mixture) -> None:
    stretches = draw(Patch(behind, 20, 50, height)).parse()
    assert kinds_of(stretches) == [WALL, Kind.LOW, WALL]
    assert_spans(stretches[1], 20, 50)
    assert abs(stretches[1].sill - height) <= 1


def test_a_face_that_is_low_all_along_is_no_wall() -> None:
    for columns in (10, 40, 79, 81, 200):
        (own,) = draw(Patch(AIR, 0, columns, 26), columns=columns).parse()[:1]
        assert own.kind == Kind.LOW


def test_a_duct_hangs_where_the_robot_drove_below_it() -> None:
    for first, after in ((10, 80), (0, 79)):
        wide = Patch(AIR, first, after, 0, 44)
        stretches = draw(wide, columns=90).drive(first + 20, after - 10).parse()
        own = only(stretches, Kind.HANGING)[0]
        assert set(kinds_of(stretches)) == {WALL, Kind.HANGING}
        assert_spans(own, first, after)
        assert abs(own.head - 44) <= 1


@pytest.mark.parametrize("behind", [AIR, EMPTY, RECESSED, DEEPER, DEEP, FAR])
@pytest.mark.parametrize("at_start", [False, True])
def test_a_face_ends_where_rays_pass_up_to_the_ceiling(at_start: bool, behind: Mixture) -> None:
    face = draw(Patch(behind, 55, COLUMNS))
    stretches = face.mirrored().parse()[::-1] if at_start else face.parse()
    assert kinds_of(stretches) == [WALL, Kind.GAP]
    wall = stretches[0]
    assert abs(wall.after - wall.first - 55) <= 1


def test_few_rays_that_contradict_each_other_are_no_wall() -> None:
    wall, mixed = draw(rays=3), draw(Patch(AIR, 30, 50), rays=3)
    either = np.random.default_rng(1).random((COLUMNS, ROWS)) < 0.5
    stretches = wall.where(either).add(mixed.where(~either)).parse()
    assert kinds_of(stretches)[1] in (Kind.HIDDEN, Kind.GAP)
    assert kinds_of(stretches)[::2] == [WALL, WALL]
    assert_spans(stretches[1], 30, 50)


@pytest.mark.parametrize("hidden", [slice(20, 60), slice(0, None, 2), slice(5, None)])
def test_what_nobody_saw_of_a_wall_is_wall(hidden: slice) -> None:
    known = np.ones((COLUMNS, ROWS), bool)
    known[hidden] = False
    (own,) = draw().where(known).parse()
    assert own.kind == WALL
    assert own.odds > 0


def test_a_doorway_is_found_beside_a_wall_that_nobody_saw() -> None:
    known = np.ones((COLUMNS, ROWS), bool)
    known[:20] = known[44:] = False
    stretches = draw(doorway(24, 40)).where(known).parse()
    assert kinds_of(stretches) == [WALL, DOORWAY, WALL]
    assert_spans(stretches[1], 24, 40)


@pytest.mark.parametrize("seed", range(5))
def test_two_rays_a_cell_are_enough(seed: int) -> None:
    face = draw(doorway(10, 28), window(40, 66), rays=2, seed=seed)
    stretches = face.parse()
    assert kinds_of(stretches) == [WALL, DOORWAY, WALL, WINDOW, WALL]
    assert_spans(stretches[1], 10, 28)
    assert_spans(stretches[3], 40, 66)
    (wall,) = draw(rays=2, seed=seed).parse()
    assert wall.kind == WALL


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("material", "kind"), LEAVES)
def test_two_rays_a_cell_tell_leaves(material: Mixture, kind: Kind, seed: int) -> None:
    stretches = draw(doorway(30, 48, material), rays=2, seed=seed).parse()
    assert kinds_of(stretches) == [WALL, kind, WALL]
    assert_spans(stretches[1], 30, 48)


def test_a_wall_seen_up_to_half_its_height_is_wall() -> None:
    low = np.zeros((COLUMNS, ROWS), bool)
    low[:, : CEILING // 2] = True
    (wall,) = draw().where(low).parse()
    assert wall.kind == WALL
    # Of an opening in it nobody saw a head: it may be a gap, and is no door.
    stretches = draw(doorway(30, 48)).where(low).parse()
    assert stretches[0].kind == stretches[-1].kind == WALL
    assert not only(stretches, DOORWAY)
    (wall,) = draw().where(~low).parse()
    assert wall.kind == WALL


@pytest.mark.parametrize("pier", [3, 6, 12])
def test_two_doors_are_parted_by_a_pier(pier: int) -> None:
    second = 28 + pier
    stretches = draw(doorway(10, 28), doorway(second, second + 18, RECESSED)).parse()
    assert kinds_of(stretches) == [WALL, DOORWAY, WALL, Kind.LEAF_RECESSED, WALL]
    assert_spans(stretches[1], 10, 28)
    assert_spans(stretches[3], second, second + 18)


def test_no_wall_is_where_the_robot_drove() -> None:
    # Nobody saw the doorway's lintel: it would be none by itself.
    known = np.ones((COLUMNS, ROWS), bool)
    known[28:50, 40:] = False
    seen = draw(doorway(30, 48)).where(known)
    assert not only(seen.parse(), DOORWAY)
    stretches = seen.drive(36, 42).parse()
    assert all(own.kind != WALL for own in stretches if own.first < 42 and own.after > 36)
    stretches = draw(doorway(30, 48)).drive(36, 42).parse()
    assert kinds_of(stretches) == [WALL, DOORWAY, WALL]
    # Closed when it was seen, open when the robot came; and never seen.
    for material in (SOLID, RECESSED, UNSEEN):
        stretches = draw(doorway(30, 48, material)).drive(36, 42).parse()
        assert_covers(stretches, COLUMNS)
        assert not only(stretches, Kind.LEAF_RECESSED)
        assert all(own.kind != WALL for own in stretches if own.first < 42 and own.after > 36)


def test_an_opening_at_the_end_of_a_face_needs_no_jamb_there() -> None:
    for face in (draw(doorway(0, 18)).mirrored(), draw(doorway(62, 80))):
        stretches = face.parse()
        assert kinds_of(stretches) == [WALL, DOORWAY]
        assert_spans(stretches[1], 62, 80)


def test_one_ceiling_may_be_lower_than_another() -> None:
    face = draw(doorway(50, 68, head=40))
    top = np.where(np.arange(COLUMNS) < 40, CEILING, 46)
    known = np.arange(ROWS) < top[:, None]
    stretches = replace(face.where(known), top=top).parse()
    assert kinds_of(stretches) == [WALL, DOORWAY, WALL]
    assert_spans(stretches[1], 50, 68)


def test_no_face_has_no_stretches() -> None:
    assert draw(columns=0).parse() == []
    (own,) = draw(Patch(UNSEEN, 0, COLUMNS)).parse()
    assert (own.kind, own.first, own.after, own.odds) == (WALL, 0, COLUMNS, 0.0)


@pytest.mark.parametrize("ceiling", [0, 1, FOOT_ROW, 5, 12, 30, 35])
def test_a_face_lower_than_a_door_has_none(ceiling: int) -> None:
    for columns in (1, 2, 3, COLUMNS):
        hole = doorway(columns // 3, columns // 2, head=ceiling)
        for face in (draw(columns=columns, ceiling=ceiling), draw(hole, columns=columns)):
            low = replace(face, top=np.full(columns, ceiling))
            stretches = low.parse()
            assert_covers(stretches, columns)
            assert set(kinds_of(stretches)) <= {WALL, Kind.GAP, Kind.LOW, WINDOW}
    (own,) = draw(ceiling=ceiling).parse()
    assert own.kind == WALL


MATERIALS = [SOLID, AIR, EMPTY, RECESSED, DEEPER, DEEP, FAR, BEFORE, GLASS, UNSEEN]


@st.composite
def faces(draw_: st.DrawFn, rays_min: float = 0.5) -> Face:
    """Faces of any rectangles of any materials, seen well or badly."""
    columns = draw_(st.integers(1, 120))
    patch = st.tuples(
        st.sampled_from(MATERIALS),
        st.tuples(st.integers(0, columns), st.integers(0, columns)).map(sorted),
        st.tuples(st.integers(0, ROWS), st.integers(0, ROWS)).map(sorted),
    )
    patches = [Patch(m, *c, *r) for m, c, r in draw_(st.lists(patch, max_size=5))]
    rays = draw_(st.floats(rays_min, 30.0))
    ceiling = draw_(st.integers(0, ROWS))
    drawn = draw(*patches, columns=columns, ceiling=ceiling, rays=rays, seed=draw_(st.integers(0)))
    first, after = draw_(st.tuples(st.integers(0, columns), st.integers(0, columns)).map(sorted))
    return drawn.drive(first, after) if draw_(st.booleans()) else drawn


@given(faces())
def test_stretches_cover_each_face_once(face: Face) -> None:
    stretches = face.parse()
    assert_covers(stretches, len(face.top))
    for own in stretches:
        assert np.isfinite(own.odds)
        if own.kind >= DOORWAY:
            assert FOOT_ROW <= own.sill <= own.blind <= own.head <= face.top[own.columns].min()
        if own.kind in (DOORWAY, *LEAF_KINDS):
            assert own.width_m - SIZES.door_width_min_m >= -1e-9
            assert own.width_m <= SIZES.door_width_max_m + 1e-9
            lowest, highest = SIZES.door_height_min_m, SIZES.door_height_max_m
            assert lowest / CELL_M - 1e-9 <= own.head <= highest / CELL_M + 1e-9
        if own.kind in (WALL, *LEAF_KINDS):
            assert not face.driven[own.columns].any()


EVERYTHING = (doorway(8, 26), window(34, 60), doorway(66, 84, RECESSED), Patch(AIR, 96, 130, 40))


@pytest.mark.parametrize("seed", range(4))
def test_a_mirrored_face_has_mirrored_stretches(seed: int) -> None:
    face = draw(*EVERYTHING, Patch(AIR, 140, 170), columns=170, seed=seed)
    forth, back = face.parse(), face.mirrored().parse()[::-1]
    found = [DOORWAY, WINDOW, Kind.LEAF_RECESSED, Kind.LOW, Kind.GAP]
    assert kinds_of(forth) == [kind for own in found for kind in (WALL, own)]
    assert kinds_of(forth) == kinds_of(back)
    for own, other in zip(forth, back, strict=True):
        assert (170 - other.after, 170 - other.first) == (own.first, own.after)
        assert (other.sill, other.head, other.blind) == (own.sill, own.head, own.blind)
        assert other.odds == pytest.approx(own.odds, abs=1e-6)


@pytest.mark.parametrize("patches", [*((p,) for p in EVERYTHING), (window(20, 50),), ()])
def test_rays_that_agree_never_lower_the_odds(patches: tuple[Patch, ...]) -> None:
    columns, last = 140, [0.0]
    exact = draw(*patches, columns=columns, rays=300, noise_m=0.003)
    for rays in (1, 2, 4, 8, 32, 300):
        part = exact.ended / exact.ended.sum(axis=-1, keepdims=True).clip(1.0) * rays
        depth_sum = exact.depth_sum * rays / exact.ended.sum(axis=-1, keepdims=True).clip(1.0)
        stretches = replace(exact, ended=part, depth_sum=depth_sum).parse()
        odds = [own.odds for own in stretches]
        if len(odds) == len(last):
            assert all(now >= before for now, before in zip(odds, last, strict=True))
        assert min(odds) > 0
        last = odds


def pure(material: Mixture, rays: int = 400, noise_m: float = 0.002) -> FloatArray:
    """Mean odds (8,) of cells of one material."""
    face = draw(Patch(material, 0, 9), columns=9, rays=rays, noise_m=noise_m)
    return face.odds()[:, FOOT_ROW:CEILING].mean(axis=(0, 1))


@pytest.mark.parametrize(
    ("material", "wanted"),
    [
        (SOLID, Material.SOLID),
        (AIR, Material.AIR),
        (EMPTY, Material.AIR),
        (RECESSED, Material.LEAF_RECESSED),
        (DEEPER, Material.LEAF_RECESSED),
        (DEEP, Material.LEAF_DEEP),
        (FAR, Material.LEAF_FAR),
    ],
)
def test_cells_are_likeliest_of_what_they_were_drawn_of(material: Mixture, wanted: int) -> None:
    odds = pure(material)
    own, least = odds[: len(SHARES)], -SETTINGS.odds_max / SETTINGS.cells_together
    assert own.argmax() == wanted
    assert own[wanted] == pytest.approx(0.0, abs=1e-3)
    assert (np.delete(own, wanted) < -0.1).all()
    assert (odds <= 0.0).all()
    assert (odds >= least - 1e-9).all()
    set_back = own[[Material.LEAF_RECESSED, Material.LEAF_DEEP]].max()  # blinds hang no deeper
    assert odds[Material.SET_BACK] == pytest.approx(set_back, abs=1e-3)
    if wanted != Material.SOLID:
        assert odds[Material.ANYTHING] > -0.8 / SETTINGS.cells_together - 1e-9
    else:
        assert odds[Material.ANYTHING] < -0.5


def test_the_mean_depth_tells_what_is_recessed() -> None:
    for behind_m in (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1):
        own = pure(((1.0, -behind_m, -behind_m),), rays=12, noise_m=NOISE_M)
        recessed = own[Material.LEAF_RECESSED] > own[Material.SOLID]
        assert recessed == (behind_m > 0.012), behind_m


OF_OPENINGS = slice(Material.LEAF_RECESSED, Material.SET_BACK + 1)


def test_what_ends_before_the_face_says_nothing_of_the_wall() -> None:
    face = draw(Patch(((1.0, 0.07, 0.07),), 0, 9), columns=9, noise_m=0.0)
    assert not face.ended[..., ON:].any()
    assert not np.delete(face.odds(), OF_OPENINGS, axis=-1).any()
    wall = draw(columns=9)
    np.testing.assert_allclose(wall.add(face).odds(), wall.odds())


def test_cells_that_nobody_saw_say_nothing() -> None:
    odds = draw(Patch(UNSEEN, 20, 40), Patch(AIR, 50, 60)).odds()
    assert odds.shape == (COLUMNS, ROWS, len(Material))
    unseen = odds[20:40, FOOT_ROW:CEILING]
    assert not np.delete(unseen, OF_OPENINGS, axis=-1).any()
    # But they are rather wall than an opening in it.
    assert np.all((unseen[..., OF_OPENINGS] < 0.0) & (unseen[..., OF_OPENINGS] > -0.05))
    assert not odds[:, :FOOT_ROW].any()
    assert not odds[:, CEILING:].any()
    low = replace(draw(), top=np.arange(COLUMNS))
    assert not low.odds()[np.arange(ROWS) >= low.top[:, None]].any()


def test_odds_together_are_as_many_cells_as_err_together() -> None:
    face = draw(*EVERYTHING, columns=140)
    alone = face.odds(SETTINGS.model_copy(update={"cells_together": 1.0}))
    np.testing.assert_allclose(face.odds(), alone / SETTINGS.cells_together)
    assert alone.min() == -SETTINGS.odds_max


@given(faces())
def test_odds_are_finite_and_never_above_zero(face: Face) -> None:
    odds = face.odds()
    assert np.isfinite(odds).all()
    assert (odds <= 0.0).all()
    assert (odds[..., : len(SHARES)].max(axis=-1) == 0.0).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_doorway_ends_where_nobody_saw_what_is_below(seed: int) -> None:
    """Behind furniture a wall goes on up to the face's end, though only its upper part shows."""
    hidden = Patch(UNSEEN, 26, 44, 0, 42)
    stretches = draw(doorway(8, 26), hidden, columns=44, seed=seed).parse()
    assert kinds_of(stretches) == [WALL, DOORWAY, WALL]
    assert abs(stretches[1].after - 26) <= 1
