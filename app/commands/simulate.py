"""ffmap simulate: a real bag of a generated building."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer
from pydantic import ValidationError

from ffmap.app.progress import Progress
from ffmap.app.setup.settings import parse_value
from ffmap.loaders.errors import InputError


def simulate(
    out: Path,
    building: str,
    seed: int,
    sensor: str,
    container: str,
    duration_s: float,
    overrides: Sequence[str],
    quiet: bool,
) -> None:
    """Simulate and say what came of it; raises InputError for a value that does not fit."""
    # Embree is loaded by nothing else.
    from ffmap.loaders.simulator import SimulationSettings
    from ffmap.loaders.simulator import simulate as write_bag

    values: dict[str, Any] = {
        "building": building,
        "seed": seed,
        "sensor": sensor,
        "format": container,
        "duration_s": duration_s,
    }
    for override in overrides:
        name, equals, text = override.partition("=")
        if not equals:
            raise InputError(f"--set {override}: write it as name=value, as in clutter=0.5")
        values[name.strip()] = parse_value(text.strip())
    try:
        settings = SimulationSettings.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            known = ", ".join(SimulationSettings.model_fields)
            raise InputError(f"simulate: there is no property {name!r}; the properties are {known}") from None
        meant = SimulationSettings.model_fields[name].description if name in SimulationSettings.model_fields else None
        raise InputError(
            f"simulate: {name} = {first['input']!r}: {first['msg']}"
            + (f" ({meant})" if meant else "")
            + "; give another value"
        ) from None
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
        typer.echo(f"{out}: {duration_s:.0f} s in building {building!r}, seed {seed}; run 'ffmap run {out}'")
