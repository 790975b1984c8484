"""`ffmap rooms`: rooms of any system's grid map, and how well they meet rooms drawn by hand."""

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
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
    coarsened,
    find_rooms,
)
from ffmap.algorithms.maps.grid import Cell, GridMap
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
"""A map with more cells around its free space is segmented with larger ones: time and memory stay bounded."""
TOPOLOGY = "topology.json"
PICTURE = "rooms.png"
RECORDING = "rooms.rrd"
FILES = (TOPOLOGY, ROOMS, PICTURE, METRICS, RECORDING)
TRUTH_SUFFIX = "_gt_segmentation"
IMAGES = (".png", ".pgm")

RecordingWriter = Callable[[Path, AreaGraph], None]


@dataclass(frozen=True)
class _Segmenter:
    """How maps are segmented.

    out: the folder that the user named. read: other files of the user's that are read.
    """

    settings: AreaGraphSettings
    resolution: float | None
    out: Path | None
    doors: Path | None
    read: tuple[Path, ...]

    def __call__(
        self, path: Path, out: Path, truth: Path | None
    ) -> tuple[AreaGraph, RoomFigures | None]:
        """Segment one map and write its files into `out`."""
        self._check_out(out, path)
        grid = read_map(path, self.resolution)
        if not (grid.cells == Cell.FREE).any():
            raise InputError(
                f"{path}: the map has no free cell; free is white (over 250) in an image, and what "
                "a YAML file's own free_thresh says"
            )
        doorways = _doorways(self.doors) if self.doors is not None else NO_DOORWAYS
        coarse = coarsened(grid, CELLS_MAX)
        if coarse.cell_m > grid.cell_m:
            typer.echo(
                f"{path}: {grid.cells.shape[1]} × {grid.cells.shape[0]} cells are many; "
                f"segmented with cells of {coarse.cell_m:g} m",
                err=True,
            )
        with ThreadPoolExecutor(1) as beside:
            # Rerun takes as long to load as a large map to segment, which mostly leaves the
            # interpreter to others.
            recording = beside.submit(_prepare_recording, coarse)
            graph = find_rooms(coarse, self.settings, doorways)
        if not len(graph):
            raise InputError(
                f"{path}: no room has {self.settings.room_min_m2:g} m² or more with pixels of "
                f"{grid.cell_m:g} m; is the resolution right? see --set area_graph.room_min_m2"
            )
        figures = None if truth is None else _compare(path, grid, coarse, graph, truth)
        _write(out, path, coarse, graph, figures, recording.result())
        return graph, figures

    def _check_out(self, out: Path, path: Path) -> None:
        """Check that no file would be replaced that is read, or not of the rooms of this map.

        A folder that the user named may have the rooms of another map; one that the program chose
        may not.
        """
        written = [out / name for name in FILES]
        read = {file.resolve() for file in (path, *self.read)}
        for file in written:
            check_no_run_loses(file)
            if file.resolve() in read:
                raise InputError(
                    f"{file}: is read, and would be replaced; give another folder to --out"
                )
        there = [file for file in written if file.exists()]
        before = _map_of(out)
        if there and before is None:
            raise InputError(
                f"{there[0]}: is there already, and not by 'ffmap rooms'; give another folder "
                "to --out"
            )
        if before is not None and before != str(path.resolve()) and self.out is None:
            raise InputError(
                f"{out}: has the rooms of {before} already; give another folder to --out, or the "
                "same to replace them"
            )


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
    read = tuple(file for file in (truth, doors, config) if file is not None)
    settings = load_settings(config, overrides).area_graph
    segment = _Segmenter(settings, resolution, out, doors, read)
    if path.is_dir():
        if truth is not None:
            raise InputError(
                "--truth: for one map; in a folder the truth of X.png is the longest fit of "
                f"Y{TRUTH_SUFFIX}.png"
            )
        _segment_folder(path, segment)
        return
    out = out or Path("rooms") / path.stem
    graph, figures = segment(path, out, truth)
    console = Console(highlight=False)
    console.print(_rooms_table(graph))
    if figures is not None:
        console.print(_truth_line(figures))
    typer.echo(f"{out}: rooms.geojson, topology.json, rooms.png; look at it with: {view_command(out / RECORDING)}")


