"""What a bench found: as tables, each number with its unit in a heading, and as JSON, with its unit in its name."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from ffmap.app.analysis.bench_floors import LabellingTimes, Line
from ffmap.app.analysis.bench_runs import PARTS, STAGES, MeasuredRun
from ffmap.app.analysis.metrics_tables import PAPER_STATISTICS
from ffmap.app.tables import make_table

_FLOORS = {
    "reading": "the messages' bytes alone, not decoded",
    "labelling": "each return touched once",
    "odometry": "KISS-ICP alone, not refined, no loops",
    "scans": "the recording's bytes, written plainly",
    "final": "the labelled bag's bytes, written plainly",
}
_NONE = "–"


@dataclass(frozen=True)
class Repeated:
    """A run of a bag that holds the drive several times, with its poses given."""

    times: int
    driving_s: float
    run: MeasuredRun


@dataclass(frozen=True)
class Budget:
    """What a run takes, stage by stage.

    clouds: of both lidars. cloud_bytes: 22 for each of their places. reading: ms a scan. stages: seconds, by name.
    """

    runs: int
    workers: int
    driving_s: float
    clouds: int
    cloud_bytes: int
    reading: Line
    labelling: LabellingTimes
    stages: Mapping[str, Line]
    run: MeasuredRun
    repeated: Repeated | None

    @property
    def times_real_time(self) -> float:
        """Seconds of driving for each second."""
        return self.driving_s / self.run.whole_s

    @property
    def share_of_clouds(self) -> float:
        """The recording's size, of the clouds'."""
        return self.run.recording_bytes / max(self.cloud_bytes, 1)


@dataclass(frozen=True)
class Comparison:
    """Two versions of the program side by side: the medians of their runs. other: the revision's name."""

    runs: int
    workers: int
    driving_s: float
    other: str
    this_run: MeasuredRun
    other_run: MeasuredRun


def budget_tables(budget: Budget) -> Iterator[Table]:
    """All of it but `budget_lines`."""
    of = "" if budget.runs == 1 else f", medians of {budget.runs} runs"
    per_scan = {"reading": budget.reading, "labelling": budget.labelling.line}
    yield _budget_table(f"One scan, one thread{of}", "ms", per_scan, {"labelling": "smoothing, labelling"})
    whole = {**budget.stages, "whole run": Line(None, budget.run.whole_s)}
    yield _budget_table(f"The run, {budget.workers} workers{of}", "s", whole, {})
    headings = ("", "returns", "median, ms", "mean, ms", "standard deviation, ms", "min, ms", "max, ms")
    yield make_table("Smoothing and labelling of a scan", headings, _labelling_rows(budget.labelling))
    if (repeated := budget.repeated) is not None:
        title = f"The drive {repeated.times} times in one bag"
        stages = {name: (repeated.run.timings_s[name], budget.run.timings_s[name]) for name in STAGES[1:]}
        yield _pair_table(title, (f"{repeated.times} times, s", "once, s"), stages)
    yield _memory_table(_memory_runs(budget))


def budget_lines(budget: Budget) -> Iterator[str]:
    """What is told below the tables."""
    yield (
        f"whole run: {budget.driving_s:.1f} s of driving ({budget.clouds} clouds) in {budget.run.whole_s:.1f} s, "
        f"{budget.times_real_time:.2f} s of driving a second"
    )
    yield f"recording: {budget.share_of_clouds:.3f} of the clouds' bytes (22 a point)"


def budget_json(budget: Budget) -> dict[str, Any]:
    """The same for programs."""
    labelling = budget.labelling
    spread = dict(zip(("mean_ms", "standard_deviation_ms", "min_ms", "max_ms"), _spread(labelling), strict=True))
    content = {
        "runs": budget.runs,
        "workers": budget.workers,
        "driving_s": budget.driving_s,
        "clouds": budget.clouds,
        "budget": {
            "reading": _line_json(budget.reading, "ms"),
            "labelling": {**_line_json(labelling.line, "ms"), **spread, "returns": labelling.points},
            **{name: _line_json(line, "s") for name, line in budget.stages.items()},
            "whole_run": {**_line_json(Line(None, budget.run.whole_s), "s"), "times_real_time": budget.times_real_time},
        },
        "memory": _memory_json(budget.run),
        "recording": {"size_mib": budget.run.recording_bytes / 2**20, "share_of_clouds": budget.share_of_clouds},
    }
    if (repeated := budget.repeated) is not None:
        told = {"times": repeated.times, "driving_s": repeated.driving_s}
        content["repeated"] = {**told, **_run_json(repeated.run), "memory": _memory_json(repeated.run)}
    return content


