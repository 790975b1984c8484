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
from ffmap.app.folder.atomic import written_whole
from ffmap.app.folder.ranking import Ranking
from ffmap.app.record.log import Log
from ffmap.app.record.shapes import markdown, strips_2d, table, ui_radius, words
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
    numbers = {name: _figure_values(results, name) for name in {*shown, results.cost, results.objective}}
    axes = {name: numeric_axis(name, values) for name, values in numbers.items()}
    with written_whole(path) as part, rr.RecordingStream(entities.SWEEP_APPLICATION_ID) as stream:
        stream.save(part, default_blueprint=sweep_blueprint.build(panels, title, results.ranked[0]))
        stream.set_log_time_enabled(False)
        stream.send_recording_name(f"sweep of {bag}")
        log = Log(stream)
        log.text(entities.SWEEP_TABLE, _table(results, failures, bag))
        drawing, cost, objective = _Drawing(log, results), results.cost, results.objective
        drawing.draw(entities.SWEEP_FRONT, axes[cost], numbers[cost], axes[objective], numbers[objective], front=True)
        for parameter, heading in names.items():
            axis, values = parameter_axis(heading, [trial.combination[parameter] for trial in results.trials])
            for (panel, _), name in zip(panels[heading], shown, strict=True):
                drawing.draw(panel, axis, values, axes[name], numbers[name])
        for place in range(len(results.trials)):
            stream.set_time(entities.RUN_TIMELINE, sequence=place)
            log.now(entities.SWEEP_RUN, markdown(_describe(results, place, path.parent)))


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
    places = np.array([kinds.index(str(value)) for value in values], float)
    return Axis(name, 0.0, ticks[-1], ticks, tuple(kinds)), places


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
    """Panels, each a frame with its ticks, a point for each run, and a ring around the one at the cursor."""

    def __init__(self, log: Log, results: Ranking) -> None:
        self._log, self._results = log, results
        self._colors = np.full((len(results.trials), 3), entities.RUN_COLOR, np.uint8)
        self._colors[list(results.front)] = entities.FRONT_COLOR
        self._colors[results.ranked[0]] = entities.BEST_COLOR
        names = figures.short_names(results.parameters)
        self._labels = [
            ", ".join(f"{names[name]} {figures.format_value(v)}" for name, v in trial.combination.items())
            for trial in results.trials
        ]

    def draw(self, path: str, x_axis: Axis, x: FloatArray, y_axis: Axis, y: FloatArray, front: bool = False) -> None:
        """x, y: (n,) of the trials; those with a NaN are left out. front: whether to join the front's trials by a line."""
        points = np.column_stack([_across(x_axis.place(x)), _upwards(y_axis.place(y))]).astype(np.float32)
        known = np.asarray(np.isfinite(points).all(axis=1))
        self._frame(path, x_axis, y_axis)
        if front:
            line = points[list(self._results.front)]
            self._log.static(f"{path}/front", strips_2d([line], entities.FRONT_COLOR, 1.5, 10.0))
        else:
            places = np.unique(points[known, 0])
            means = [points[known & (points[:, 0] == place), 1].mean() for place in places]
            line = np.column_stack([places, means])
            self._log.static(f"{path}/means", strips_2d([line], entities.MEAN_COLOR, 1.5, 10.0))
        self._log.static(
            f"{path}/runs",
            rr.Points2D(
                points[known],
                colors=self._colors[known],
                radii=ui_radius(5.0),
                labels=[self._labels[place] for place in np.flatnonzero(known)],
                show_labels=False,
                draw_order=20.0,
            ),
        )
        for place, point in enumerate(points):
            self._log.stream.set_time(entities.RUN_TIMELINE, sequence=place)
            ring = _ring(point) if known[place] else np.zeros((0, 2))
            self._log.now(f"{path}/cursor", strips_2d([ring], (255, 255, 255), 1.5, 30.0))

    def _frame(self, path: str, x_axis: Axis, y_axis: Axis) -> None:
        x = _across(x_axis.place(np.array(x_axis.ticks)))
        y = _upwards(y_axis.place(np.array(y_axis.ticks)))
        lines = [
            *(np.array([[at, 0], [at, Panel.HEIGHT]]) for at in x),
            *(np.array([[0, at], [Panel.WIDTH, at]]) for at in y),
            np.array([[0, 0], [Panel.WIDTH, 0], [Panel.WIDTH, Panel.HEIGHT], [0, Panel.HEIGHT], [0, 0]]),
        ]
        self._log.static(f"{path}/frame", strips_2d(lines, entities.FRAME_COLOR, 0.5, 0.0))
        places = [
            *((at, Panel.HEIGHT + 2) for at in x),
            *((-0.55 * Panel.MARGIN_LEFT, at - 12) for at in y),
            (Panel.WIDTH / 2, Panel.HEIGHT + 28),
        ]
        self._log.static(f"{path}/texts", words(places, [*x_axis.texts, *y_axis.texts, x_axis.name]))


def _across(share: FloatArray) -> FloatArray:
    return np.asarray(Panel.INSET + share * (Panel.WIDTH - 2 * Panel.INSET))


def _upwards(share: FloatArray) -> FloatArray:
    return np.asarray(Panel.HEIGHT - Panel.INSET - share * (Panel.HEIGHT - 2 * Panel.INSET))


def _ring(centre: FloatArray) -> FloatArray:
    angle = np.linspace(0, 2 * np.pi, 25)
    return np.asarray(centre + 11.0 * np.column_stack([np.cos(angle), np.sin(angle)]))


def _table(results: Ranking, failures: Sequence[str], bag: str) -> str:
    shown, names = results.headlines, figures.short_names(results.parameters)
    rows = []
    for place in results.ranked:
        trial = results.trials[place]
        values = [trial.combination[name] for name in names] + [trial.figures.get(name) for name in shown]
        mark = "●" if place in results.front else ""
        rows.append([mark, *map(figures.format_value, values), ", ".join(trial.names)])
    text = [
        f"# Sweep of {bag}",
        f"{len(results.trials)} settings, best by `{results.objective}` first. ● no other is better and faster.",
        "",
        table(["", *names.values(), *shown, "run"], rows),
        *(["", "## Failed", *(f"- {failure}" for failure in failures)] if failures else []),
    ]
    return "\n".join(text)


def _describe(results: Ranking, place: int, folder: Path) -> str:
    trial = results.trials[place]
    on_front = ", on the front: no other is better and faster." if place in results.front else "."
    lines = [
        f"# Run {place}",
        f"Rank {results.ranked.index(place) + 1} of {len(results.trials)} by `{results.objective}`{on_front}",
        "",
        table(("setting", "value"), ((k, f"**{figures.format_value(v)}**") for k, v in trial.combination.items())),
        "",
        table(("figure", "value"), ((k, figures.format_value(trial.figures.get(k))) for k in results.headlines)),
        "",
        *(f"`ffmap view {folder / name}`" for name in trial.names),
    ]
    return "\n".join(lines)
