"""Where a bag lies: one file or folder, or several of them, the parts of one drive."""

import shlex
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class BagPath:
    """What is opened as one bag; an error about all of it names it by its first part.

    parts: files and folders, one at least; those of an open bag are in the order of time.
    """

    parts: tuple[Path, ...]

    def __str__(self) -> str:
        return self._with_others(str(self.parts[0]))

    @property
    def name(self) -> str:
        """The same without the folder."""
        return self._with_others(self.parts[0].name)

    @property
    def stem(self) -> str:
        """What files that are made from the bag are named after."""
        return self.parts[0].stem

    @property
    def words(self) -> str:
        """All parts, as the command line takes them."""
        return shlex.join(map(str, self.parts))

    @property
    def missing(self) -> Path | None:
        """The first part that is not there; None where all are."""
        return next((part for part in self.parts if not part.exists()), None)

    def resolve(self) -> "BagPath":
        return BagPath(tuple(part.resolve() for part in self.parts))

    def _with_others(self, first: str) -> str:
        others = len(self.parts) - 1
        return f"{first} and {others} more" if others else first
