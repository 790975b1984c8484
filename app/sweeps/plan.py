"""Which settings a sweep tries: every combination of a grid, or some that are drawn or proposed."""

import itertools
import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffmap.app.folder.figures import less_is_better
from ffmap.app.own_command import pip_command
from ffmap.app.setup.settings import Settings, parse_value, validate
from ffmap.loaders.errors import InputError

Combination = Mapping[str, Any]
"""A value for each parameter, by the setting's dotted name."""

_DIGITS = 4
"""Significant digits of a value that is drawn from a range."""


@dataclass(frozen=True)
class Choice:
    """A setting that takes one of some values."""

    name: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Range:
    """A setting that takes any value from `low` to `high`; whole numbers only if both are."""

    name: str
    low: float
    high: float

    @property
    def whole(self) -> bool:
        return isinstance(self.low, int) and isinstance(self.high, int)


Parameter = Choice | Range


def parse_grid(texts: Sequence[str], base: Settings, ranges: bool) -> tuple[Parameter, ...]:
    """Parse texts like wall_planes.similarity_m=0.02,0.05 or wall_planes.similarity_m=0.02..0.08.

    Args:
        base: the settings that stay.
        ranges: whether a range may be given.

    Raises InputError that names the wrong text.
    """
    if not texts:
        raise InputError("--grid: nothing to sweep; give values, as in --grid doors.lines_min=2,3")
    parameters: dict[str, Parameter] = {}
    for text in texts:
        parameter = _parse(text, base)
        if parameter.name in parameters:
            raise InputError(
                f"--grid {text}: {parameter.name} is given twice; write all values in one --grid"
            )
        if isinstance(parameter, Range) and not ranges:
            raise InputError(f"--grid {text}: a range needs --random N or --optuna N; or list values")
        parameters[parameter.name] = parameter
    return tuple(parameters.values())


def _parse(text: str, base: Settings) -> Parameter:
    name, equals, listed = (part.strip() for part in text.partition("="))
    parts = [part.strip() for part in listed.split(",")]
    if not equals or not name or not all(parts):
        raise InputError(
            f"--grid {text}: write it as step.name=value,value, as in doors.lines_min=2,3"
        )
    low, dots, high = listed.partition("..")
    if dots and len(parts) == 1:
        ends = parse_value(low), parse_value(high)
        numbers = all(isinstance(end, int | float) and not isinstance(end, bool) for end in ends)
        if not numbers or ends[0] >= ends[1]:
            raise InputError(f"--grid {text}: write a range as lower..higher, as in 0.02..0.08")
        for end in ends:
            apply(base, {name: end})
        return Range(name, *ends)
    # Values as the settings hold them: 1 for a length in metres is 1.0.
    applied = (apply(base, {name: parse_value(part)}).flat().get(name) for part in parts)
    values = tuple(dict.fromkeys(applied))
    if None in values:
        raise InputError(
            f"--grid {text}: {name!r} is a step; name a setting, 'ffmap settings' lists them"
        )
    return Choice(name, values)


def apply(base: Settings, combination: Combination) -> Settings:
    """Return the settings with a combination's values. Raises InputError if one is invalid."""
    values = base.model_dump()
    for name, value in combination.items():
        *steps, last = name.split(".")
        target = values
        for step in steps:
            target = target.setdefault(step, {})
            if not isinstance(target, dict):
                raise InputError(
                    f"--grid {name}: {step!r} is no step; 'ffmap settings' lists all settings"
                )
        target[last] = value
    return validate(values, "--grid")


def overrides_of(settings: Settings) -> list[str]:
    """Return what differs from the default settings, as --set takes it."""
    defaults = Settings().flat()
    differing = {name: value for name, value in settings.flat().items() if value != defaults[name]}
    return [f"{name}={json.dumps(value)}" for name, value in differing.items()]


def grid_of(parameters: Sequence[Parameter]) -> list[Combination]:
    """Return every combination; the last parameter changes fastest."""
    choices = [p.values for p in parameters if isinstance(p, Choice)]
    return [_named(parameters, values) for values in itertools.product(*choices)]


def random_of(parameters: Sequence[Parameter], count: int, seed: int) -> list[Combination]:
    """Return `count` different combinations; all of them if there are fewer."""
    generator = np.random.default_rng(seed)
    different: dict[tuple[Any, ...], Combination] = {}
    # Choices and whole numbers may run out of different combinations.
    for _ in range(100 * count):
        values = tuple(_draw(parameter, generator) for parameter in parameters)
        different.setdefault(values, _named(parameters, values))
        if len(different) == count:
            break
    return list(different.values())


def _draw(parameter: Parameter, generator: np.random.Generator) -> Any:  # noqa: ANN401 - a setting's value
    if isinstance(parameter, Choice):
        return parameter.values[int(generator.integers(len(parameter.values)))]
    if parameter.whole:
        return int(generator.integers(int(parameter.low), int(parameter.high), endpoint=True))
    return _rounded(float(generator.uniform(parameter.low, parameter.high)))


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _named(parameters: Sequence[Parameter], values: Sequence[Any]) -> Combination:
    return dict(zip((p.name for p in parameters), values, strict=True))


class Study:
    """Combinations that Optuna's TPE sampler proposes, each batch after the figures of those before.

    The seed makes the proposals repeatable: a sweep that is started again proposes the same.
    """

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
        better = optuna.study.StudyDirection
        direction = better.MINIMIZE if less_is_better(objective) else better.MAXIMIZE
        self._study = optuna.create_study(sampler=sampler, direction=direction)
        self._parameters = parameters
        self._failed = optuna.trial.TrialState.FAIL

    def batches(self, count: int, size: int) -> Iterator[list[tuple[Any, Combination]]]:
        """Yield trials with their combinations; each batch has to be told before the next."""
        for first in range(0, count, size):
            trials = [self._study.ask() for _ in range(min(size, count - first))]
            yield [(trial, {p.name: _suggest(trial, p) for p in self._parameters}) for trial in trials]

    def tell(self, trial: Any, value: float | None) -> None:  # noqa: ANN401 - optuna.Trial
        """Report a trial's objective; None if its runs failed."""
        known = value is not None and math.isfinite(value)
        self._study.tell(trial, value if known else None, state=None if known else self._failed)


def _suggest(trial: Any, parameter: Parameter) -> Any:  # noqa: ANN401 - optuna.Trial; a setting's value
    if isinstance(parameter, Choice):
        return trial.suggest_categorical(parameter.name, parameter.values)
    if parameter.whole:
        return trial.suggest_int(parameter.name, int(parameter.low), int(parameter.high))
    return _rounded(trial.suggest_float(parameter.name, parameter.low, parameter.high))
