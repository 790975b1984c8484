"""The path of a bag: one file or folder, or several of them, the parts of one drive."""

import shlex
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class BagPath:
    """The paths that are opened as one bag, at least one; of an open bag in the order of time.

    As text, it is the first part and the number of others.
    """

    parts: tuple[Path, ...]

    def __str__(self) -> str:
        return self._with_others(str(self.parts[0]))

    @property
    def name(self) -> str:
        return self._with_others(self.parts[0].name)

    @property
    def stem(self) -> str:
        return self.parts[0].stem

    @property
    def words(self) -> str:
        """All parts, as on the command line."""
        return shlex.join(map(str, self.parts))

    @property
    def missing(self) -> Path | None:
        """The first part that does not exist; None where all do."""
        return next((part for part in self.parts if not part.exists()), None)

    def resolve(self) -> "BagPath":
        return BagPath(tuple(part.resolve() for part in self.parts))

    def _with_others(self, first: str) -> str:
        others = len(self.parts) - 1
        return f"{first} and {others} more" if others else first
