"""What every step's settings have in common."""

from pydantic import BaseModel, ConfigDict


class StepSettings(BaseModel):
    """Settings of one step: frozen, no unknown names; each field says its unit, meaning and source."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)
