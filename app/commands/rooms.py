"""`ffmap rooms`: segment any system's grid map into rooms, and compare with rooms drawn by hand."""

import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.maps.area_graph import (
    NO_DOORWAYS,
    AreaGraph,
    AreaGraphSettings,
    find_rooms,
)
from ffmap.algorithms.maps.grid import Cell, GridMap, coarsened
from ffmap.algorithms.truth.rooms import RoomFigures, compare_room_images, rooms_of_image
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.map_files import read_image, read_map
from ffmap.app.folder.names import METRICS, ROOMS, check_no_run_loses
from ffmap.app.folder.pictures import write_rooms_picture
from ffmap.app.folder.room_files import topology, write_rooms
from ffmap.app.own_command import view_command
from ffmap.app.setup.settings import load_settings
from ffmap.app.tables import make_table
from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import read_features, segments
from ffmap.loaders.text_files import read_json

CELLS_MAX = 8_000_000
"""Maps with more cells around their free space are coarsened: time and memory stay bounded."""
TOPOLOGY, PICTURE, RECORDING = "topology.json", "rooms.png", "rooms.rrd"
FILES = (TOPOLOGY, ROOMS, PICTURE, METRICS, RECORDING)
TRUTH_SUFFIX = "_gt_segmentation"
IMAGES = (".png", ".pgm")


@dataclass(frozen=True)
class _Options:
    """The user's options. read: files that must not be overwritten."""

    settings: AreaGraphSettings
    resolution: float | None
    out: Path | None
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
    options = _Options(settings, resolution, out, doorways, read)
    if path.is_dir():
        if truth is not None:
            raise InputError(
                "--truth: for one map; in a folder the truth of X.png is the longest fit of "
                f"Y{TRUTH_SUFFIX}.png"
            )
        _segment_folder(path, options)
        return
    out = out or Path("rooms") / path.stem
    graph, figures = _segment(path, out, truth, options)
    console = Console(highlight=False)
    console.print(_rooms_table(graph))
    if figures is not None:
        true, found, recall, precision, split, merged = _cells([figures])
        console.print(
            f"{found} rooms for {true} true ones: recall {recall} %, precision {precision} %; "
            f"{split} split, {merged} merged"
        )
    view = view_command(out / RECORDING)
    typer.echo(f"{out}: rooms.geojson, topology.json, rooms.png; look at it with: {view}")


def _segment(
    path: Path, out: Path, truth: Path | None, options: _Options
) -> tuple[AreaGraph, RoomFigures | None]:
    """Segment one map and write its files into `out`."""
    _check_out(out, path, options)
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
        # First: it names the map to which the other files belong.
        write_json(out / TOPOLOGY, {"map": str(path.resolve()), **topology(graph)})
        write_rooms(out / ROOMS, graph)
        write_rooms_picture(out / PICTURE, coarse, graph)
        if figures is not None:
            rooms = {f"rooms.{name}": value for name, value in _figures([figures]).items()}
            write_json(out / METRICS, rooms)
        write_recording(out / RECORDING, coarse, graph)
    except OSError as error:
        reason = f"cannot be written ({error.strerror})"
        raise InputError(f"{out}: {reason}; give another folder to --out") from error
    return graph, figures


def _check_out(out: Path, path: Path, options: _Options) -> None:
    """Raise InputError where a file would be replaced that is read, or is not this map's rooms.

    In a folder that the user named, rooms of another map are replaced.
    """
    read = {file.resolve() for file in (path, *options.read)}
    for file in (out / name for name in FILES):
        check_no_run_loses(file)
        if file.resolve() in read:
            raise InputError(
                f"{file}: is read, and would be replaced; give another folder to --out"
            )
    try:
        before = str(read_json(out / TOPOLOGY, "")["map"])
    except (InputError, LookupError, TypeError):
        before = None
    there = [out / name for name in FILES if (out / name).exists()]
    if there and before is None:
        raise InputError(
            f"{there[0]}: is there already, and not by 'ffmap rooms'; give another folder to --out"
        )
    if before not in (None, str(path.resolve())) and options.out is None:
        raise InputError(
            f"{out}: has the rooms of {before} already; give another folder to --out, or the "
            "same to replace them"
        )


def _segment_folder(folder: Path, options: _Options) -> None:
    """Segment every map that has its truth beside it; print figures and means by kind of map."""
    pairs = _pairs(folder)
    if not pairs:
        raise InputError(
            f"{folder}: no map has rooms beside it (as office_a.png has "
            f"office_a{TRUTH_SUFFIX}.png); give one map"
        )
    out = options.out or Path("rooms")
    rows: list[list[str]] = []
    failed: list[str] = []
    by_kind: dict[str, list[RoomFigures]] = defaultdict(list)
    for path, truth in pairs:
        try:
            _, figures = _segment(path, out / path.stem, truth, options)
        except InputError as error:
            failed.append(str(error))
        except Exception as error:
            reason = f"could not be segmented ({type(error).__name__}: {error})"
            failed.append(f"{path}: {reason}; leave it out, and report it")
        else:
            assert figures is not None
            kind = path.stem.removeprefix(truth.stem.removesuffix(TRUTH_SUFFIX))
            by_kind[kind].append(figures)
            rows.append([path.stem, *_cells([figures])])
    if not rows:
        raise InputError(failed[0])
    headings = ("map", "true", "found", "recall", "precision", "split", "merged")
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
    truths = {path.stem.removesuffix(TRUTH_SUFFIX): path for path in images if _is_truth(path)}
    pairs = []
    for path in images:
        fits = [name for name in truths if path.stem.startswith(name)]
        if fits and not _is_truth(path):
            pairs.append((path, truths[max(fits, key=len)]))
    return pairs


def _is_truth(path: Path) -> bool:
    return path.stem.endswith(TRUTH_SUFFIX)


def _figures(of_maps: Sequence[RoomFigures]) -> dict[str, float]:
    """Sum counts and average fractions over maps, named as in a run's metrics.json."""
    return {
        "true": sum(len(one.recall) for one in of_maps),
        "found": sum(len(one.precision) for one in of_maps),
        "recall": float(np.mean([one.mean_recall for one in of_maps])),
        "precision": float(np.mean([one.mean_precision for one in of_maps])),
        "split": sum(len(one.split) for one in of_maps),
        "merged": sum(len(one.merged) for one in of_maps),
    }


def _cells(of_maps: Sequence[RoomFigures]) -> list[str]:
    return [str(v) if isinstance(v, int) else f"{100 * v:.2f}" for v in _figures(of_maps).values()]


def _compare(
    path: Path, grid: GridMap, coarse: GridMap, graph: AreaGraph, truth: Path
) -> RoomFigures:
    true = rooms_of_image(read_image(truth)[::-1], grid.cell_m)
    rows, columns = grid.cells.shape
    if true.shape != grid.cells.shape:
        raise InputError(
            f"{truth}: has {true.shape[1]} × {true.shape[0]} pixels and {path} {columns} × {rows}; "
            "give the truth of this map"
        )
    return compare_room_images(
        true, _refined(graph.label, coarse, grid), grid.cells == Cell.FREE, grid.cell_m
    )


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


def _rooms_table(graph: AreaGraph) -> Table:
    rows = [
        (room.name, f"{room.area_m2:.1f}", ", ".join(graph.neighbours(index)) or "–")
        for index, room in enumerate(graph.rooms)
    ]
    title = f"{len(graph)} rooms, {len(graph.passages)} passages"
    return make_table(title, ("room", "m²", "leads to"), rows, left=(0, 2))
