"""A comparison of runs as tables, and as the content of comparison.json."""

from collections.abc import Iterable
from typing import Any

from rich.table import Table

from ffmap.app.analysis.comparison import CHANGES, Change, Comparison
from ffmap.app.analysis.figures import FIGURES, HEADLINES, Figure
from ffmap.app.analysis.verdict import describe
from ffmap.app.setup.settings import acts_on
from ffmap.app.tables import in_markdown, make_table

_TRANSITIONS_SHOWN = 6
_SCANS_SHOWN = 3


def print_tables(comparison: Comparison) -> list[Table]:
    """Tabulate the main figures, the differences, settings, and runs; what there is of them."""
    changes = [table for change in comparison.changes for table in _change_tables(change)]
    figures = _figures_table(comparison, HEADLINES)
    tables = [figures, *changes, _settings_table(comparison), _runs_table(comparison)]
    return [table for table in tables if table.row_count]


def runs_document(comparison: Comparison) -> str:
    """Describe the runs and all their figures, in Markdown."""
    names = dict.fromkeys((*HEADLINES, *FIGURES, *comparison.figures))
    figures = _figures_table(comparison, names)
    tables = (_runs_table(comparison), _settings_table(comparison), figures)
    lines = "\n".join(f"- {line}" for line in (*describe(comparison), *comparison.warnings))
    return f"# The runs\n\n{lines}\n\n{in_markdown(tables)}"


def change_document(change: Change, comparison: Comparison) -> str:
    """Describe what differs between two runs, in Markdown."""
    verdict = describe(comparison)[comparison.changes.index(change) - len(comparison.changes)]
    pair = (change.a.letter, change.b.letter)
    figures = _figures_table(comparison, HEADLINES, pair)
    tables = (figures, *_change_tables(change), _settings_table(comparison))
    return f"**{verdict}**\n\n{in_markdown(tables)}"


def _runs_table(comparison: Comparison) -> Table:
    rows = []
    for one in comparison.runs:
        bag = one.run.bag_path
        rows.append([one.letter, str(one.run.path), one.run.outcome, bag.name if bag else "–"])
    return make_table("Runs", ("", "folder", "outcome", "bag"), rows, left=range(4))


def _settings_table(comparison: Comparison) -> Table:
    letters = [run.letter for run in comparison.runs]
    rows = (
        [name, *("–" if value is None else str(value) for value in row), acts_on(name) or "–"]
        for name, row in comparison.settings.items()
    )
    title = "Settings, options and versions that differ"
    left = range(2 + len(letters))
    return make_table(title, ("", *letters, "acts on"), rows, left=left)


def _figures_table(
    comparison: Comparison, names: Iterable[str], pair: tuple[str, ...] | None = None
) -> Table:
    """Tabulate figures in their order of weight. pair: letters of the only runs to show."""
    letters = [run.letter for run in comparison.runs]
    shown = [k for k, letter in enumerate(letters) if pair is None or letter in pair]
    rows = []
    for name in names:
        if (all_values := comparison.figures.get(name)) is not None:
            figure = FIGURES.get(name, Figure(name))
            values = [all_values[k] for k in shown]
            differences = (_difference(figure, values[0], value) for value in values[1:])
            heading = f"{figure.heading} {figure.arrow}".rstrip()
            rows.append([heading, *map(figure.text, values), *differences])
    first, *others = (letters[k] for k in shown)
    legend = "↑ higher is better, ↓ lower"
    headings = (legend, first, *others, *(f"{other} − {first}" for other in others))
    return make_table("Figures, most important first (≈ within tolerance)", headings, rows)


def _difference(figure: Figure, first: float | None, second: float | None) -> str:
    """Format a difference, and whether the second value is better or worse."""
    text, gain = figure.difference(first, second), figure.gain(first, second)
    if gain is None or text == "=":
        return text
    return f"{text} {'better' if gain > 0 else 'worse'}" if gain else "≈"


def _change_tables(change: Change) -> list[Table]:
    """Tabulate what became right and wrong, and all numbers that are not 0."""
    tables = []
    if became := change.details.get("became"):
        rows = [
            (truth.replace("_", " "), *(f"{counts[kind]:,}" for kind in ("right", "wrong")))
            for truth, counts in became.items()
        ]
        scans = change.details["scans"]
        worst = [
            ", ".join(
                f"{scan['scan']} ({scan[kind]:,})"
                for scan in sorted(scans, key=lambda scan: -scan[kind])[:_SCANS_SHOWN]
                if scan[kind]
            )
            for kind in ("became_right", "became_wrong")
        ]
        rows.append(("scans with most", *worst))
        title = f"{change.b.letter} against {change.a.letter}: changed labels by true class"
        tables.append(make_table(title, ("true class", "became right", "became wrong"), rows))
    texts = [(own, own.text(change.figures.get(name))) for name, own in CHANGES.items()]
    rows = [(own.heading, text) for own, text in texts if text.strip("0.–")]
    transitions = list(change.details.get("transitions", {}).items())[:_TRANSITIONS_SHOWN]
    rows += [(f"labels {name}", f"{count:,}") for name, count in transitions]
    if change.labels is not None and change.labels.worst is not None:
        rows.append(("scan with most changed labels", str(change.labels.worst)))
    rows += [("door altered", words) for _, words in change.doors.get("altered", ())]
    rows += [(f"{what}: not compared", why) for what, why in change.not_compared.items()]
    title = f"{change.b.letter} against {change.a.letter}: all differences"
    return [*tables, make_table(title, ("what", "how much"), rows, left=(0, 1), show_header=False)]


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
        "verdict": describe(comparison),
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
