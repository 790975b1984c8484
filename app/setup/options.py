"""The options of a run: one record from the command line to run.json, and back when resumed."""

from pathlib import Path
from typing import Any, Literal

import xxhash
from pydantic import BaseModel, ConfigDict, Field

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

    def with_digests(self) -> "RunOptions":
        """Return the options for run.json, with absolute paths and the digests of files."""
        update: dict[str, Any] = {"digests": {}}
        for name in ("rig", "trajectory"):
            named = getattr(self, name)
            # A trajectory may be a topic.
            if named is not None and (file := Path(named).resolve()).exists():
                update[name] = type(named)(file)
                if file.is_file():
                    update["digests"][name] = xxhash.xxh3_128_hexdigest(file.read_bytes())
        return self.model_copy(update=update)

    def resumed_with(self, now: "RunOptions") -> "RunOptions":
        """Return these options with those of `now` that run.json does not contain."""
        return now.model_copy(update=self.model_dump())
