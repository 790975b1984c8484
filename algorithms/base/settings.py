"""The base class of all steps' settings."""

from typing import Any

from pydantic import BaseModel, ConfigDict, field_validator

NUMBER_MAX = 2**31 - 1  # compiled code counts with 32 bits


class StepSettings(BaseModel):
    """Settings of one step: frozen, unknown names refused; a field states unit and source."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    @field_validator("*")
    @classmethod
    def _of_bounded_size(cls, value: Any) -> Any:  # noqa: ANN401 - any type of field
        if isinstance(value, int | float) and abs(value) > NUMBER_MAX:
            raise ValueError(f"Input should be at most {NUMBER_MAX} in size")
        return value
