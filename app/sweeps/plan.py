"""Which settings a sweep tries: every combination of a grid, some of them at random, or those that Optuna proposes."""

import itertools
import math
import warnings
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ffmap.app.folder.figures import less_is_better
from ffmap.app.own_command import pip_command
from ffmap.app.setup.settings import Settings, parse_value, validate
from ffmap.loaders.errors import InputError

Combination = Mapping[str, Any]
"""A value for each parameter, by the setting's dotted name."""

_DIGITS = 4
"""Number of digits of a value that is drawn from a range."""


@dataclass(frozen=True)
class Choice:
    """A setting that takes one of some values."""

    name: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Range:
    """A setting that takes any value from `low` to `high`, whole numbers only where both are."""

    name: str
    low: float
    high: float

    @property
    def whole(self) -> bool:
        return isinstance(self.low, int) and isinstance(self.high, int)


Parameter = Choice | Range


def parse_grid(texts: Sequence[str], base: Settings, ranges: bool) -> tuple[Parameter, ...]:
    """Parameters from texts like wall_planes.similarity_m=0.02,0.05 or ….similarity_m=0.02..0.08.

    base: the settings that stay. ranges: whether a range makes sense. Every value is validated.
    Raises InputError that says which of them is wrong, and how.
    """
    if not texts:
        raise InputError("--grid: nothing to sweep; give settings and their values, as in --grid doors.lines_min=2,3")
    parameters: dict[str, Parameter] = {}
    for text in texts:
        parameter = _parse(text, base)
        if parameter.name in parameters:
            raise InputError(f"--grid {text}: {parameter.name} is given twice; write all its values in one --grid")
        if isinstance(parameter, Range) and not ranges:
            raise InputError(f"--grid {text}: a range has no end of values; list some, or add --random N or --optuna N")
        parameters[parameter.name] = parameter
    return tuple(parameters.values())


def _parse(text: str, base: Settings) -> Parameter:
    name, equals, listed = (part.strip() for part in text.partition("="))
    parts = [part.strip() for part in listed.split(",")]
    if not equals or not name or not all(parts):
        raise InputError(f"--grid {text}: write it as step.name=value,value, as in wall_planes.similarity_m=0.02,0.05")
    low, dots, high = listed.partition("..")
    if dots and len(parts) == 1:
        ends = parse_value(low), parse_value(high)
        if not all(isinstance(end, int | float) and not isinstance(end, bool) for end in ends) or ends[0] >= ends[1]:
            raise InputError(
                f"--grid {text}: write a range as lower..higher, as in wall_planes.similarity_m=0.02..0.08"
            )
        for end in ends:
            apply(base, {name: end})
        return Range(name, *ends)
    # As the settings hold them: 1 for a length in metres is 1.0.
    values = tuple(dict.fromkeys(apply(base, {name: parse_value(part)}).flat().get(name) for part in parts))
    if None in values:
        raise InputError(
            f"--grid {text}: {name!r} is a step; name one of its settings, 'ffmap settings' lists them all"
        )
    return Choice(name, values)


def apply(base: Settings, combination: Combination) -> Settings:
    """The settings with a combination's values; raises InputError where one is not possible."""
    values = base.model_dump()
    for name, value in combination.items():
        *steps, last = name.split(".")
        target = values
        for step in steps:
            target = target.setdefault(step, {})
            if not isinstance(target, dict):
                raise InputError(f"--grid {name}: {step!r} is no step; 'ffmap settings' lists all settings")
        target[last] = value
    return validate(values, "--grid")


class Search(Protocol):
    """Where the combinations of a sweep come from. total: how many there will be."""

    total: int

    def next(self) -> Combination | None:
        """One more; None where there is none."""
        ...

    def tell(self, combination: Combination, value: float | None) -> None:
        """What the objective came to; None where its runs failed."""
        ...


class Listed:
    """A `Search` among combinations that are known beforehand."""

    def __init__(self, combinations: Sequence[Combination]) -> None:
        self.total = len(combinations)
        self._left = iter(combinations)

    def next(self) -> Combination | None:
        return next(self._left, None)

    def tell(self, combination: Combination, value: float | None) -> None:
        pass


def grid_of(parameters: Sequence[Parameter]) -> Listed:
    """Every combination, the last parameter changing fastest."""
    choices = [p.values for p in parameters if isinstance(p, Choice)]
    return Listed([_named(parameters, values) for values in itertools.product(*choices)])


