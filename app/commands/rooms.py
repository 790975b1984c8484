"""ffmap rooms: segment any grid map into rooms, and compare them with rooms drawn by hand."""

import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer
from rich.console import Console

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.maps.area_graph import (
    NO_DOORWAYS,
    AreaGraph,
    AreaGraphSettings,
    find_rooms,
)
from ffmap.algorithms.maps.grid import Cell, GridMap, coarsened
from ffmap.algorithms.truth.rooms import compare_room_images, rooms_of_image
from ffmap.app.analysis.figures import OF_ROOMS, Metrics, figures_of_rooms
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.map_files import read_image, read_map
from ffmap.app.folder.names import METRICS, ROOMS, ROOMS_OSM, check_no_run_loses
from ffmap.app.folder.osm_file import write_osm
from ffmap.app.folder.pictures import write_rooms_picture
from ffmap.app.folder.room_files import topology, write_rooms
from ffmap.app.own_command import view_command
from ffmap.app.setup.settings import load_settings
from ffmap.app.tables import make_table
from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import read_features, segments
from ffmap.loaders.text_files import read_object

CELLS_MAX = 8_000_000
"""Maps with more cells around their free space are coarsened: time and memory stay bounded."""
TOPOLOGY, PICTURE, RECORDING = "topology.json", "rooms.png", "rooms.rrd"
FILES = (TOPOLOGY, ROOMS, ROOMS_OSM, PICTURE, METRICS, RECORDING)
TRUTH_SUFFIX = "_gt_segmentation"
IMAGES = (".png", ".pgm")
_SHOWN = ("true", "found", "recall", "precision", "split", "merged")


@dataclass(frozen=True)
class _Options:
    """The user's options for all maps. read: files that must not be overwritten."""

    settings: AreaGraphSettings
    resolution: float | None
    doorways: FloatArray
    read: tuple[Path, ...]


def rooms(
    path: Path,
    resolution: float | None = None,
    out: Path | None = None,
    truth: Path | None = None,
    doors: Path | None = None,
    config: Path | None = None,
    overrides: Sequence[str] = (),
) -> None:
    """Segment a map, or every map of a folder that has its truth beside it; write and print."""
    settings = load_settings(config, overrides).area_graph
    read = tuple(file for file in (truth, doors, config) if file is not None)
    doorways = NO_DOORWAYS if doors is None else _doorways(doors)
    options = _Options(settings, resolution, doorways, read)
    if path.is_dir():
        if truth is not None:
            raise InputError(
                "--truth: for one map; in a folder the truth of X.png is the longest fit of "
                f"Y{TRUTH_SUFFIX}.png"
            )
        _segment_folder(path, out or Path("rooms"), options)
        return
    if out is None:
        out = Path("rooms") / path.stem
        if (before := _mapped(out)) not in (None, str(path.resolve())):
            raise InputError(
                f"{out}: has the rooms of {before} already; give another folder to --out, or the "
                "same to replace them"
            )
    graph, figures = _segment(path, out, truth, options)
    rows = [
        (room.name, f"{room.area_m2:.1f}", ", ".join(graph.neighbours(index)) or "–")
        for index, room in enumerate(graph.rooms)
    ]
    title = f"{len(graph)} rooms, {len(graph.passages)} passages"
    Console(highlight=False).print(make_table(title, ("room", "m²", "leads to"), rows, left=(0, 2)))
    if figures is not None:
        true, found, recall, precision, split, merged = _cells([figures])
        typer.echo(
            f"{found} rooms for {true} true ones: recall {recall} %, precision {precision} %; "
            f"{split} split, {merged} merged"
        )
    view = view_command(out / RECORDING)
    typer.echo(f"{out}: {ROOMS}, {ROOMS_OSM}, {TOPOLOGY}, {PICTURE}; look at it with: {view}")


def _segment(
    path: Path, out: Path, truth: Path | None, options: _Options
) -> tuple[AreaGraph, Metrics | None]:
    """Segment one map and write its files into `out`; return its rooms, and figures with truth."""
    _check_out(out, {path, *options.read})
    grid = read_map(path, options.resolution)
    if not (grid.cells == Cell.FREE).any():
        raise InputError(
            f"{path}: the map has no free cell; free is white (over 250) in an image, and below "
            "free_thresh with a YAML file"
        )
    coarse = coarsened(grid, CELLS_MAX)
    if coarse.cell_m > grid.cell_m:
        rows, columns = grid.cells.shape
        size = f"{columns} × {rows} cells are many; segmented with cells of {coarse.cell_m:g} m"
        typer.echo(f"{path}: {size}", err=True)
    graph = find_rooms(coarse, options.settings, options.doorways)
    if not len(graph):
        raise InputError(
            f"{path}: no room has {options.settings.room_min_m2:g} m² or more with pixels of "
            f"{grid.cell_m:g} m; is the resolution right? see --set area_graph.room_min_m2"
        )
    figures = None if truth is None else _compare(path, grid, coarse, graph, truth)
    # Imported here: Rerun takes a second to load, and wrong input is reported before.
    from ffmap.app.record.rooms import write_recording

    try:
        out.mkdir(parents=True, exist_ok=True)
        # First: its "map" marks the other files as those of this command.
        write_json(out / TOPOLOGY, {"map": str(path.resolve()), **topology(graph)})
        write_rooms(out / ROOMS, graph)
        write_osm(out / ROOMS_OSM, graph)
        write_rooms_picture(out / PICTURE, coarse, graph)
        if figures is not None:
            write_json(out / METRICS, {f"rooms.{name}": figures[name] for name in _SHOWN})
        write_recording(out / RECORDING, coarse, graph)
    except OSError as error:
        reason = f"cannot be written ({error.strerror})"
        raise InputError(f"{out}: {reason}; give another folder to --out") from error
    return graph, figures


