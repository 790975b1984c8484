"""Combinations of settings ranked by one figure, and which of them no other beats in both that and time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ffmap.app.folder import figures


@dataclass(frozen=True)
class Trial:
    """A combination of values, and the mean of each figure over the bags."""

    combination: Mapping[str, Any]
    names: tuple[str, ...]
    """Of its runs."""
    figures: dict[str, float]


class Ranking:
    """Trials ranked by an objective.

    cost: the name of the time that a trial took, as well as it is known. front: places of the trials that no other beats in
    both the objective and time, the fastest first.
    """

    def __init__(self, trials: Sequence[Trial], parameters: Sequence[str], objective: str) -> None:
        self.trials, self.parameters, self.objective = tuple(trials), tuple(parameters), objective
        timed = all(figures.CPU_SECONDS in trial.figures for trial in self.trials)
        self.cost = figures.CPU_SECONDS if timed else figures.SECONDS
        self.front = tuple(figures.pareto_front(self._costs, [self.quality(trial) for trial in self.trials]))

    def quality(self, trial: Trial) -> float:
        """The objective, the more the better; NaN where it is not known."""
        value = trial.figures.get(self.objective, float("nan"))
        return -value if figures.less_is_better(self.objective) else value

    @property
    def _costs(self) -> list[float]:
        return [trial.figures.get(self.cost, math.nan) for trial in self.trials]

    @property
    def ranked(self) -> list[int]:
        """Places of the trials, best first, of those that are as good the fastest; those without the objective last."""
        quality, costs = [self.quality(trial) for trial in self.trials], self._costs
        return sorted(range(len(quality)), key=lambda i: (math.isnan(quality[i]), -quality[i], costs[i]))

    @property
    def headlines(self) -> list[str]:
        """The objective and the time, then the usual figures that some trial has."""
        usual = dict.fromkeys([self.objective, self.cost, *figures.HEADLINES])
        return [name for name in usual if any(name in trial.figures for trial in self.trials)]