def comparison_tables(comparison: Comparison) -> Iterator[Table]:
    """Seconds, milliseconds and memory of both versions, and their ratios."""
    this, other = comparison.this_run, comparison.other_run
    seconds = {name: (this.timings_s.get(name), other.timings_s.get(name)) for name in STAGES}
    pairs = {**seconds, "whole run": (this.whole_s, other.whole_s)}
    yield _pair_table(f"The run, {comparison.workers} workers", ("this, s", f"{comparison.other}, s"), pairs)
    per_scan = {"smoothing, labelling": (this.labelling_ms, other.labelling_ms)}
    yield _pair_table("One scan, mean, by workers side by side", ("this, ms", f"{comparison.other}, ms"), per_scan)
    memory = {"peak memory": (this.peak_mib, other.peak_mib)}
    memory["recording"] = (this.recording_bytes / 2**20, other.recording_bytes / 2**20)
    yield _pair_table("Memory and disk", ("this, MiB", f"{comparison.other}, MiB"), memory)


def comparison_lines(comparison: Comparison) -> Iterator[str]:
    """What is told below the tables."""
    of = "one run" if comparison.runs == 1 else f"the medians of {comparison.runs} runs"
    yield f"{comparison.driving_s:.1f} s of driving; {of} of each version, in turn"


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """The same for programs; ratios are this version's figures by the other's."""
    this, other = _version_json(comparison.this_run), _version_json(comparison.other_run)
    ratios = {name: _ratio(this[name], other[name]) for name in this if isinstance(this[name], float)}
    return {
        "runs": comparison.runs,
        "workers": comparison.workers,
        "driving_s": comparison.driving_s,
        "against": comparison.other,
        "this": this,
        "other": other,
        "ratio": {name.rsplit("_", 1)[0]: ratio for name, ratio in ratios.items()},
    }


def _budget_table(title: str, unit: str, lines: Mapping[str, Line], names: Mapping[str, str]) -> Table:
    rows = (
        (names.get(name, name), _number(line.floor), _number(line.takes), _number(line.ratio), _FLOORS.get(name, _NONE))
        for name, line in lines.items()
    )
    return make_table(title, ("", f"floor, {unit}", f"takes, {unit}", "ratio", "the floor"), rows, left=(0, 4))


def _pair_table(title: str, headings: tuple[str, str], pairs: Mapping[str, tuple[float | None, float | None]]) -> Table:
    """Two figures of the same each, and the first by the second."""
    rows = ((name, _number(a), _number(b), _number(_ratio(a, b))) for name, (a, b) in pairs.items())
    return make_table(title, ("", *headings, "ratio"), rows)


def _labelling_rows(labelling: LabellingTimes) -> Iterator[list[str]]:
    own = (float(np.median(labelling.takes_ms)), *_spread(labelling))
    yield ["this machine", f"{labelling.points:,.0f}", *(f"{figure:.1f}" for figure in own)]
    paper = PAPER_STATISTICS["milliseconds_per_cloud"]
    yield ["the paper", f"{PAPER_STATISTICS['points_in_cloud'][0]:,}", _NONE, *(f"{figure:.1f}" for figure in paper)]


def _spread(labelling: LabellingTimes) -> tuple[float, float, float, float]:
    """Mean, standard deviation, minimum and maximum."""
    took = labelling.takes_ms
    return float(took.mean()), float(took.std()), float(took.min()), float(took.max())


def _memory_runs(budget: Budget) -> dict[str, MeasuredRun]:
    once = {"the run": budget.run}
    return once if budget.repeated is None else {**once, f"{budget.repeated.times} times": budget.repeated.run}


def _memory_table(runs: Mapping[str, MeasuredRun]) -> Table:
    headings = ("", "all, MiB", *(f"quarter {part + 1}, MiB" for part in range(PARTS)))
    rows = ((name, *(f"{mib:.0f}" for mib in (run.peak_mib, *run.peaks_mib))) for name, run in runs.items())
    return make_table("Peak memory by time (proportional set sizes of all processes, summed)", headings, rows)


def _line_json(line: Line, unit: str) -> dict[str, float | None]:
    return {f"floor_{unit}": line.floor, f"takes_{unit}": line.takes, "ratio": line.ratio}


def _memory_json(run: MeasuredRun) -> dict[str, Any]:
    return {"peak_mib": run.peak_mib, "peak_by_quarter_mib": list(run.peaks_mib)}


def _run_json(run: MeasuredRun) -> dict[str, Any]:
    return {**{f"{name}_s": run.timings_s.get(name) for name in STAGES}, "whole_run_s": run.whole_s}


def _version_json(run: MeasuredRun) -> dict[str, Any]:
    memory = {"peak_memory_mib": run.peak_mib, "peak_memory_by_quarter_mib": list(run.peaks_mib)}
    labelling = {"labelling_per_scan_ms": run.labelling_ms}
    return {**_run_json(run), **labelling, **memory, "recording_mib": run.recording_bytes / 2**20}


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b


def _number(value: float | None) -> str:
    """Three digits that tell something."""
    if value is None:
        return _NONE
    return f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}" if abs(value) < 10 else f"{value:.1f}"
