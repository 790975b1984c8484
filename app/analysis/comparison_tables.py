"""A comparison of runs as tables, and as the content of comparison.json."""

from collections.abc import Iterable
from typing import Any

from rich.table import Table

from ffmap.app.analysis.comparison import CHANGES, Change, Comparison
from ffmap.app.analysis.figures import FIGURES, HEADLINES, Figure
from ffmap.app.tables import in_markdown, make_table

_TRANSITIONS_SHOWN = 6


def print_tables(comparison: Comparison) -> list[Table]:
    """Tabulate the runs, their settings, what differs, and the main figures."""
    changes = (_change_table(change) for change in comparison.changes)
    figures = _figures_table(comparison, HEADLINES)
    return [_runs_table(comparison), _settings_table(comparison), *changes, figures]


def runs_document(comparison: Comparison) -> str:
    """Describe the runs and all their figures, in Markdown."""
    names = dict.fromkeys((*FIGURES, *comparison.figures))
    figures = _figures_table(comparison, names)
    tables = (_runs_table(comparison), _settings_table(comparison), figures)
    warnings = "\n".join(f"- {warning}" for warning in comparison.warnings)
    return f"# The runs\n\n{warnings}\n\n{in_markdown(tables)}"


def change_document(change: Change, comparison: Comparison) -> str:
    """Describe what differs between two runs, in Markdown."""
    return in_markdown((_change_table(change), _settings_table(comparison)))


def _runs_table(comparison: Comparison) -> Table:
    rows = []
    for one in comparison.runs:
        bag = one.run.bag_path
        rows.append([one.letter, str(one.run.path), one.run.outcome, bag.name if bag else "–"])
    return make_table("Runs", ("", "folder", "outcome", "bag"), rows, left=range(4))


def _settings_table(comparison: Comparison) -> Table:
    letters = [run.letter for run in comparison.runs]
    rows = (
        [name, *("–" if value is None else str(value) for value in row)]
        for name, row in comparison.settings.items()
    )
    title = "Settings, options and versions that differ"
    return make_table(title, ("", *letters), rows, left=range(1 + len(letters)))


def _figures_table(comparison: Comparison, names: Iterable[str]) -> Table:
    first, *others = (run.letter for run in comparison.runs)
    rows = []
    for name in names:
        if (values := comparison.figures.get(name)) is not None:
            figure = FIGURES.get(name, Figure(name))
            differences = (figure.difference(values[0], value) for value in values[1:])
            rows.append([figure.heading, *map(figure.text, values), *differences])
    headings = ("figure", first, *others, *(f"{other} − {first}" for other in others))
    return make_table("Figures", headings, rows)


def _change_table(change: Change) -> Table:
    rows = [
        (figure.heading, figure.text(change.figures[name]))
        for name, figure in CHANGES.items()
        if name in change.figures
    ]
    transitions = list(change.details.get("transitions", {}).items())[:_TRANSITIONS_SHOWN]
    rows += [(f"labels {name}", f"{count:,}") for name, count in transitions]
    if change.labels is not None and change.labels.worst is not None:
        rows.append(("scan with most changed labels", str(change.labels.worst)))
    rows += [("door altered", words) for _, words in change.doors.get("altered", ())]
    rows += [(f"{what}: not compared", why) for what, why in change.not_compared.items()]
    title = f"{change.b.title} against {change.a.title}"
    return make_table(title, ("what", "how much"), rows, left=(0, 1), show_header=False)


def as_json(comparison: Comparison) -> dict[str, Any]:
    """Return the content of comparison.json.

    Settings and figures have a value for each run.
    """
    return {
        "runs": [
            {"letter": run.letter, "path": str(run.run.path.resolve()), "outcome": run.run.outcome}
            for run in comparison.runs
        ],
        "warnings": list(comparison.warnings),
        "settings": comparison.settings,
        "figures": comparison.figures,
        "comparisons": [
            {
                "a": change.a.letter,
                "b": change.b.letter,
                "compared": change.compared,
                "not_compared": change.not_compared,
                "changes": change.figures,
                **change.details,
            }
            for change in comparison.changes
        ],
    }
