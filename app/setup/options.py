"""How a run is made: one record from the command line to run.json, and back when it is resumed."""

from pathlib import Path
from typing import Any, Literal

import xxhash
from pydantic import BaseModel, ConfigDict, Field, field_validator

from ffmap.app.setup.outputs import RUN_OUTPUTS, Detail, Output


class RunOptions(BaseModel):
    """What is no setting of the method: how the bag is read, and what is written.

    vertical: topics of the lidars that are labelled; empty to find them.
    trajectory: file or topic of the poses; None for the odometry.
    trajectory_frame: the frame that these poses are of; None to find it.
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

    # How the program is called this time: not in run.json, and free to differ when resumed.
    workers: int = Field(2, exclude=True)
    scheduler: str | None = Field(None, exclude=True)
    connect: str | None = Field(None, exclude=True)
    spawn: bool = Field(False, exclude=True)
    quiet: bool = Field(False, exclude=True)
    verbose: bool = Field(False, exclude=True)

    @field_validator("vertical", mode="before")
    @classmethod
    def _as_several(cls, value: object) -> object:
        """Earlier versions wrote one topic, or null."""
        return (value,) if isinstance(value, str) else value or ()

    @field_validator("outputs", mode="before")
    @classmethod
    def _as_named_now(cls, value: object) -> object:
        """Earlier versions wrote "labelled" for the labelled bag."""
        if not isinstance(value, list):
            return value
        return [Output.LABELLED_BAG if name == "labelled" else name for name in value]

    def stored(self) -> dict[str, Any]:
        """What run.json keeps; with absolute paths and digests, as files may change meanwhile."""
        kept = self.model_dump(mode="json")
        if self.rig is not None:
            kept["rig"] = str(self.rig.resolve())
        if self.trajectory is not None and Path(self.trajectory).exists():
            kept["trajectory"] = str(Path(self.trajectory).resolve())
        files = {name: Path(kept[name]) for name in ("rig", "trajectory") if kept[name] is not None}
        kept["digests"] = {
            name: xxhash.xxh3_128_hexdigest(file.read_bytes())
            for name, file in files.items()
            if file.is_file()
        }
        return kept

    def resumed_with(self, now: "RunOptions") -> "RunOptions":
        """These options, read from run.json, with what is `now` given and not kept there."""
        return now.model_copy(update=self.model_dump())
