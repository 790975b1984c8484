"""Combinations of settings that a sweep tries: all of a grid, drawn at random or by Optuna."""

import itertools
import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffmap.app.analysis.figures import FIGURES
from ffmap.app.own_command import pip_command
from ffmap.app.setup.settings import Settings, load_settings
from ffmap.loaders.errors import InputError

Combination = Mapping[str, Any]
"""A value for each parameter, by the setting's dotted name."""


@dataclass(frozen=True)
class Parameter:
    """A setting and its `values`, or the ends of a range; in a range of integers, only integers."""

    name: str
    values: tuple[Any, ...]
    is_range: bool = False


def parse_grid(texts: Sequence[str], ranges: bool) -> tuple[Parameter, ...]:
    """Parse texts like doors.lines_min=2,3 or wall_planes.similarity_m=0.02..0.08.

    ranges: whether a range may be given. Raises InputError that names the wrong text.
    """
    if not texts:
        raise InputError("--grid: nothing to sweep; give values, as in --grid doors.lines_min=2,3")
    parameters = tuple(_parse(text, ranges) for text in texts)
    names = [parameter.name for parameter in parameters]
    if len(set(names)) < len(names):
        twice = max(names, key=names.count)
        raise InputError(f"--grid {twice}: is given twice; write all values in one --grid")
    return parameters


def _parse(text: str, ranges: bool) -> Parameter:
    name, equals, listed = (part.strip() for part in text.partition("="))
    is_range = ".." in listed and "," not in listed
    parts = [part.strip() for part in listed.split(".." if is_range else ",")]
    if not equals or not name or not all(parts):
        raise InputError(
            f"--grid {text}: write it as step.name=value,value, as in doors.lines_min=2,3"
        )
    # Values as the settings hold them: 1 for a length in metres is 1.0.
    values: list[Any] = [load_settings(None, [f"{name}={p}"]).flat().get(name) for p in parts]
    if None in values:
        raise InputError(f"--grid {text}: {name!r} is a step; 'ffmap settings' lists all settings")
    if not is_range:
        return Parameter(name, tuple(dict.fromkeys(values)))
    numbers = all(isinstance(value, int | float) for value in values)
    if len(values) != 2 or not numbers or values[0] >= values[1]:
        raise InputError(f"--grid {text}: write a range as lower..higher, as in 0.02..0.08")
    if not ranges:
        raise InputError(f"--grid {text}: a range needs --random N or --optuna N; or list values")
    return Parameter(name, tuple(values), is_range=True)


def overrides_of(base: Settings, combination: Combination) -> list[str]:
    """Return what differs from the default settings with a combination's values, as for --set."""
    defaults = Settings().flat()
    return [
        f"{name}={json.dumps(value)}"
        for name, value in {**base.flat(), **combination}.items()
        if value != defaults[name]
    ]


def grid_of(parameters: Sequence[Parameter]) -> list[Combination]:
    """Return every combination; the last parameter changes fastest."""
    names = [parameter.name for parameter in parameters]
    combinations = itertools.product(*(parameter.values for parameter in parameters))
    return [dict(zip(names, values, strict=True)) for values in combinations]


def random_of(parameters: Sequence[Parameter], count: int, seed: int) -> list[Combination]:
    """Draw `count` different combinations; all of them if there are fewer."""
    generator, different = np.random.default_rng(seed), dict[tuple[Any, ...], Combination]()
    for _ in range(100 * count):  # values and integers may run out of combinations
        combination = suggest(_RandomTrial(generator), parameters)
        different.setdefault(tuple(combination.values()), combination)
        if len(different) == count:
            break
    return list(different.values())


@dataclass(frozen=True)
class _RandomTrial:
    """Draws values as a trial of Optuna's suggests them."""

    generator: np.random.Generator

    def suggest_categorical(self, _: str, values: Sequence[Any]) -> Any:  # noqa: ANN401
        return values[int(self.generator.integers(len(values)))]

    def suggest_int(self, _: str, low: int, high: int) -> int:
        return int(self.generator.integers(low, high, endpoint=True))

    def suggest_float(self, _: str, low: float, high: float) -> float:
        return float(self.generator.uniform(low, high))


def suggest(trial: Any, parameters: Sequence[Parameter]) -> Combination:  # noqa: ANN401
    """Return the combination that a trial, of Optuna's or random, suggests."""
    combination: dict[str, Any] = {}
    for parameter in parameters:
        name, low, high = parameter.name, parameter.values[0], parameter.values[-1]
        if not parameter.is_range:
            combination[name] = trial.suggest_categorical(name, parameter.values)
        elif isinstance(low, int):
            combination[name] = trial.suggest_int(name, low, high)
        else:  # four significant digits
            combination[name] = float(f"{trial.suggest_float(name, low, high):.4g}")
    return combination


class Study:
    """Combinations that Optuna's TPE sampler proposes; the same for the same seed and results."""

    def __init__(self, parameters: Sequence[Parameter], seed: int, objective: str) -> None:
        """Raises InputError if Optuna is not installed."""
        try:
            import optuna  # noqa: TID251 - its one place
        except ImportError:
            raise InputError(
                f"--optuna: Optuna is not installed; '{pip_command('optuna')}' installs it (in a "
                "checkout, pip install '.[optuna]'), or use --random N"
            ) from None
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            # The constant liar keeps the trials of one batch apart.
            sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
        directions = optuna.study.StudyDirection
        higher = FIGURES[objective].better == "higher"
        direction = directions.MAXIMIZE if higher else directions.MINIMIZE
        self._study = optuna.create_study(sampler=sampler, direction=direction)
        self._parameters = parameters
        self._failed = optuna.trial.TrialState.FAIL

    def batches(self, count: int, size: int) -> Iterator[list[tuple[Any, Combination]]]:
        """Yield trials with their combinations; each batch needs its results before the next."""
        for first in range(0, count, size):
            trials = [self._study.ask() for _ in range(min(size, count - first))]
            yield [(trial, suggest(trial, self._parameters)) for trial in trials]

    def tell(self, trial: Any, value: float | None) -> None:  # noqa: ANN401 - optuna.Trial
        """Report a trial's objective; None if its runs failed."""
        known = value is not None and math.isfinite(value)
        self._study.tell(trial, value if known else None, state=None if known else self._failed)
