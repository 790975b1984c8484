"""Which combinations a sweep tries: all, some at random, or those that Optuna proposes; mistakes are told before it starts."""

import pytest

from ffmap.app.setup.settings import Settings
from ffmap.app.sweeps.plan import Choice, Range, Study, apply, grid_of, parse_grid, random_of
from ffmap.loaders.errors import InputError

BASE = Settings()


def test_a_grid_is_every_combination_once() -> None:
    parameters = parse_grid(
        ["wall_planes.similarity_m=0.02, 0.05", "doors.lines_min=2,3,2", "refinement.enabled=true,false"], BASE, False
    )
    found = grid_of(parameters)
    assert len(found) == len({tuple(c.items()) for c in found}) == 8
    assert found[0] == {"wall_planes.similarity_m": 0.02, "doors.lines_min": 2, "refinement.enabled": True}
    assert [c["refinement.enabled"] for c in found[:3]] == [True, False, True]
    settings = apply(BASE, found[-1])
    assert (settings.wall_planes.similarity_m, settings.doors.lines_min) == (0.05, 3)
    assert settings.building == BASE.building


def test_values_are_as_the_settings_hold_them() -> None:
    (parameter,) = parse_grid(["building.door_width_max_m=2,3.0"], BASE, False)
    assert parameter == Choice("building.door_width_max_m", (2.0, 3.0))
    assert all(isinstance(value, float) for value in parameter.values)


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
    ],
)
def test_mistakes_in_a_grid(texts: list[str], word: str) -> None:
    with pytest.raises(InputError, match=word) as error:
        parse_grid(texts, BASE, False)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["doors.lines_min=3..2", "doors.lines_min=a..b", "wall_planes.similarity_m=0.02..-1"])
def test_mistakes_in_a_range(text: str) -> None:
    with pytest.raises(InputError):
        parse_grid([text], BASE, True)
    with pytest.raises(InputError, match=r"similarity_m = -0\.5"):
        parse_grid(["wall_planes.similarity_m=-0.5..0.5"], BASE, True)


def test_random_combinations_are_different_and_the_same_for_a_seed() -> None:
    parameters = parse_grid(["seed=0,1,2,3", "doors.lines_min=2,3,4"], BASE, True)
    found = random_of(parameters, 7, seed=5)
    assert len({tuple(c.items()) for c in found}) == 7
    assert found == random_of(parameters, 7, seed=5) != random_of(parameters, 7, seed=6)
    assert len(random_of(parameters, 99, seed=5)) == 12


def test_ranges_are_drawn_from() -> None:
    parameters = parse_grid(["wall_planes.similarity_m=0.02..0.08", "doors.lines_min=2..4", "seed=7,8"], BASE, True)
    assert isinstance(parameters[0], Range)
    found = random_of(parameters, 60, seed=1)
    values = [c["wall_planes.similarity_m"] for c in found]
    assert len(found) == 60
    assert min(values) >= 0.02
    assert max(values) <= 0.08
    assert max(values) - min(values) > 0.04
    assert {c["doors.lines_min"] for c in found} == {2, 3, 4}
    assert all(isinstance(c["doors.lines_min"], int) for c in found)
    assert all(len(f"{value:g}") <= 7 for value in values)
    assert len(random_of(parameters[1:2], 9, seed=1)) == 3


def best_of(parameters, seed: int, objective: str, value_of) -> list[dict]:
    """The combinations that a study of 40 trials, four at once, proposes."""
    study = Study(parameters, seed, objective)
    proposed = []
    for batch in study.batches(40, 4):
        for trial, combination in batch:
            proposed.append(dict(combination))
            study.tell(trial, value_of(combination))
    return proposed


@pytest.mark.parametrize(("objective", "best"), [("wall_f1", 2), ("seconds", 3)])
def test_optuna_learns_which_is_better_and_repeats_itself(objective: str, best: int) -> None:
    pytest.importorskip("optuna")
    parameters = parse_grid(["doors.lines_min=2,3", "doors.recess_min_m=0.01..0.03"], BASE, True)

    def value_of(combination) -> float:
        return float(-combination["doors.lines_min"])

    proposed = best_of(parameters, 0, objective, value_of)
    assert len(proposed) == 40
    assert sum(combination["doors.lines_min"] == best for combination in proposed[20:]) > 10
    assert proposed == best_of(parameters, 0, objective, value_of)


def test_a_failed_trial_does_not_stop_the_study() -> None:
    pytest.importorskip("optuna")
    parameters = parse_grid(["doors.lines_min=2,3"], BASE, True)
    values = iter([None, 1.0] * 20)
    assert len(best_of(parameters, 0, "seconds", lambda _: next(values))) == 40
