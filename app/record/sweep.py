"""sweep.rrd: what came of a sweep, drawn: quality against time with its front, every figure against every parameter.

The timeline `run` goes through the combinations; the one at the cursor is ringed in every panel, its settings and figures
stand beside it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from ffmap.algorithms.base.scan import FloatArray
from ffmap.app.folder import figures
from ffmap.app.folder.ranking import Ranking
from ffmap.blueprints import entities
from ffmap.blueprints import sweep as sweep_blueprint
from ffmap.blueprints.entities import Panel

_FIGURES_MAX = 4
"""Rows of panels: more would be too small to read."""
_TICKS = 4


@dataclass(frozen=True)
class Axis:
    """How the values of one quantity are spread over a panel's edge."""

    name: str
    low: float
    high: float
    ticks: tuple[float, ...]
    texts: tuple[str, ...]

    def place(self, values: FloatArray) -> FloatArray:
        """0 to 1 from the lowest to the highest; the middle where there is only one value."""
        if self.high <= self.low:
            return np.full(len(values), 0.5)
        return np.asarray((values - self.low) / (self.high - self.low))


def write_recording(path: Path, results: Ranking, failures: Sequence[str], bag: str) -> None:
    """Beside the runs, write the recording with its layout; `results` has at least one trial."""
    shown = _figures_shown(results)
    names = figures.short_names(results.parameters)
    panels = {
        names[parameter]: [
            (
                f"{entities.SWEEP_PARAMETERS}/{parameter.replace('.', '_')}/{name}",
                f"{name} against {names[parameter]}; line: mean",
            )
            for name in shown
        ]
        for parameter in results.parameters
    }
    title = f"{results.objective} against {results.cost}; green: best; orange: no other is better and faster"
    part = path.with_name(path.name + ".part")
    with rr.RecordingStream(entities.SWEEP_APPLICATION_ID) as stream:
        stream.save(part, default_blueprint=sweep_blueprint.build(panels, title, results.ranked[0]))
        stream.set_log_time_enabled(False)
        stream.send_recording_name(f"sweep of {bag}")
        _log_table(stream, results, failures, bag)
        numbers = {name: _figure_values(results, name) for name in {*shown, results.cost, results.objective}}
        _Drawing(stream, entities.SWEEP_FRONT, results).draw(
            numeric_axis(results.cost, numbers[results.cost]),
            numbers[results.cost],
            numeric_axis(results.objective, numbers[results.objective]),
            numbers[results.objective],
            front=True,
        )
        for parameter, heading in names.items():
            axis, values = parameter_axis(heading, [trial.combination[parameter] for trial in results.trials])
            for (panel, _), name in zip(panels[heading], shown, strict=True):
                drawing = _Drawing(stream, panel, results)
                drawing.draw(axis, values, numeric_axis(name, numbers[name]), numbers[name])
        for place in range(len(results.trials)):
            stream.set_time(entities.RUN_TIMELINE, sequence=place)
            text = rr.TextDocument(_describe(results, place, path.parent), media_type=rr.MediaType.MARKDOWN)
            stream.log(entities.SWEEP_RUN, text)
    part.replace(path)


def _figures_shown(results: Ranking) -> list[str]:
    """The objective, the time, then the figures that differ most between runs, as a share of their mean."""
    spread = {}
    for name in results.headlines:
        if name == figures.SECONDS != results.cost:
            continue
        values = _figure_values(results, name)
        known = values[np.isfinite(values)]
        spread[name] = np.ptp(known) / max(abs(known.mean()), 1e-9) if len(known) else 0.0
    others = sorted((name for name in spread if spread[name] > 0), key=lambda name: -spread[name])
    return list(dict.fromkeys([results.objective, results.cost, *others]))[:_FIGURES_MAX]


def _figure_values(results: Ranking, name: str) -> FloatArray:
    return np.array([trial.figures.get(name, math.nan) for trial in results.trials])


