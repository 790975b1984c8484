"""Which run is better, in which figures, where, and which settings changed nothing: sentences."""

from collections.abc import Mapping

from ffmap.algorithms.truth.changes import SPOT_M, Became, Spot
from ffmap.app.analysis.comparison import Change, Comparison, RunToCompare
from ffmap.app.analysis.figures import FIGURES, HEADLINES
from ffmap.app.setup.settings import SCAN_LABELS, acts_on, decides_finally

JUDGED = tuple(name for name in HEADLINES if FIGURES[name].gain(0.0, 0.0) is not None)
"""The figures that decide which run is better, the most important one first."""
_NAMED = 4
"""Figures of each kind that are named."""
_FEW = 0.001
"""Share of changed labels below which settings count as without effect if no figure is known."""


def describe(comparison: Comparison) -> list[str]:
    """Describe each run against the first one, after the best of three or more."""
    lines = [" ".join(_sentences(change, comparison)) for change in comparison.changes]
    best = [_name(run) for run in best_runs(comparison)]
    if len(comparison.runs) > 2 and best:
        alike = "; no figure differs by more than its tolerance" if len(best) > 1 else ""
        lines.insert(0, f"Best: {', '.join(best)}{alike}.")
    return lines


def best_runs(comparison: Comparison) -> list[RunToCompare]:
    """Return the runs that are not worse than the best one, figure by figure in order of weight.

    Empty for runs of different bags, or if no figure is known of all.
    """
    known = [name for name in JUDGED if None not in comparison.figures.get(name, [None])]
    if not known or not all(change.same_bag for change in comparison.changes):
        return []
    best = list(range(len(comparison.runs)))
    for name in known:
        figure, values = FIGURES[name], comparison.figures[name]
        sign = 1 if figure.better == "higher" else -1
        top = max(sign * (values[run] or 0.0) for run in best)
        best = [run for run in best if not figure.gain(values[run], sign * top)]
    return [comparison.runs[run] for run in best]


def gains(change: Change, comparison: Comparison) -> dict[str, float]:
    """Return how much better the second run is by each known figure; 0 within the tolerance."""
    a, b = (comparison.runs.index(run) for run in (change.a, change.b))
    known = ((name, comparison.figures.get(name)) for name in JUDGED)
    found = {n: FIGURES[n].gain(values[a], values[b]) for n, values in known if values is not None}
    return {name: gain for name, gain in found.items() if gain is not None}


def _sentences(change: Change, comparison: Comparison) -> list[str]:
    """The verdict, where labels became right or wrong, and settings without effect."""
    a, b = _name(change.a), _name(change.b)
    if not change.same_bag:
        return [f"No verdict: {b} labelled another bag or other topics than {a}."]
    gained = gains(change, comparison)
    differing = [name for name, gain in gained.items() if gain]
    better = gained[differing[0]] > 0 if differing else None
    settings = _settings(change, comparison)
    same_labels = change.figures.get("labels.changed") == 0
    if better is not None:
        names = {side: [n for n in differing if (gained[n] > 0) == side] for side in (True, False)}
        texts = {side: _differences(own, change, comparison) for side, own in names.items()}
        word, other = ("better", "worse") if better else ("worse", "better")
        but = f"; {other}: {texts[not better]}" if texts[not better] else ""
        found = [f"{b} is {word} than {a}: {texts[better]}{but}."]
    elif same_labels:
        what = f"{', '.join(settings.values())} changed no final label"
        found = [f"{b} is as good as {a}: {what if settings else 'no final label changed'}."]
    elif gained:
        found = [f"{b} is as good as {a}: no figure differs by more than its tolerance."]
    else:
        judged = change.labels is not None and change.labels.judged is not None
        hint = "; 'ffmap evaluate RUN' computes them" if judged else ""
        found = [f"No verdict: {b} and {a} have no common figures against ground truth{hint}."]
    if change.labels is None:
        return found
    if better is not None or not same_labels:
        found += _labels(change.figures, change.labels.spots, better)
    in_scans = change.figures["labels.changed_scan"]
    if better is None and in_scans and (gained or change.figures["labels.changed_share"] < _FEW):
        scans = f"{in_scans:,} labels of single scans changed"
        found += [
            f"{name} acts on scan labels ({scans}); {decides_finally(name) or 'the building'} "
            "decides on final labels."
            for name in settings
            if acts_on(name) == SCAN_LABELS
        ]
    return found


def _settings(change: Change, comparison: Comparison) -> dict[str, str]:
    """Describe the settings that differ."""
    a, b = (comparison.runs.index(run) for run in (change.a, change.b))
    return {
        name: f"{name} ({values[a]} → {values[b]})"
        for name, values in comparison.settings.items()
        if values[a] != values[b] and acts_on(name) is not None
    }


def _differences(names: list[str], change: Change, comparison: Comparison) -> str:
    a, b = (comparison.runs.index(run) for run in (change.a, change.b))
    texts = []
    for name in names[:_NAMED]:
        figure, values = FIGURES[name], comparison.figures[name]
        unit = "" if figure.unit == "%" else figure.unit
        texts.append(f"{figure.title} {figure.difference(values[a], values[b])} {unit}".strip())
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(texts) + more


def _labels(
    figures: Mapping[str, float], spots: tuple[Spot | None, ...], better: bool | None
) -> list[str]:
    """How many labels changed, became right and wrong, and where most of them lie."""
    changed, share = figures["labels.changed"], figures["labels.changed_share"]
    if not changed:
        return ["No final label changed."]
    counts = f"{changed:,} final labels ({100 * share:.2f} %) changed"
    right, wrong = (figures.get(f"labels.became_{kind}") for kind in ("right", "wrong"))
    kind, what = Became.NEITHER, "changed"
    if right is not None and wrong is not None:
        counts += f": {right:,} became right, {wrong:,} wrong"
        if right or wrong:
            to_right = right > wrong if better is None else (better and right > 0) or not wrong
            kind, what = (Became.RIGHT, "right") if to_right else (Became.WRONG, "wrong")
            what = f"became {what}"
    spot = spots[kind]
    if spot is None:
        return [f"{counts}."]
    place = f"within {SPOT_M:g} m of ({spot.x_m:.1f}, {spot.y_m:.1f})"
    of = f"{100 * spot.share:.0f} % of the labels that {what}"
    return [f"{counts}.", f"{of} lie {place}, in scans {spot.first} to {spot.last}."]


def _name(run: RunToCompare) -> str:
    return f"{run.letter} ({run.run.path})"