def random_of(parameters: Sequence[Parameter], count: int, seed: int) -> Listed:
    """`count` different combinations, drawn evenly; all of them where there are no more."""
    rng = np.random.default_rng(seed)
    choices = [p.values for p in parameters if isinstance(p, Choice)]
    if len(choices) == len(parameters):
        sizes = list(map(len, choices))
        chosen = rng.choice(math.prod(sizes), min(count, math.prod(sizes)), replace=False)
        places = zip(*(axis.tolist() for axis in np.unravel_index(chosen, sizes)), strict=True)
        drawn = ([values[i] for values, i in zip(choices, place, strict=True)] for place in places)
        return Listed([_named(parameters, values) for values in drawn])
    different: dict[tuple[Any, ...], Combination] = {}
    # Whole numbers may run out of different ones.
    for _ in range(100 * count):
        values = [_draw(parameter, rng) for parameter in parameters]
        different.setdefault(tuple(values), _named(parameters, values))
        if len(different) == count:
            break
    return Listed(list(different.values()))


def _draw(parameter: Parameter, rng: np.random.Generator) -> Any:  # noqa: ANN401 - a setting's value
    if isinstance(parameter, Choice):
        return parameter.values[int(rng.integers(len(parameter.values)))]
    if parameter.whole:
        return int(rng.integers(int(parameter.low), int(parameter.high), endpoint=True))
    return _rounded(float(rng.uniform(parameter.low, parameter.high)))


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _named(parameters: Sequence[Parameter], values: Sequence[Any]) -> Combination:
    return dict(zip((p.name for p in parameters), values, strict=True))


class Study:
    """A `Search` by Optuna's TPE, which learns from the combinations before; kept in a file, and gone on with."""

    def __init__(self, parameters: Sequence[Parameter], count: int, seed: int, objective: str, path: Path) -> None:
        """path: a file that may hold studies of other objectives and parameters too.

        Raises InputError where Optuna is not installed.
        """
        try:
            import optuna  # noqa: TID251 - its one place
            from optuna.storages import JournalStorage  # noqa: TID251 - its one place
            from optuna.storages.journal import JournalFileBackend  # noqa: TID251 - its one place
        except ImportError:
            raise InputError(
                f"--optuna: Optuna is not installed; '{pip_command('optuna')}' installs it (in a checkout, pip install "
                "'.[optuna]' does too), or use --random N"
            ) from None
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            # A liar: runs side by side are told apart by supposing that those under way turn out badly.
            sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
            self._study = optuna.create_study(
                storage=JournalStorage(JournalFileBackend(str(path))),
                study_name=f"{objective} by {parameters}",
                sampler=sampler,
                direction="minimize" if less_is_better(objective) else "maximize",
                load_if_exists=True,
            )
        self.total = count
        self._parameters = parameters
        self._failed = optuna.trial.TrialState.FAIL
        # Those that a kill left, and those that are done, whose runs are there already.
        self._earlier = deque((trial.number, trial.params) for trial in self._study.get_trials()[:count])
        self._numbers: dict[tuple[Any, ...], list[int]] = {}
        self._asked = 0

    def next(self) -> Combination | None:
        if self._asked == self.total:
            return None
        self._asked += 1
        if self._earlier:
            number, values = self._earlier.popleft()
        else:
            trial = self._study.ask()
            number, values = trial.number, {p.name: _suggest(trial, p) for p in self._parameters}
        combination = {
            p.name: _rounded(values[p.name]) if isinstance(p, Range) and not p.whole else values[p.name]
            for p in self._parameters
        }
        self._numbers.setdefault(tuple(combination.values()), []).append(number)
        return combination

    def tell(self, combination: Combination, value: float | None) -> None:
        number = self._numbers[tuple(combination.values())].pop()
        state = self._failed if value is None else None
        self._study.tell(number, value, state=state, skip_if_finished=True)


def _suggest(trial: Any, parameter: Parameter) -> Any:  # noqa: ANN401 - optuna.Trial; a setting's value
    if isinstance(parameter, Choice):
        return trial.suggest_categorical(parameter.name, parameter.values)
    if parameter.whole:
        return trial.suggest_int(parameter.name, int(parameter.low), int(parameter.high))
    return trial.suggest_float(parameter.name, parameter.low, parameter.high)