def numeric_axis(name: str, values: FloatArray) -> Axis:
    """Round numbers along the edge, about as many as can be read."""
    known = values[np.isfinite(values)]
    if not len(known):
        return Axis(name, 0.0, 0.0, (), ())
    low, high = float(known.min()), float(known.max())
    ticks = round_numbers(low, high)
    return Axis(name, low, high, ticks, tuple(figures.format_value(tick) for tick in ticks))


def parameter_axis(name: str, values: Sequence[Any]) -> tuple[Axis, FloatArray]:
    """Numbers as they are, each that was tried with a tick where they are few; anything else in turn."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        numbers = np.array(values, float)
        tried = np.unique(numbers)
        axis = numeric_axis(name, numbers)
        if len(tried) <= 2 * _TICKS:
            axis = Axis(name, axis.low, axis.high, tuple(tried), tuple(figures.format_value(v) for v in tried.tolist()))
        return axis, numbers
    kinds = sorted({str(value) for value in values})
    ticks = tuple(map(float, range(len(kinds))))
    return Axis(name, 0.0, ticks[-1], ticks, tuple(kinds)), np.array(
        [kinds.index(str(value)) for value in values], float
    )


def round_numbers(low: float, high: float) -> tuple[float, ...]:
    """Multiples of 1, 2 or 5 times a power of ten within [low, high]; the value itself where both are one."""
    if high <= low:
        return (low,)
    raw = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return tuple(round(i * step, 12) for i in range(first, math.floor(high / step + 1e-9) + 1)) or (low, high)


class _Drawing:
    """One panel: a frame with its ticks, a point for each run, and a ring around the one at the cursor."""

    def __init__(self, stream: rr.RecordingStream, path: str, results: Ranking) -> None:
        self._stream, self._path, self._results = stream, path, results

    def draw(self, x_axis: Axis, x: FloatArray, y_axis: Axis, y: FloatArray, front: bool = False) -> None:
        """x, y: (n,) of the trials; those with a NaN are left out. front: whether to join the front's trials by a line."""
        points = np.column_stack([_across(x_axis.place(x)), _upwards(y_axis.place(y))]).astype(np.float32)
        known = np.asarray(np.isfinite(points).all(axis=1))
        self._frame(x_axis, y_axis)
        ranked, on_front = self._results.ranked, set(self._results.front)
        colors = np.array(
            [
                entities.BEST_COLOR
                if place == ranked[0]
                else entities.FRONT_COLOR
                if place in on_front
                else entities.RUN_COLOR
                for place in range(len(points))
            ],
            np.uint8,
        )
        if front:
            self._line("front", points[list(self._results.front)], entities.FRONT_COLOR)
        else:
            places = np.unique(points[known, 0])
            means = [points[known & (points[:, 0] == place), 1].mean() for place in places]
            self._line("means", np.column_stack([places, means]), entities.MEAN_COLOR)
        names = figures.short_names(self._results.parameters)
        labels = [
            ", ".join(f"{names[name]} {figures.format_value(v)}" for name, v in trial.combination.items())
            for trial in self._results.trials
        ]
        self._stream.log(
            f"{self._path}/runs",
            rr.Points2D(
                points[known],
                colors=colors[known],
                radii=rr.Radius.ui_points(5.0),
                labels=[label for label, shown in zip(labels, known, strict=True) if shown],
                show_labels=False,
                draw_order=20.0,
            ),
            static=True,
        )
        for place, point in enumerate(points):
            self._stream.set_time(entities.RUN_TIMELINE, sequence=place)
            ring = _ring(point) if known[place] else np.zeros((0, 2))
            self._stream.log(
                f"{self._path}/cursor",
                rr.LineStrips2D([ring], colors=(255, 255, 255), radii=rr.Radius.ui_points(1.5), draw_order=30.0),
            )

    def _line(self, name: str, points: FloatArray, color: entities.Color) -> None:
        self._stream.log(
            f"{self._path}/{name}",
            rr.LineStrips2D([points], colors=color, radii=rr.Radius.ui_points(1.5), draw_order=10.0),
            static=True,
        )

    def _frame(self, x_axis: Axis, y_axis: Axis) -> None:
        x = _across(x_axis.place(np.array(x_axis.ticks)))
        y = _upwards(y_axis.place(np.array(y_axis.ticks)))
        lines = [
            *(np.array([[at, 0], [at, Panel.HEIGHT]]) for at in x),
            *(np.array([[0, at], [Panel.WIDTH, at]]) for at in y),
            np.array([[0, 0], [Panel.WIDTH, 0], [Panel.WIDTH, Panel.HEIGHT], [0, Panel.HEIGHT], [0, 0]]),
        ]
        self._stream.log(
            f"{self._path}/frame",
            rr.LineStrips2D(lines, colors=entities.FRAME_COLOR, radii=rr.Radius.ui_points(0.5), draw_order=0.0),
            static=True,
        )
        places = [
            *((at, Panel.HEIGHT + 2) for at in x),
            *((-0.55 * Panel.MARGIN_LEFT, at - 12) for at in y),
            (Panel.WIDTH / 2, Panel.HEIGHT + 28),
        ]
        self._stream.log(
            f"{self._path}/texts",
            rr.Points2D(
                places,
                labels=[*x_axis.texts, *y_axis.texts, x_axis.name],
                show_labels=True,
                colors=entities.TEXT_COLOR,
                radii=0.0,
            ),
            static=True,
        )


