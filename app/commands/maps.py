"""ffmap maps: a run's grid maps against any map of the same building."""

from pathlib import Path

import typer
from rich.console import Console

from ffmap.algorithms.truth.maps import ComparedMap, ComparedMaps
from ffmap.algorithms.truth.reference import align_maps, compare_with_reference, unseen_walls
from ffmap.app.analysis import map_figures
from ffmap.app.folder import names
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.map_files import read_map
from ffmap.blueprints import entities
from ffmap.loaders.errors import InputError


def maps(run_dir: Path, reference_path: Path) -> None:
    """Align the run's maps with the reference, compare, write the picture, the figures and the layer, print the table.

    Raises InputError where the run has no maps or cannot be written, the reference is none, or it shows another building.
    """
    record = names.RunFolder(run_dir).read_json()
    names.require_writable(run_dir, "the comparison is written there: change its permissions, or compare a copy")
    own = map_figures.read_maps(run_dir)
    if entities.FURNITURE_FREE not in own:
        raise InputError(f"{run_dir}: holds no {names.map_file(entities.FURNITURE_FREE)} to compare; run ffmap again")
    reference = read_map(reference_path)
    known = own[entities.FURNITURE_FREE]
    alignment = align_maps(known, reference)
    if not alignment.fits:
        raise InputError(
            f"{reference_path}: does not fit: at best {100 * max(alignment.share, 0):.0f} % of the map's walls lie on "
            "walls of the reference; give a map of the same building, at its true resolution"
        )
    unseen = unseen_walls(known, reference, alignment)
    compared = {
        name: ComparedMap(grid, compare_with_reference(grid, known, reference, alignment), unseen)
        for name, grid in own.items()
    }
    metrics = map_figures.map_metrics(compared)
    names.check_same_run(names.RunFolder(run_dir), record)
    content = {
        "reference": str(reference_path.resolve()),
        "T_reference_map": alignment.T_reference_map,
        "share_within_10_cm": alignment.share,
        "maps": metrics,
    }
    write_json(run_dir / names.REFERENCE_JSON, content)
    map_figures.write_overlays(
        run_dir / names.REFERENCE_OVERLAY, compared, "reference", map_figures.walls_direction_deg(run_dir)
    )
    Console().print(map_figures.maps_table(metrics, f"Grid maps against {reference_path.name} (Fig. 9)"))
    x, y = alignment.shift_m
    typer.echo(
        f"aligned:   turned by {alignment.turn_deg:.2f}°, the map's origin at ({x:.2f}, {y:.2f}) m of the reference"
    )
    typer.echo(f"overlay:   {run_dir / names.REFERENCE_OVERLAY}")
    if "recording_id" in record and (run_dir / names.RECORDING).exists():
        _write_layer(run_dir / names.REFERENCE_RECORDING, record["recording_id"], compared)
        typer.echo(f"recording: ffmap view {run_dir / names.REFERENCE_RECORDING} {run_dir / names.RECORDING}")


def _write_layer(out: Path, recording_id: str, compared: ComparedMaps) -> None:
    # Rerun is not needed where a run has no recording.
    from ffmap.app.record.errors import log_overlay
    from ffmap.app.record.log import open_log
    from ffmap.blueprints import maps as maps_blueprint
    from ffmap.blueprints.run import view_of

    layout = maps_blueprint.build(*view_of(compared[entities.FURNITURE_FREE].grid))
    with open_log(out, recording_id, layout=layout) as log:
        for name, one in compared.items():
            log_overlay(log, name, one)
