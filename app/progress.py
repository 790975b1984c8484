"""Progress on standard error: a bar for each stage on a terminal, plain lines elsewhere."""

import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars


class Progress:
    """Bars and messages; a context manager."""

    def __init__(self, quiet: bool = False) -> None:
        self._console = Console(stderr=True, quiet=quiet, highlight=False)
        self._bars = Bars(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=quiet or not sys.stderr.isatty(),
        )
        self._task: TaskID | None = None
        self._name = ""
        self._started = 0.0

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._end_stage(kind is None)
        self._bars.stop()

    def stage(self, name: str, total: int | None) -> None:
        """Begin a stage. total: number of its steps, None if unknown."""
        self._end_stage(True)
        self._name, self._started = name, time.monotonic()
        self._task = self._bars.add_task(name, total=total)

    def advance(self) -> None:
        """Advance the stage by one step."""
        if self._task is not None:
            self._bars.advance(self._task)

    def warn(self, text: str) -> None:
        """Print a warning."""
        self._console.print(f"warning: {text}", style="yellow", markup=False, soft_wrap=True)

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(text, markup=False, soft_wrap=True)

    def _end_stage(self, done: bool) -> None:
        if self._task is None:
            return
        if self._bars.disable and done:
            seconds = time.monotonic() - self._started
            self._console.print(f"{self._name}: {seconds:.1f} s", markup=False)
        self._bars.stop_task(self._task)
        self._task = None
