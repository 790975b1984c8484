"""Which combinations a sweep tries: all, some at random, or those that Optuna proposes; mistakes are told before it starts."""

from pathlib import Path

import pytest

from ffmap.app.setup.settings import Settings
from ffmap.app.sweeps.plan import Choice, Range, Study, apply, grid_of, parse_grid, random_of
from ffmap.loaders.errors import InputError

BASE = Settings()


def all_of(search) -> list[dict]:
    found = []
    while (combination := search.next()) is not None:
        found.append(dict(combination))
        search.tell(combination, 0.0)
    return found


def test_a_grid_is_every_combination_once() -> None:
    parameters = parse_grid(
        ["wall_planes.similarity_m=0.02, 0.05", "doors.lines_min=2,3,2", "refinement.enabled=true,false"], BASE, False
    )
    search = grid_of(parameters)
    found = all_of(search)
    assert search.total == len(found) == len({tuple(c.items()) for c in found}) == 8
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
    found = all_of(random_of(parameters, 7, seed=5))
    assert len({tuple(c.items()) for c in found}) == 7
    assert found == all_of(random_of(parameters, 7, seed=5)) != all_of(random_of(parameters, 7, seed=6))
    assert len(all_of(random_of(parameters, 99, seed=5))) == 12


def test_ranges_are_drawn_from() -> None:
    parameters = parse_grid(["wall_planes.similarity_m=0.02..0.08", "doors.lines_min=2..4", "seed=7,8"], BASE, True)
    assert isinstance(parameters[0], Range)
    found = all_of(random_of(parameters, 60, seed=1))
    values = [c["wall_planes.similarity_m"] for c in found]
    assert len(found) == 60
    assert min(values) >= 0.02
    assert max(values) <= 0.08
    assert max(values) - min(values) > 0.04
    assert {c["doors.lines_min"] for c in found} == {2, 3, 4}
    assert all(isinstance(c["doors.lines_min"], int) for c in found)
    assert all(len(f"{value:g}") <= 7 for value in values)
    assert len(all_of(random_of(parameters[1:2], 9, seed=1))) == 3


def test_optuna_learns_and_goes_on_where_it_was_killed(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    parameters = parse_grid(["wall_planes.similarity_m=0.01..0.1", "doors.lines_min=2,3"], BASE, True)

    def value_of(combination) -> float:
        return -abs(combination["wall_planes.similarity_m"] - 0.07) - combination["doors.lines_min"]

    study = Study(parameters, 30, 0, "wall_f1", tmp_path / "study")
    done = []
    for _ in range(20):
        combination = study.next()
        done.append(combination)
        study.tell(combination, value_of(combination))
    killed = study.next()
    again = Study(parameters, 30, 0, "wall_f1", tmp_path / "study")
    repeated = [again.next() for _ in range(21)]
    assert repeated == [*done, killed]
    for combination in repeated:
        again.tell(combination, value_of(combination))
    later = [again.next() for _ in range(9)]
    assert again.next() is None
    assert None not in later
    assert sum(c["doors.lines_min"] == 2 for c in later) > 5


def test_a_failed_trial_does_not_stop_the_study(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    parameters = parse_grid(["doors.lines_min=2,3"], BASE, True)
    study = Study(parameters, 2, 0, "seconds", tmp_path / "study")
    study.tell(study.next(), None)
    study.tell(study.next(), 1.0)
    assert study.next() is None


@pytest.mark.parametrize(("objective", "best"), [("wall_f1", 2), ("seconds", 3)])
def test_optuna_knows_what_is_better(objective: str, best: int, tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    parameters = parse_grid(["doors.lines_min=2,3", "doors.recess_min_m=0.01..0.03"], BASE, True)
    # A study of another objective in the same file has nothing to say.
    for other in ("wall_f1", "seconds"):
        Study(parameters, 1, 0, other, tmp_path / "study").next()
    study = Study(parameters, 40, 0, objective, tmp_path / "study")
    found = []
    for _ in range(40):
        found.append(study.next())
        study.tell(found[-1], float(-found[-1]["doors.lines_min"]))
    assert sum(combination["doors.lines_min"] == best for combination in found[20:]) > 10