def _check_out(out: Path, read: set[Path]) -> None:
    """Raise InputError where a file would be replaced that is read, or is not of this command."""
    read = {file.resolve() for file in read}
    ours = _mapped(out) is not None
    for file in (out / name for name in FILES):
        check_no_run_loses(file)
        if file.resolve() in read:
            raise InputError(
                f"{file}: is read, and would be replaced; give another folder to --out"
            )
        if file.exists() and not ours:
            raise InputError(
                f"{file}: is there already, and not by 'ffmap rooms'; give another folder to --out"
            )


def _mapped(out: Path) -> str | None:
    """Return the map whose rooms a folder has."""
    try:
        return str(read_object(out / TOPOLOGY, "")["map"])
    except (InputError, LookupError):
        return None


def _segment_folder(folder: Path, out: Path, options: _Options) -> None:
    """Segment every map that has its truth beside it; print figures and means by kind of map."""
    pairs = _pairs(folder)
    if not pairs:
        raise InputError(
            f"{folder}: no map has rooms beside it (as office_a.png has "
            f"office_a{TRUTH_SUFFIX}.png); give one map"
        )
    rows: list[list[str]] = []
    failed: list[str] = []
    by_kind: dict[str, list[Metrics]] = defaultdict(list)
    for path, truth in pairs:
        try:
            _, figures = _segment(path, out / path.stem, truth, options)
        except InputError as error:
            failed.append(str(error))
            continue
        except Exception as error:
            # One map of many must not end the others.
            reason = f"could not be segmented ({type(error).__name__}: {error})"
            failed.append(f"{path}: {reason}; leave it out, and report it")
            continue
        assert figures is not None
        kind = path.stem.removeprefix(truth.stem.removesuffix(TRUTH_SUFFIX))
        by_kind[kind].append(figures)
        rows.append([path.stem, *_cells([figures])])
    if not rows:
        raise InputError(failed[0])
    headings = ("map", *(OF_ROOMS[name].title for name in _SHOWN))
    table = make_table("Rooms against those drawn by hand, percent", headings, rows)
    table.add_section()
    for kind, many in by_kind.items():
        table.add_row(f"mean of {len(many)} {kind.strip('_ ') or 'plain'}", *_cells(many))
    Console(highlight=False).print(table)
    for line in failed:
        typer.echo(f"ffmap: {line}", err=True)
    if failed:
        sys.exit(2)


def _pairs(folder: Path) -> list[tuple[Path, Path]]:
    """Pair each map with the truth whose name is the longest beginning of its own."""
    images = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGES)
    truths = [path for path in images if path.stem.endswith(TRUTH_SUFFIX)]
    pairs = []
    for path in images:
        fits = [
            truth for truth in truths if path.stem.startswith(truth.stem.removesuffix(TRUTH_SUFFIX))
        ]
        if fits and path not in truths:
            pairs.append((path, max(fits, key=lambda truth: len(truth.stem))))
    return pairs


def _cells(of_maps: Sequence[Metrics]) -> list[str]:
    """Format figures summed over maps if they are counts, averaged if they are fractions."""
    cells = []
    for name in _SHOWN:
        values = [float(figures[name]) for figures in of_maps]
        cells.append(OF_ROOMS[name].text(sum(values) / (len(values) if OF_ROOMS[name].unit else 1)))
    return cells


def _compare(path: Path, grid: GridMap, coarse: GridMap, graph: AreaGraph, truth: Path) -> Metrics:
    true = rooms_of_image(read_image(truth)[::-1], grid.cell_m)
    rows, columns = grid.cells.shape
    if true.shape != grid.cells.shape:
        raise InputError(
            f"{truth}: has {true.shape[1]} × {true.shape[0]} pixels and {path} {columns} × {rows}; "
            "give the truth of this map"
        )
    found = _refined(graph.label, coarse, grid)
    return figures_of_rooms(compare_room_images(true, found, grid.cells == Cell.FREE, grid.cell_m))


def _refined(label: IntArray, coarse: GridMap, grid: GridMap) -> IntArray:
    """Return a coarsened grid's labels in the cells of the grid itself."""
    factor = round(coarse.cell_m / grid.cell_m)
    column, row = np.rint((coarse.origin - grid.origin) / grid.cell_m).astype(int)
    whole = np.full(grid.cells.shape, -1, np.int32)
    part = whole[row : row + factor * label.shape[0], column : column + factor * label.shape[1]]
    part[:] = label.repeat(factor, axis=0).repeat(factor, axis=1)[: part.shape[0], : part.shape[1]]
    return whole


def _doorways(path: Path) -> FloatArray:
    """Read the sills of a doors.geojson, as doorways without depth."""
    sills = segments(read_features(path, "lines", "give a run's doors.geojson"))
    return np.concatenate([sills, sills[:, ::-1]], axis=1)
