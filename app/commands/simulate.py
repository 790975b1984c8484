"""ffmap simulate: a real bag of a generated building."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from pydantic import ValidationError

from ffmap.app.progress import Progress
from ffmap.app.setup.settings import parse_value
from ffmap.loaders.errors import InputError

if TYPE_CHECKING:
    from ffmap.loaders.simulator import SimulationSettings


def simulate(out: Path, values: Mapping[str, Any], overrides: Sequence[str] = (), quiet: bool = True) -> None:
    """Simulate and say what came of it; raises InputError for a value that does not fit.

    values: properties of the simulation. overrides: more of them, as --set takes them.
    """
    # Embree is loaded by nothing else.
    from ffmap.loaders.simulator import simulate as write_bag

    settings = _settings(dict(values), overrides)
    with Progress(quiet) as progress:
        progress.stage("simulate", 100)
        done = 0

        def report(share: float) -> None:
            nonlocal done
            while done < int(100 * share):
                progress.advance()
                done += 1

        write_bag(out, settings, report)
    if not quiet:
        drive = f"{settings.duration_s:.0f} s in building {settings.building!r}, seed {settings.seed}"
        typer.echo(f"{out}: {drive}; run 'ffmap run {out}'")


def _settings(values: dict[str, Any], overrides: Sequence[str]) -> "SimulationSettings":
    from ffmap.loaders.simulator import SimulationSettings

    for override in overrides:
        name, equals, text = override.partition("=")
        if not equals:
            raise InputError(f"--set {override}: write it as name=value, as in clutter=0.5")
        # One dot at most: properties have no more levels.
        name, _, inner = name.strip().partition(".")
        value = parse_value(text.strip())
        said = values.get(name)
        values[name] = {**(said if isinstance(said, dict) else {}), inner: value} if inner else value
    try:
        return SimulationSettings.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
    name, known = ".".join(str(part) for part in first["loc"]), dict(SimulationSettings.model_fields)
    if first["loc"][0] == "drawn":
        known = {f"drawn.{own}": field for own, field in type(SimulationSettings().drawn).model_fields.items()}
    if first["type"] == "extra_forbidden":
        raise InputError(f"simulate: there is no property {name!r}; the properties are {', '.join(known)}")
    meant = f" ({known[name].description})" if name in known and known[name].description else ""
    raise InputError(f"simulate: {name} = {first['input']!r}: {first['msg']}{meant}; give another value")
