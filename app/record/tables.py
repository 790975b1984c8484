"""Tables in Markdown, of the fields of a step's answer."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base.segments import lengths_m


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    lines = ["| " + " | ".join(str(cell) for cell in row) + " |" for row in (headings, *rows)]
    return "\n".join([lines[0], "|---" * len(headings) + "|", *lines[1:]])


def fields_table(
    items: Any,  # noqa: ANN401 - any dataclass
    *names: str,
    **columns: Sequence[object],
) -> str:
    """Return a table with a row for each item of a dataclass of arrays.

    names: fields (K,); `_m` in a name is its unit. columns: further cells by heading, first.
    Items with `ends` (K, 2, 2) also have their place and length in it.
    """
    cells: dict[str, Sequence[object]] = {**columns}
    if hasattr(items, "ends"):
        cells["x, y (m)"] = [f"{x:.2f}, {y:.2f}" for x, y in items.ends.mean(axis=1)]
        cells["length (m)"] = [f"{length:.2f}" for length in lengths_m(items.ends)]
    for name in names:
        heading = f"{name[:-2]} (m)" if name.endswith("_m") else name
        cells[heading.replace("_", " ")] = _formatted(getattr(items, name))
    return table(list(cells), list(zip(*cells.values(), strict=True)))


def _formatted(values: npt.NDArray[Any]) -> list[str]:
    if values.dtype == bool:
        return ["yes" if value else "–" for value in values]
    if np.issubdtype(values.dtype, np.floating):
        return [f"{value:.3g}" if np.isfinite(value) else "–" for value in values]
    return [f"{value:,}" for value in values]
