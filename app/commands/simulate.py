"""ffmap simulate: a bag of a generated building, with its ground truth."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from pydantic import ValidationError

from ffmap.app.own_command import pip_command
from ffmap.app.progress import Progress
from ffmap.app.setup.settings import parse_value
from ffmap.loaders.errors import InputError

if TYPE_CHECKING:
    from ffmap.loaders.simulator import SimulationSettings

_PACKAGES = "trimesh", "embreex"
"""Installed with the extra `simulate`: real bags are mapped without them."""


def simulate(
    out: Path, values: Mapping[str, Any], overrides: Sequence[str] = (), quiet: bool = True
) -> None:
    """Simulate a drive and print the command that maps it.

    overrides: further settings, as --set takes them.
    Raises InputError for a wrong setting, and where a package is missing.
    """
    if missing := [name for name in _PACKAGES if find_spec(name) is None]:
        names = " and ".join(missing)
        command = pip_command(" ".join(missing))
        raise InputError(f"simulated drives require {names}; install with '{command}'")
    # Only this command loads Embree.
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
        drive = f"{settings.duration_s:g} s in building {settings.building!r}"
        typer.echo(f"{out}: {drive}, seed {settings.seed}; run 'ffmap run {out}'")


def _settings(values: dict[str, Any], overrides: Sequence[str]) -> "SimulationSettings":
    from ffmap.loaders.simulator import SimulationSettings

    for override in overrides:
        name, equals, text = override.partition("=")
        if not equals:
            raise InputError(f"--set {override}: write it as name=value, as in clutter=0.5")
        values[name.strip()] = parse_value(text.strip())
    known = SimulationSettings.model_fields
    for name in values:
        if name not in known:
            names = ", ".join(known)
            raise InputError(f"simulate: there is no setting {name!r}; the settings are {names}")
    try:
        return SimulationSettings.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0]) if first["loc"] else "settings"
        given = f" = {values[name]!r}" if name in values else ""
        raise InputError(f"simulate: {name}{given}: {first['msg']}; give another value") from None
