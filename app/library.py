"""The program as a library: `import ffmap`."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, UInt8Array, in_canonical_order
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.poses.levelling import LevelledScan, level_map, place_and_level
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.labelling import label_scan as label_placed_scan
from ffmap.algorithms.scan.point_lines import COLUMN_PAIRS
from ffmap.algorithms.scan.smoothing import smooth_ranges
from ffmap.app.analysis.figures import read_figures
from ffmap.app.commands.run import run as run_command
from ffmap.app.folder import finished_run
from ffmap.app.folder.cloud_file import read_ply
from ffmap.app.folder.labels_file import ScanLabels, read_labels
from ffmap.app.folder.map_files import read_map
from ffmap.app.folder.names import CLOUD, DOORS, LABELS, ROOMS, TRAJECTORY, WALLS, map_file
from ffmap.app.record.inspection import ExplainedScan, layout_of, log_explained
from ffmap.app.record.library import building_layout, log_building, log_into
from ffmap.app.record.line_reasons import LineReason, explain_lines, scan_document
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings, load_settings, put, validate
from ffmap.blueprints.entities import FURNITURE_FREE, LINE_OUTCOMES
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.candidates import find_candidates
from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import read_features
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.rig import UPRIGHT_DEG
from ffmap.loaders.rings import RingSample, estimate_rings
from ffmap.loaders.scans import read_scans as read_scans_of
from ffmap.loaders.sensors import cloud_topics
from ffmap.loaders.text_files import dotted_keys
from ffmap.loaders.trajectory_file import read_tum

Config = Settings | Mapping[str, Any] | Path | str | None
"""Settings; by dotted names, nested or flat; or a TOML file."""
_ADVICE = "run ffmap again"


@dataclass(frozen=True, eq=False)
class LabelledArray:
    """An array of points with its labels, and the evidence that led to them.

    label: of each point, in the array's shape; see `Label`; NO_RETURN (255) for an invalid point.
    level: the returns in an upright frame on the floor. labelling: every intermediate of the
    paper's section III.
    """

    label: UInt8Array
    level: LevelledScan
    labelling: ScanLabelling

    def __repr__(self) -> str:
        counts = ", ".join(f"{name} {count:,}" for name, count in self.counts.items() if count)
        return f"LabelledArray({counts})"

    @property
    def counts(self) -> dict[str, int]:
        """Number of points of each label."""
        return {label.name.lower(): int(np.sum(self.label == label)) for label in Label}

    @cached_property
    def reasons(self) -> list[LineReason]:
        """Why each point line is in a wall, above a door, or in neither."""
        return explain_lines(self.labelling)

    @property
    def lines(self) -> pa.Table:
        """The point lines as a table: number, outcome, and the reason in words."""
        rows = [
            {"line": r.line, "outcome": LINE_OUTCOMES[r.outcome][0], "reason": r.sentence}
            for r in self.reasons
        ]
        return pa.Table.from_pylist(rows)

    def log(self, rerun: Any = None) -> None:  # noqa: ANN401 - Rerun's module or a stream
        """Log all evidence; the timeline `line` steps through the point lines.

        rerun: the module `rerun` or a RecordingStream; None for the current recording.
        """
        document = f"# Labelled array\n\n{scan_document(self.labelling, self.reasons)}"
        scan = ExplainedScan(self.level, self.labelling, self.reasons, document)
        log_into(rerun, layout_of(scan), lambda log: log_explained(log, scan))


def label_scan(
    points: npt.ArrayLike,
    ring: npt.ArrayLike | None = None,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    config: Config = None,
) -> LabelledArray:
    """Label one revolution of a lidar by the paper's section III.

    points: (n, 3) or (rows, columns, 3) in the sensor's frame, metres, z along the spin axis; NaN
        and (0, 0, 0) are no returns. The lidar did not move, or the motion was removed.
    ring: the emitter of each point; None to find it by rows, columns or elevation.
    up: the upright direction in the sensor's frame: (0, 0, 1) for an upright lidar, whose columns
        are its point lines; (0, 1, 0) for one on its side whose y axis points up.
    Raises ValueError where the arrays do not fit together or hold no return, and InputError for
    wrong settings.
    """
    settings = _settings(config)
    array = np.asarray(points, np.float32)
    shape = array.shape[:-1]
    if array.ndim not in (2, 3) or array.shape[-1] != 3:
        raise ValueError(f"points: shape {array.shape}; give (n, 3) or (rows, columns, 3)")
    if not np.linalg.norm(up):
        raise ValueError("up: has no direction; give the upright axis in the sensor's frame")
    scan = _as_scan(array.reshape(-1, 3), ring, shape if len(shape) == 2 else (1, *shape))
    upright, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])
    T_base_sensor = transforms.make_transform(upright)
    points_base = transforms.apply(T_base_sensor, scan.points_sensor)
    level = level_map(points_base, np.eye(4), settings.seed)
    pose = level.T_map_odom
    placed = place_and_level(
        scan,
        smooth_ranges(scan, settings.smoothing),
        Trajectory(np.zeros(1, np.int64), pose[None]),
        T_base_sensor,
        float(pose[2, 3]),
        level.floor_slope,
        settings.rearrangement,
    )
    is_upright = abs(T_base_sensor[2, 2]) >= np.cos(np.radians(UPRIGHT_DEG))
    pairs = COLUMN_PAIRS if is_upright else 0
    labelling = label_placed_scan(
        scan, placed.placed, settings.method, settings.seed, placed.floor, pairs
    )
    label = full_labels(scan.cloud_size, scan.cloud_index, labelling.label)
    return LabelledArray(label.reshape(shape), placed, labelling)


def _as_scan(points: FloatArray, ring: npt.ArrayLike | None, shape: tuple[int, ...]) -> Scan:
    """Select the returns (n, 3) of an array and find their rings."""
    valid = np.flatnonzero(np.isfinite(points).all(axis=1) & points.any(axis=1)).astype(np.int32)
    if not len(valid):
        raise ValueError("points: no return; all are NaN, infinite or zero")
    number: IntArray | None = None
    if ring is not None:
        every = np.asarray(ring).ravel()
        if len(every) != len(points):
            raise ValueError(f"ring: {len(every)} values for {len(points)} points; give one each")
        number = every[valid].astype(np.int64)
    row, column = np.divmod(valid, shape[1])
    rings = estimate_rings([RingSample(points[valid], number, row, column, (shape[0], shape[1]))])
    numbers = {"field": number, "row": row, "column": column}.get(rings.source)
    scan = Scan(
        points_sensor=points[valid],
        ring=rings.rings(points[valid], numbers),
        ring_count=rings.count,
        time_ns=None,
        start_ns=0,
        stamp_ns=0,
        cloud_index=valid,
        cloud_size=len(points),
    )
    return in_canonical_order(scan)


def read_scans(bag: Path | str, topic: str | None = None) -> Iterator[Scan]:
    """Yield the scans of a lidar in a bag; damaged clouds are left out.

    topic: None where the bag has one lidar. Raises InputError for no lidar, or several.
    """
    with open_bag(BagPath((Path(bag),))) as opened:
        topics = [topic] if topic is not None else cloud_topics(opened)
        found = find_candidates(opened, topics, "auto", []) if topics else []
        if len(found) != 1:
            names = ", ".join(lidar.topic for lidar in found) or "none"
            raise InputError(f"{bag}: {len(found)} lidars ({names}); name one as topic")
        (lidar,) = found
        for _, scan in read_scans_of(opened, lidar.index(opened), 0, None, lidar.decoding):
            if isinstance(scan, Scan):
                yield scan


@dataclass(frozen=True, eq=False)
class OpenedRun:
    """The results of a run as arrays and tables; all lengths in metres, in the map frame.

    finished: its folder and run.json. What the run did not write is None, or an empty table.
    """

    finished: finished_run.FinishedRun

    def __repr__(self) -> str:
        counts = self.finished.record.counts
        shown = ", ".join(
            f"{counts[name]} {name}"
            for name in ("scans", "walls", "doors", "rooms")
            if name in counts
        )
        return f"OpenedRun({self.path}: {shown or self.finished.outcome})"

    @property
    def path(self) -> Path:
        """The run folder."""
        return self.finished.path

    @cached_property
    def walls(self) -> pa.Table:
        """Wall faces: x0, y0, x1, y1, and the properties of walls.geojson."""
        return self._lines(WALLS, "lines")

    @cached_property
    def doors(self) -> pa.Table:
        """Doors: x0, y0, x1, y1 of the sill, and the properties of doors.geojson."""
        return self._lines(DOORS, "doors")

    @cached_property
    def rooms(self) -> pa.Table:
        """Rooms: the rings of the outline, and the properties of rooms.geojson."""
        return self._table(ROOMS, "outlines", lambda rings: {"rings": rings})

    @cached_property
    def figures(self) -> dict[str, float]:
        """Figures against the ground truth, and times; see docs/outputs.md for names and units."""
        return read_figures(self.path, self.finished.record)

    @cached_property
    def cloud(self) -> tuple[FloatArray, UInt8Array] | None:
        """The semantic cloud: points (n, 3) and labels (n,)."""
        path = self.finished.file(CLOUD)
        return None if path is None else read_ply(path)

    @cached_property
    def grid(self) -> GridMap | None:
        """The furniture-free grid."""
        path = self.finished.file(map_file(FURNITURE_FREE))
        return None if path is None else read_map(path)

    @cached_property
    def trajectory(self) -> Trajectory | None:
        """T_map_base at the stamp of each labelled scan."""
        path = self.finished.file(TRAJECTORY)
        return None if path is None else read_tum(path)

    def labels(self, scan: int) -> ScanLabels:
        """Return the final labels of a scan, and those by the scan alone.

        Raises KeyError where the scan was skipped or does not exist.
        """
        path = self.finished.file(LABELS)
        found = {} if path is None else read_labels(path, scan, 1)
        if scan not in found:
            raise KeyError(f"{self.path}: has no labels of scan {scan}")
        return found[scan]

    def log(self, rerun: Any = None) -> None:  # noqa: ANN401 - Rerun's module or a stream
        """Log the building: cloud, walls, doors, grid, trajectory.

        rerun: the module `rerun` or a RecordingStream; None for the current recording. The run's
        own recording, with every scan, is in its folder: `rr.log_file_from_path`.
        """
        log_into(rerun, building_layout(self), lambda log: log_building(log, self))

    def ends(self, table: pa.Table) -> FloatArray:
        """(n, 2, 2) both ends of the lines of `walls` or `doors`."""
        columns = [table[name].to_numpy() for name in ("x0", "y0", "x1", "y1")]
        return np.column_stack(columns).reshape(-1, 2, 2)

    def _lines(self, name: str, of: Any) -> pa.Table:  # noqa: ANN401 - see read_features
        def ends(line: list[list[float]]) -> dict[str, float]:
            (x0, y0, *_), (x1, y1, *_) = line
            return {"x0": x0, "y0": y0, "x1": x1, "y1": y1}

        return self._table(name, of, ends)

    def _table(self, name: str, of: Any, geometry: Any) -> pa.Table:  # noqa: ANN401
        path = self.finished.file(name)
        features = [] if path is None else read_features(path, of, _ADVICE)
        rows = [geometry(f["geometry"]["coordinates"]) | f["properties"] for f in features]
        return pa.Table.from_pylist(rows)


def map_building(
    bag: Path | str,
    config: Config = None,
    out: Path | str | None = None,
    overwrite: bool = False,
    **options: Any,  # noqa: ANN401 - see RunOptions
) -> OpenedRun:
    """Run on a bag as 'ffmap run' does: same files, same progress, same five lines.

    options: of `RunOptions`, such as rig, trajectory, workers, quiet=True.
    Raises InputError where the input is unusable, or `out` holds another run.
    """
    rest = RunOptions(**options)
    folder = run_command(
        BagPath((Path(bag),)),
        _settings(config),
        rest,
        None if out is None else Path(out),
        overwrite,
    )
    return open_run(folder)


def open_run(path: Path | str) -> OpenedRun:
    """Open a run folder. Raises InputError where it is none."""
    return OpenedRun(finished_run.open_run(Path(path)))


def _settings(config: Config) -> Settings:
    if isinstance(config, Settings):
        return config
    if isinstance(config, Mapping):
        nested: dict[str, Any] = {}
        for name, value in dotted_keys(config).items():
            put(nested, name, value, "config")
        return validate(nested, "config")
    return load_settings(None if config is None else Path(config), ())
