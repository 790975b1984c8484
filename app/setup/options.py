"""The options of a run: one record from the command line to run.json, and back when resumed."""

from pathlib import Path
from typing import Any, Literal

import xxhash
from pydantic import BaseModel, ConfigDict, Field, field_validator

from ffmap.app.setup.outputs import RUN_OUTPUTS, Detail, Output


class RunOptions(BaseModel):
    """Inputs and outputs of a run.

    vertical: topics of the labelled lidars; empty to detect them. trajectory: file or topic of
    poses; None for the odometry. trajectory_frame: their frame; None to detect it.
    digests: of the files that rig and trajectory name, in run.json only.
    """

    model_config = ConfigDict(frozen=True)

    rig: Path | None = None
    horizontal: str | None = None
    vertical: tuple[str, ...] = ()
    time_from: Literal["auto", "azimuth", "none"] = "auto"
    trajectory: str | None = None
    trajectory_frame: str | None = None
    mount: Literal["refine", "as-given"] = "refine"
    detail: Detail = Detail.LINES
    outputs: tuple[Output, ...] = RUN_OUTPUTS
    evaluate: bool = True
    digests: dict[str, str] = {}

    # Not in run.json: a resumed run may differ in these.
    workers: int = Field(2, exclude=True)
    scheduler: str | None = Field(None, exclude=True)
    connect: str | None = Field(None, exclude=True)
    spawn: bool = Field(False, exclude=True)
    quiet: bool = Field(False, exclude=True)
    verbose: bool = Field(False, exclude=True)

    @field_validator("vertical", mode="before")
    @classmethod
    def _as_several(cls, value: object) -> object:
        """Accept one topic, or null, as earlier versions wrote."""
        return (value,) if isinstance(value, str) else value or ()

    @field_validator("outputs", mode="before")
    @classmethod
    def _as_named_now(cls, value: object) -> object:
        """Accept "labelled" for the labelled bag, as earlier versions wrote."""
        if not isinstance(value, list):
            return value
        return [Output.LABELLED_BAG if name == "labelled" else name for name in value]

    def stored(self) -> dict[str, Any]:
        """Return the options in run.json, with absolute paths and the digests of files."""
        kept = self.model_dump(mode="json")
        kept["digests"] = {}
        for name in ("rig", "trajectory"):
            # A trajectory may be a topic.
            if kept[name] is not None and Path(kept[name]).exists():
                file = Path(kept[name]).resolve()
                kept[name] = str(file)
                if file.is_file():
                    kept["digests"][name] = xxhash.xxh3_128_hexdigest(file.read_bytes())
        return kept

    def resumed_with(self, now: "RunOptions") -> "RunOptions":
        """Return these options with those of `now` that run.json does not contain."""
        return now.model_copy(update=self.model_dump())