def _segment_folder(folder: Path, segment: _Segmenter) -> None:
    """Every map that has rooms drawn by hand beside it, and the mean of each kind of maps."""
    pairs = _pairs(folder)
    if not pairs:
        raise InputError(
            f"{folder}: no map has rooms beside it (as office_a.png has "
            f"office_a{TRUTH_SUFFIX}.png); give one map"
        )
    out = segment.out or Path("rooms")
    rows: list[list[str]] = []
    failed: list[str] = []
    by_kind: dict[str, list[RoomFigures]] = {}
    for path, truth in pairs:
        try:
            _, figures = segment(path, out / path.stem, truth)
        except InputError as error:
            failed.append(str(error))
            continue
        except Exception as error:
            failed.append(f"{path}: could not be segmented ({type(error).__name__}: {error}); leave it out, and report it")
            continue
        assert figures is not None
        by_kind.setdefault(path.stem.removeprefix(truth.stem.removesuffix(TRUTH_SUFFIX)), []).append(figures)
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
    images = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGES)
    truths = [path for path in images if path.stem.endswith(TRUTH_SUFFIX)]
    pairs = []
    for path in images:
        fits = [truth for truth in truths if path.stem.startswith(truth.stem.removesuffix(TRUTH_SUFFIX))]
        if path not in truths and fits:
            pairs.append((path, max(fits, key=lambda truth: len(truth.stem))))
    return pairs


def _map_of(out: Path) -> str | None:
    """Which map's rooms a folder has; None where it has none."""
    try:
        return str(read_json(out / TOPOLOGY, "")["map"])
    except (InputError, LookupError, TypeError):
        return None


def _prepare_recording(grid: GridMap) -> RecordingWriter:
    from ffmap.app.record.rooms import prepare_recording

    return prepare_recording(grid)


def _write(
    out: Path,
    path: Path,
    grid: GridMap,
    graph: AreaGraph,
    figures: RoomFigures | None,
    write_recording: RecordingWriter,
) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        # First: it says whose the others are.
        write_json(out / TOPOLOGY, {"map": str(path.resolve()), **topology(graph)})
        write_rooms(out / ROOMS, graph)
        write_rooms_picture(out / PICTURE, grid, graph)
        if figures is not None:
            write_json(out / METRICS, {"rooms": _figures([figures])})
        write_recording(out / RECORDING, graph)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror}); give another folder to --out") from error


def _figures(of_maps: Sequence[RoomFigures]) -> dict[str, float]:
    """Sums of counts and means of fractions over several maps, named as in a run's metrics.json."""
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


def _compare(path: Path, grid: GridMap, coarse: GridMap, graph: AreaGraph, truth: Path) -> RoomFigures:
    true = rooms_of_image(read_image(truth)[::-1], grid.cell_m)
    if true.shape != grid.cells.shape:
        raise InputError(
            f"{truth}: has {true.shape[1]} × {true.shape[0]} pixels and {path} {grid.cells.shape[1]} × "
            f"{grid.cells.shape[0]}; give the truth of this map"
        )
    return compare_room_images(true, _spread(graph.label, coarse, grid), grid.cells == Cell.FREE, grid.cell_m)


def _spread(label: IntArray, coarse: GridMap, grid: GridMap) -> IntArray:
    """The label of a coarsened grid, in the cells of the grid itself."""
    factor = round(coarse.cell_m / grid.cell_m)
    column, row = np.rint((coarse.origin - grid.origin) / grid.cell_m).astype(int)
    fine = np.repeat(np.repeat(label, factor, axis=0), factor, axis=1)
    whole = np.full(grid.cells.shape, -1, np.int32)
    rows, columns = grid.cells.shape
    fine = fine[: rows - row, : columns - column]
    whole[row : row + len(fine), column : column + fine.shape[1]] = fine
    return whole


def _doorways(path: Path) -> FloatArray:
    """Sills of a doors.geojson, without depth."""
    features = read_features(path, "lines", "give a run's doors.geojson")
    sills = segments(features)
    return np.concatenate([sills, sills[:, ::-1]], axis=1)


def _rooms_table(graph: AreaGraph) -> Table:
    rows = [
        (room.name, f"{room.area_m2:.1f}", ", ".join(graph.neighbours(index)) or "–")
        for index, room in enumerate(graph.rooms)
    ]
    title = f"{len(graph)} rooms, {len(graph.passages)} passages"
    return make_table(title, ("room", "m²", "leads to"), rows, left=(0, 2))


def _truth_line(figures: RoomFigures) -> str:
    true, found, recall, precision, split, merged = _cells([figures])
    return f"{found} rooms for {true} true ones: recall {recall} %, precision {precision} %; {split} split, {merged} merged"
