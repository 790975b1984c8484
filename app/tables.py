"""Tables for the terminal, and in Markdown for the viewer."""

import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from rich.console import JustifyMethod
from rich.table import Table


def make_table(
    title: str | None,
    headings: Sequence[str],
    rows: Iterable[Iterable[str]],
    left: Collection[int] = (0,),
    whole: Collection[int] = (),
    **options: Any,  # noqa: ANN401 - Rich's own
) -> Table:
    """Return a table of right-justified columns, except those in `left`.

    Long cells are folded, except in the columns `whole`.
    """
    table = Table(title=title, title_justify="left", **options)
    for number, heading in enumerate(headings):
        justify: JustifyMethod = "left" if number in left else "right"
        table.add_column(heading, justify=justify, overflow="fold", no_wrap=number in whole)
    for row in rows:
        table.add_row(*row)
    return table


def format_value(value: object) -> str:
    """Format a value with four significant digits."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, float):
        return f"{value:.0f}" if value.is_integer() else f"{value:.4g}"
    return str(value)


def markdown_table(headings: Sequence[str], rows: Iterable[Iterable[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (headings, ["---"] * len(headings), *rows)]


def in_markdown(tables: Iterable[Table]) -> str:
    parts = []
    for table in tables:
        rows = zip(*([str(cell) for cell in column.cells] for column in table.columns), strict=True)
        headings = [str(column.header) for column in table.columns]
        parts += [f"## {table.title}", "", *markdown_table(headings, rows), ""]
    return "\n".join(parts)