def _across(share: FloatArray) -> FloatArray:
    return np.asarray(Panel.INSET + share * (Panel.WIDTH - 2 * Panel.INSET))


def _upwards(share: FloatArray) -> FloatArray:
    return np.asarray(Panel.HEIGHT - Panel.INSET - share * (Panel.HEIGHT - 2 * Panel.INSET))


def _ring(centre: FloatArray) -> FloatArray:
    angle = np.linspace(0, 2 * np.pi, 25)
    return np.asarray(centre + 11.0 * np.column_stack([np.cos(angle), np.sin(angle)]))


def _log_table(stream: rr.RecordingStream, results: Ranking, failures: Sequence[str], bag: str) -> None:
    shown = results.headlines
    names = figures.short_names(results.parameters)
    rows = [["", *names.values(), *shown, "run"], ["---"] * (len(names) + len(shown) + 2)]
    for place in results.ranked:
        trial = results.trials[place]
        values = [trial.combination[name] for name in names] + [trial.figures.get(name) for name in shown]
        mark = "●" if place in results.front else ""
        rows.append([mark, *map(figures.format_value, values), ", ".join(trial.names)])
    failed = [f"- {failure}" for failure in failures]
    text = [
        f"# Sweep of {bag}",
        f"{len(results.trials)} settings, best by `{results.objective}` first. ● no other is better and faster.",
        "",
        *("| " + " | ".join(row) + " |" for row in rows),
        *(["", "## Failed", *failed] if failed else []),
    ]
    stream.log(entities.SWEEP_TABLE, rr.TextDocument("\n".join(text), media_type=rr.MediaType.MARKDOWN), static=True)


def _describe(results: Ranking, place: int, folder: Path) -> str:
    trial = results.trials[place]
    rank = results.ranked.index(place) + 1
    lines = [
        f"# Run {place}",
        f"Rank {rank} of {len(results.trials)} by `{results.objective}`"
        + (", on the front: no other is better and faster." if place in results.front else "."),
        "",
        "| setting | value |",
        "|---|---|",
        *(f"| {name} | **{figures.format_value(value)}** |" for name, value in trial.combination.items()),
        "",
        "| figure | value |",
        "|---|---|",
        *(f"| {name} | {figures.format_value(trial.figures.get(name))} |" for name in results.headlines),
        "",
        *(f"`ffmap view {folder / name}`" for name in trial.names),
    ]
    return "\n".join(lines)
