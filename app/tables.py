"""Tables of text, for the terminal and in Markdown for the viewer."""

from collections.abc import Collection, Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

_WIDTH = 120


def table_console() -> Console:
    """Standard output for a table, which stays whole where nobody's terminal says how wide it is."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=max(console.width, _WIDTH))


def make_table(
    title: str | None,
    headings: Sequence[str],
    rows: Iterable[Iterable[str]],
    left: Collection[int] = (0,),
    no_wrap: bool = False,
    **options: Any,  # noqa: ANN401 - Rich's own
) -> Table:
    """A table whose columns are right-justified but for those in `left`; words that do not fit are folded, not cut."""
    table = Table(title=title, title_justify="left", **options)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="left" if number in left else "right", no_wrap=no_wrap, overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def markdown_table(headings: Sequence[str], rows: Iterable[Iterable[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (headings, ["---"] * len(headings), *rows)]


def in_markdown(tables: Iterable[Table]) -> str:
    parts = []
    for table in tables:
        rows = zip(*([str(cell) for cell in column.cells] for column in table.columns), strict=True)
        parts += [f"## {table.title}", "", *markdown_table([str(column.header) for column in table.columns], rows), ""]
    return "\n".join(parts)
