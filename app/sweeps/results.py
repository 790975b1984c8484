"""What came of a sweep: a table for the terminal, sweep.parquet, and the front of quality against time."""

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from rich.table import Table

from ffmap.app.folder import figures
from ffmap.app.folder.atomic import written_whole
from ffmap.app.folder.ranking import Ranking, Trial
from ffmap.app.sweeps.plan import Parameter
from ffmap.app.sweeps.schedule import Run
from ffmap.app.tables import make_table


class Results(Ranking):
    """All runs of a sweep; a trial is a combination that succeeded on every bag, in the order in which it was proposed."""

    def __init__(self, runs: Sequence[Run], parameters: Sequence[Parameter], objective: str) -> None:
        self.runs = tuple(runs)
        groups: dict[tuple[Any, ...], list[Run]] = {}
        for run in runs:
            groups.setdefault(tuple(run.combination.values()), []).append(run)
        trials = [_mean(group) for group in groups.values() if all(run.figures for run in group)]
        super().__init__(trials, [parameter.name for parameter in parameters], objective)

    @property
    def failures(self) -> list[str]:
        """Name and error of each run that failed."""
        return [f"{run.job.name}: {run.error}" for run in self.runs if run.error is not None]

    def table(self, width: int) -> Table:
        """Best first; as many of the usual figures as fit."""
        names = figures.short_names(self.parameters)
        # A step's name stands above its setting's.
        headings = {name: short.replace(".", ".\n") for name, short in names.items()}
        taken = sum(max(map(len, heading.split("\n"))) + 3 for heading in headings.values())
        room = width - taken - max(len(run.job.name) for run in self.runs) - 12
        shown = figures.fit({name: len(name) for name in self.headlines}, room, least=3)
        arrow = "least" if figures.less_is_better(self.objective) else "highest"
        rows = []
        for place in self.ranked:
            trial = self.trials[place]
            values = [trial.combination[name] for name in self.parameters]
            more = f" +{len(trial.names) - 1}" if len(trial.names) > 1 else ""
            cells = map(figures.format_value, (*values, *(trial.figures.get(name) for name in shown)))
            rows.append(["●" if place in self.front else "", *cells, trial.names[0] + more])
        title = f"{len(self.trials)} settings by {self.objective}, {arrow} first; ● no other is better and faster"
        columns = ("", *headings.values(), *shown, "run")
        table = make_table(title, columns, rows, left=(0, len(columns) - 1))
        table.columns[-1].no_wrap = True
        return table

    def write(self, path: Path) -> None:
        """One row for each run: its folder, bag, values, outcome, and every figure."""
        on_front = {name for place in self.front for name in self.trials[place].names}
        rows = [
            {
                "run": run.job.name,
                "bag": str(run.job.arguments.bag),
                "state": "failed" if run.error is not None else "complete",
                "error": run.error,
                "settings_hash": run.job.settings_hash,
                "labels_digest": run.record.get("labels_digest"),
                "git_revision": run.record.get("versions", {}).get("git_revision"),
                "pareto": run.job.name in on_front,
                **run.combination,
                **run.figures,
            }
            for run in self.runs
        ]
        # Of all rows: the first may lack figures.
        columns = dict.fromkeys(name for row in rows for name in row)
        table = pa.Table.from_pylist([dict.fromkeys(columns) | row for row in rows])
        with written_whole(path) as part:
            pq.write_table(table, part)


def _mean(runs: Sequence[Run]) -> Trial:
    common = [name for name in runs[0].figures if all(name in run.figures for run in runs)]
    means = {name: statistics.fmean(run.figures[name] for run in runs) for name in common}
    return Trial(runs[0].combination, tuple(run.job.name for run in runs), means)
