"""Conditions of the method: a measured number, its limit, and the setting that gives the limit."""

import math
import operator
from collections.abc import Iterable
from dataclasses import dataclass

from pydantic import BaseModel, ValidationError

from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.scan.labelling import MethodSettings

HEADINGS = "condition", "measured", "limit", "met", "turns at", "setting"
NOTE = (
    "*turns at*: the value of the setting, all else equal, at which the condition turns. "
    "In brackets: it does not decide the outcome of the line."
)

_COMPARISONS = {"<": operator.lt, "≤": operator.le, ">": operator.gt, "≥": operator.ge}
_TIMES = {"cm": 100.0, "m": 1.0, "%": 100.0}
_DIGITS = {"cm": 1, "m": 2, "%": 0}


@dataclass(frozen=True)
class Setting:
    """A setting of a step. scale: its limit grows by this for each unit of the value."""

    step: str
    field: str
    model: StepSettings
    scale: float = 1.0

    @property
    def value(self) -> float:
        return float(getattr(self.model, self.field))

    @property
    def assignment(self) -> str:
        """As `--set` takes it."""
        return f"{self.step}.{self.field}={self.value:g}"

    @property
    def is_integer(self) -> bool:
        return type(self.model).model_fields[self.field].annotation is int

    def allows(self, value: float) -> bool:
        """Return whether a run accepts this value."""
        kind = type(self.model)
        try:
            kind.model_validate({**self.model.model_dump(), self.field: value})
        except ValidationError:
            return False
        return True


def setting_of(settings: MethodSettings | BaseModel, name: str, scale: float = 1.0) -> Setting:
    """Return a setting by its dotted name. settings: of all steps, or of those of single scans."""
    step, _, field = name.partition(".")
    return Setting(step, field, getattr(settings, step), scale)


@dataclass(frozen=True)
class Condition:
    """One condition of the method, as it was decided.

    measured: NaN if there was nothing to measure. unit: of both numbers; "m" or "%" (of 1).
    setting: None for a constant. note: on the measured number, or why it is missing.
    otherwise: the exception by which the condition holds all the same. decides: the outcome of the
    line depends on it.
    """

    name: str
    measured: float
    comparison: str
    limit: float
    unit: str = ""
    setting: Setting | None = None
    note: str = ""
    otherwise: str = ""
    decides: bool = True

    @property
    def met(self) -> bool:
        return bool(self.otherwise) or self._holds(self.measured, self.limit)

    @property
    def measured_text(self) -> str:
        """The number and the note."""
        number = "" if math.isnan(self.measured) else self._numbers[0]
        return " ".join(filter(None, (number, self.note))) or "nothing"

    @property
    def limit_text(self) -> str:
        exception = f", or {self.otherwise}" if self.otherwise else ""
        return f"{self.comparison} {self._numbers[1]}{exception}"

    @property
    def turning_value(self) -> float | None:
        """The value of the setting with the opposite result, next to the present one.

        Its three digits are rounded to the far side. None if no value of the setting has it.
        """
        setting = self.setting
        if setting is None or self.otherwise or math.isnan(self.measured):
            return None
        offset = self.limit - setting.scale * setting.value
        exact = (float(self.measured) - offset) / setting.scale
        step = 10.0 ** (math.floor(math.log10(abs(exact) or 1.0)) - 2)
        step = 1.0 if setting.is_integer else step
        first = math.floor(exact / step) if self._turns_down else math.ceil(exact / step)
        for more in (0, 1):
            value = round((first - more if self._turns_down else first + more) * step, 12)
            if self._holds(self.measured, setting.scale * value + offset) != self.met:
                return value if setting.allows(value) else None
        return None

    @property
    def turning_text(self) -> str:
        value = self.turning_value
        return "–" if value is None else f"{'≤' if self._turns_down else '≥'} {value:g}"

    def __str__(self) -> str:
        setting = f"; {self.setting.assignment}" if self.setting is not None else ""
        return f"{self.name}: {self.measured_text} (limit {self.limit_text}{setting})"

    @property
    def row(self) -> tuple[str, ...]:
        """The cells below `HEADINGS`."""
        setting = "constant" if self.setting is None else self.setting.assignment
        met = "yes" if self.met else "no"
        met = met if self.decides else f"({met})"
        return self.name, self.measured_text, self.limit_text, met, self.turning_text, setting

    def _holds(self, measured: float, limit: float) -> bool:
        # Not converted: a float32 is compared as the method compares it.
        return bool(_COMPARISONS[self.comparison](measured, limit))

    @property
    def _turns_down(self) -> bool:
        return (self.comparison in "<≤") == self.met

    @property
    def _numbers(self) -> tuple[str, str]:
        """Both numbers, with as many digits as show the result of the comparison."""
        unit = self.unit
        if unit == "m" and max(abs(self.limit), abs(_known(self.measured))) < 1.0:
            unit = "cm"
        space = "" if unit in ("", "%") else " "
        holds, times = self._holds(self.measured, self.limit), _TIMES.get(unit, 1.0)
        pair = "", ""
        whole = self.setting is None or self.setting.is_integer
        for digits in range(_DIGITS.get(unit, 0 if whole else 2), 12):
            pair = f"{times * self.measured:.{digits}f}", f"{times * self.limit:.{digits}f}"
            if math.isnan(self.measured) or self._holds(*map(float, pair)) == holds:
                break
        measured, limit = (f"{text}{space}{unit}" for text in pair)
        return measured, limit


def centimetres(metres: float) -> str:
    return f"{100 * metres:.1f} cm" if abs(metres) < 1 else f"{metres:.2f} m"


def first_unmet(conditions: Iterable[Condition]) -> Condition | None:
    """Return the condition that decided against; None if all that decide are met."""
    return next((own for own in conditions if own.decides and not own.met), None)


def _known(value: float) -> float:
    return 0.0 if math.isnan(value) else value
