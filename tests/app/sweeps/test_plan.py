"""Combinations that a sweep tries: all, some at random, or those that Optuna proposes."""

import pytest

from ffmap.app.setup.settings import Settings
from ffmap.app.sweeps.plan import (
    Combination,
    Parameter,
    Study,
    grid_of,
    overrides_of,
    parse_grid,
    random_of,
)
from ffmap.loaders.errors import InputError


def test_a_grid_is_every_combination_once() -> None:
    texts = ["building.door_width_max_m=2, 3.0", "doors.lines_min=2,3,2", "seed=0,1"]
    parameters = parse_grid(texts, False)
    # Values are as the settings hold them.
    assert parameters[0] == Parameter("building.door_width_max_m", (2.0, 3.0))
    assert all(isinstance(value, float) for value in parameters[0].values)
    found = grid_of(parameters)
    assert len(found) == len({tuple(c.items()) for c in found}) == 8
    assert found[0] == {"building.door_width_max_m": 2.0, "doors.lines_min": 2, "seed": 0}
    assert [c["seed"] for c in found[:3]] == [0, 1, 0]
    base = Settings(seed=5, smoothing={"returns": 9})
    assert overrides_of(base, found[-1]) == [
        "seed=1",
        "smoothing.returns=9",
        "doors.lines_min=3",
        "building.door_width_max_m=3.0",
    ]


@pytest.mark.parametrize(
    ("texts", "word"),
    [
        ([], "--grid"),
        (["wall_planes.similarity_m"], "step.name=value"),
        (["wall_planes.similarity_m="], "step.name=value"),
        (["wall_planes.similarity_m=0.02,"], "step.name=value"),
        (["=1"], "step.name=value"),
        (["wall_planes.similarty_m=0.02"], "wall_planes.similarity_m"),
        (["wall_planes.similarity_m=0.02,-1"], "similarity_m"),
        (["wall_planes.similarity_m=0.02,much"], "similarity_m"),
        (["wall_planes=1"], "wall_planes"),
        (["seed.x=1"], "seed"),
        (["doors.lines_min=2", "doors.lines_min=3"], "twice"),
        (["wall_planes.similarity_m=0.02..0.05"], "--random"),
        (["doors.lines_min=3..2"], "lower..higher"),
        (["doors.lines_min=1..2..3"], "lower..higher"),
        (["doors.lines_min=a..b"], "lines_min"),
        (["wall_planes.similarity_m=-0.5..0.5"], r"similarity_m = -0\.5"),
    ],
)
def test_mistakes_in_a_grid(texts: list[str], word: str) -> None:
    with pytest.raises(InputError, match=word) as error:
        parse_grid(texts, False)
    assert "\n" not in str(error.value)


def test_random_combinations_are_different_and_the_same_for_a_seed() -> None:
    parameters = parse_grid(["seed=0,1,2,3", "doors.lines_min=2..4"], True)
    found = random_of(parameters, 7, seed=5)
    assert len({tuple(c.items()) for c in found}) == 7
    assert found == random_of(parameters, 7, seed=5) != random_of(parameters, 7, seed=6)
    every = random_of(parameters, 99, seed=5)
    assert len(every) == 12
    assert {c["doors.lines_min"] for c in every} == {2, 3, 4}
    (length,) = parse_grid(["wall_planes.similarity_m=0.02..0.08"], True)
    values = [c["wall_planes.similarity_m"] for c in random_of([length], 60, seed=1)]
    assert len(values) == 60
    assert 0.02 <= min(values) < 0.03
    assert 0.07 < max(values) <= 0.08
    assert all(len(f"{value:g}") <= 7 for value in values)


@pytest.mark.parametrize(("objective", "best"), [("wall.f1", 2), ("seconds", 3)])
def test_optuna_learns_which_is_better_and_repeats_itself(objective: str, best: int) -> None:
    pytest.importorskip("optuna")
    parameters = parse_grid(["doors.lines_min=2,3", "doors.recess_min_m=0.01..0.03"], True)

    def proposed() -> list[Combination]:
        study, found = Study(parameters, 0, objective), []
        for batch in study.batches(40, 4):
            for trial, combination in batch:
                found.append(dict(combination))
                failed = len(found) % 10 == 0
                study.tell(trial, None if failed else float(-combination["doors.lines_min"]))
        return found

    found = proposed()
    assert len(found) == 40
    assert sum(combination["doors.lines_min"] == best for combination in found[20:]) > 10
    assert found == proposed()
