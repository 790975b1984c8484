"""`ffmap evaluate`: the files of a run against the truth of its bag, as `metrics.json`.

The names in it, all fractions 0 to 1, null where there is nothing to divide by:

    area.<label>.precision | recall | f1         by 5 cm cubes, for clutter, floor, ceiling, wall, door, outside
    area.<label>.right_m2 | wrong_m2 | missed_m2
    area.outside_kept_as_structure
    area.confusion.truth | label | counts        row and column names, cubes before any rule is applied
    area_scan, points, points_scan               the same for the labels of single scans, and by points
    missing                                      what could not be compared, and why
    scans.counted | skipped | without_truth
    doors.true | passed | found_count | found | detections | invented_count | invented
    doors.width_error_m | width_bias_m | state_right
    maps.<map>.precision | recall | error_m | true_cells | occupied_cells | false_cells
    maps.<map>.false_cells_of_cabinets | precision_without_cabinets     cabinets as high as the room count as false walls
    maps.<map>.doors_passed | doors_blocked | blocked      in whose doorway no free cells connect the wall's two sides
    wall_map                                     the same as maps.furniture_free
    rooms.true | entered | found | recall | precision     recall over the true rooms with 1 m of the true way or more in them
    rooms.recall_of_all | split | merged                         names of the true rooms; pairs of them
    rooms_of_maps.<map>.found | recall | precision | split | merged
        the same of furniture_free, normal, normal_without_alpha_removal (Fig. 10)
    trajectory.ate_rmse_m | ate_mean_m | ate_max_m               after the best rotation and shift
    trajectory.unaligned_rmse_m | unaligned_mean_m | unaligned_max_m
    trajectory.rotation_rmse_deg | relative_translation_rmse_m | relative_rotation_rmse_deg | poses
    statistics.milliseconds_per_cloud (smoothing and labelling) | points_in_cloud | points_in_lines: mean,
        standard_deviation, min, max (Table I)

Doors and maps are compared as they stand: the map frame is defined alike for run and truth. Where a run has no
labelled clouds, the sections about them are missing.
"""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN, Label, Truth
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.truth.doors import DOOR_RETURNS, DoorFigures, FoundDoors, TrueDoors, compare_doors
from ffmap.algorithms.truth.labels import UNLABELLED, class_figures, outside_kept
from ffmap.algorithms.truth.maps import ComparedMaps, compare_with_truth
from ffmap.algorithms.truth.poses import TrajectoryFigures, compare_trajectories, rms
from ffmap.algorithms.truth.rooms import RoomFigures, compare_rooms
from ffmap.algorithms.truth.tally import CUBE_M, Counter, Tally, confusion_by_area
from ffmap.app.analysis.map_figures import (
    map_metrics,
    maps_table,
    read_maps,
    wall_thickness_of_doors,
    walls_direction_deg,
    write_overlays,
)
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.labels_file import read_labels
from ffmap.app.folder.names import (
    DOORS,
    EVALUATION,
    LABELS,
    METRICS,
    OVERLAY,
    RUN_JSON,
    TRAJECTORY,
    RunFolder,
    check_same_run,
    map_file,
    require_writable,
    rooms_file,
)
from ffmap.app.folder.room_files import outlines
from ffmap.app.run.workers import make_pool
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import read_features
from ffmap.loaders.pointcloud2 import describe_layout, field_column
from ffmap.loaders.rig import Lidar, find_rig
from ffmap.loaders.scans import CloudIndex, SkippedScan, cloud_topics, index_clouds, read_clouds
from ffmap.loaders.trajectory_file import read_tum
from ffmap.loaders.truth import BUILDING_TOPIC, CLASSES_TOPIC, POSE_TOPIC, TruthClasses, read_truth
from ffmap.loaders.truth import Truth as BagTruth

Metrics = dict[str, Any]

PAPER = {
    Label.CEILING: (0.8525, 0.9992, 0.9200),
    Label.FLOOR: (0.8955, 0.9985, 0.9442),
    Label.WALL: (0.9960, 0.9526, 0.9737),
    Label.DOOR: (0.8282, 0.8076, 0.8177),
}
"""Table II: precision, recall, F1 by area."""

DEFAULT_DOOR_HEIGHT_M = 2.0

TRUTH_SUFFIXES = (".tum", ".txt")
"""Of files with the true poses alone."""

_FIG_10 = ("found", "recall", "precision", "split", "merged")
_FRAMES_APART_M = 1_000.0
"""Distance in metres from the true poses beyond which poses are not wrong but given in another frame, as in UTM."""

_SEGMENTED = {
    Segmented.FURNITURE_FREE: "furniture-free map",
    Segmented.NORMAL: "normal map, after alpha removal",
    Segmented.NORMAL_AS_IS: "normal map, furniture and all",
}

CLOUDS_A_SHARE = 100
"""For fewer clouds than this a process more costs more than it saves; with many more, its cubes fill the memory."""


PAPER_STATISTICS = {
    "milliseconds_per_cloud": (74, 26, 32, 187),
    "points_in_cloud": (96_058, 5_743, 60_130, 100_538),
    "points_in_lines": (40_595, 13_047, 14_885, 75_698),
}
"""Table I: mean, standard deviation, least, most."""


@dataclass(frozen=True)
class Layer:
    """Where errors are recorded: `spool` takes the parts of a layer of the recording `recording_id`."""

    spool: Path
    recording_id: str
    scans: bool
    """Whether the recording has single scans."""
    registered: bool
    """Whether it has the quality of an odometry's poses."""
    lines: bool
    """Whether it has every intermediate of single scans."""


@dataclass(frozen=True)
class LabelledClouds:
    """Where a run's vertical clouds and their labels are read."""

    bag: Path
    """The labelled bag, or the one that the run was made from."""
    lidar: Lidar
    labels: Path | None = None
    """labels.parquet; None where the clouds themselves have the labels."""


@dataclass(frozen=True, eq=False)
class _Share:
    """What is counted at a time: clouds [first, first + count) of the run's."""

    clouds: LabelledClouds
    truth_bag: Path
    doors: TrueDoors
    first: int
    count: int
    layer: Layer | None

    @property
    def part(self) -> Path:
        """The share's part of the layer."""
        assert self.layer is not None
        return self.layer.spool / f"scans-{self.first:06d}.rrd"


@dataclass(frozen=True, eq=False)
class Comparison:
    """A run beside the truth; what the run does not have is None."""

    metrics: Metrics
    faces: FloatArray
    doors: TrueDoors
    tally: Tally | None = None
    parts: tuple[Path, ...] = ()
    ring_count: int | None = None
    found_doors: FoundDoors | None = None
    door_figures: DoorFigures | None = None
    maps: ComparedMaps = field(default_factory=dict)


def evaluate_run(run: FinishedRun, truth_bag: Path | None = None, workers: int = 2) -> Metrics:
    """Compare a run's files with the truth, write `metrics.json` and return what it says.

    Where the run has a recording, `evaluation.rrd` becomes its second layer.

    truth_bag: the bag that carries the truth, or a TUM file of the true poses alone; None for the bag that the run was made
    from. workers: processes that are started where there is enough to do.
    Raises InputError where the run does not say which bag it was made from, or the bag has no truth, where run and truth
    have nothing in common, and where nothing can be written into the run folder.
    """
    require_writable(run.path, "the figures are written there: change its permissions, or evaluate a copy")
    truth_path = truth_bag if truth_bag is not None else _bag_of(run)
    with _opened_truth(truth_path) as truth, tempfile.TemporaryDirectory(prefix="evaluation-", dir=run.path) as spool:
        if truth is None or truth.trajectory is None:
            raise InputError(
                f"{truth_path}: the bag carries no {POSE_TOPIC} to compare with; give a bag that does, or a TUM file of the "
                "true poses, to --truth"
            )
        layer = _layer_of(run, Path(spool))
        comparison = compare_run(run, truth_path, truth, truth.trajectory, workers, layer)
        check_same_run(RunFolder(run.path), run.record)
        write_json(run.path / METRICS, comparison.metrics)
        if comparison.maps:
            write_overlays(run.path / OVERLAY, comparison.maps, "truth", walls_direction_deg(run.path))
        if layer is not None and comparison.tally is not None:
            _write_layer(run.path / EVALUATION, layer, comparison)
    return comparison.metrics


@contextmanager
def _opened_truth(path: Path) -> Iterator[BagTruth | None]:
    """A bag's truth, which can be read within the context; of a TUM file, the poses. None where a bag carries none."""
    if path.suffix.lower() in TRUTH_SUFFIXES:
        yield BagTruth(read_tum(path), None, None)
        return
    with open_bag(path) as bag:
        yield read_truth(bag)


def _layer_of(run: FinishedRun, spool: Path) -> Layer | None:
    """Where the errors of a run are recorded; None where it has no recording that they could be a layer of."""
    if run.recording is None or "recording_id" not in run.record:
        return None
    return Layer(spool, run.record["recording_id"], run.has_scans, run.registered, run.has_lines)


def _write_layer(out: Path, layer: Layer, comparison: Comparison) -> None:
    # Rerun is not needed where a run has no recording.
    from ffmap.app.record.errors import write_layer

    assert comparison.tally is not None
    found, figures = comparison.found_doors, comparison.door_figures
    own = comparison.maps.get(entities.FURNITURE_FREE)
    write_layer(
        out,
        list(comparison.parts),
        layer.spool,
        layer.recording_id,
        run_blueprint.build(
            comparison.ring_count,
            *run_blueprint.view_of(own.grid if own else None),
            evaluated=True,
            scans=layer.scans,
            registered=layer.registered,
            lines=layer.lines,
        ),
        comparison.metrics,
        in_markdown(comparison.metrics),
        comparison.tally,
        comparison.faces,
        comparison.doors,
        (found, figures) if found is not None and figures is not None else None,
        comparison.maps,
    )


def has_truth(run: FinishedRun) -> bool:
    """Whether the bag of a run is still there and carries the truth."""
    path = _bag_of(run)
    if not path.exists():
        return False
    with open_bag(path) as bag:
        return POSE_TOPIC in bag.topics and bag.topics[POSE_TOPIC].count > 0


def print_metrics(metrics: Metrics) -> None:
    """`format_metrics` on the terminal."""
    console = Console()
    for table in format_metrics(metrics):
        console.print(table)
    for reason in metrics.get("missing", ()):
        console.print(f"not compared: {reason}", markup=False, highlight=False, soft_wrap=True)


def in_one_line(metrics: Metrics) -> str:
    """The figures that a person asks for first, and what could not be compared."""
    said = []
    if "area" in metrics:
        said.append(f"wall F1 {_percent(metrics['area'][Label.WALL.name.lower()]['f1'])} %")
    if (doors := metrics.get("doors")) is not None:
        said.append(f"{doors['found_count']} of {doors['passed']} doors found, {doors['invented_count']} invented")
    if (rooms := metrics.get("rooms")) is not None:
        said.append(f"rooms {_percent(rooms['recall'])} % recalled")
    if (trajectory := metrics.get("trajectory")) is not None:
        said.append(f"poses off by {_centimetres(trajectory['ate_rmse_m'])}")
    said += [f"not compared: {reason}" for reason in metrics.get("missing", ())]
    return ", ".join(said) or "nothing could be compared with the truth"


def compare_run(
    run: FinishedRun,
    truth_path: Path,
    truth: BagTruth,
    true_trajectory: Trajectory,
    workers: int,
    layer: Layer | None = None,
) -> Comparison:
    """A run beside the truth, nothing written but the parts of the layer, if one is wanted."""
    metrics: Metrics = {"truth": str(truth_path)}
    poses_missing: tuple[str, ...] = ()
    if run.trajectory is not None:
        metrics["trajectory"], poses_missing = _compare_poses(run, run.trajectory, truth_path, true_trajectory)
    missing = (*poses_missing, *_missing(run, truth))
    if run.map_origin_m[:2].any():
        truth = replace(truth, building=None)
    if run.trajectory is None and _clouds_of(run) is None:
        raise InputError(
            f"{run.path}: holds nothing to compare with the truth, the run is {run.outcome}; "
            f"'ffmap run --resume {run.path}' goes on with one that was stopped"
        )
    if missing:
        metrics["missing"] = missing
    if statistics := run.record.get("statistics"):
        metrics["statistics"] = statistics
    if truth.building is not None:
        files = {name: run.file(rooms_file(name)) for name in Segmented}
        compared_rooms = {
            name: _compare_rooms(path, truth.building, true_trajectory)
            for name, path in files.items()
            if path is not None
        }
        if Segmented.FURNITURE_FREE in compared_rooms:
            metrics["rooms"] = compared_rooms[Segmented.FURNITURE_FREE]
            metrics["rooms_of_maps"] = {
                name: {figure: own[figure] for figure in _FIG_10} for name, own in compared_rooms.items()
            }
    doors, faces = read_building(truth.building)
    clouds = _clouds_of(run)
    if clouds is None or truth.classes is None:
        return Comparison(metrics, faces, doors)
    counted = count_run(clouds, truth_path, doors, workers, layer)
    tally = counted.tally
    metrics["scans"] = {"counted": tally.scans, "skipped": tally.skipped, "without_truth": counted.without_truth}
    metrics["area"] = _label_metrics(confusion_by_area(tally.cubes), CUBE_M**2)
    metrics["area_scan"] = _label_metrics(confusion_by_area(tally.cubes, single_scans=True), CUBE_M**2)
    metrics["points"] = _label_metrics(tally.confusion_points, None)
    metrics["points_scan"] = _label_metrics(tally.confusion_points_scan, None)
    comparison = Comparison(metrics, faces, doors, tally, counted.parts, counted.ring_count)
    if truth.building is not None and (doors_path := run.file(DOORS)) is not None:
        found_doors = read_doors(doors_path)
        door_figures = compare_doors(doors, tally.door_returns, found_doors)
        metrics["doors"] = _door_metrics(door_figures)
        comparison = replace(comparison, found_doors=found_doors, door_figures=door_figures)
    if truth.building is not None and (maps := read_maps(run.path)):
        passed = tally.door_returns >= DOOR_RETURNS
        wall_m = wall_thickness_of_doors(truth.building)
        compared = compare_with_truth(maps, faces, tally, doors.ends[passed], wall_m[passed])
        metrics["maps"] = map_metrics(compared)
        if entities.FURNITURE_FREE in compared:
            metrics["wall_map"] = metrics["maps"][entities.FURNITURE_FREE]
        comparison = replace(comparison, maps=compared)
    return comparison


def _compare_poses(
    run: FinishedRun, poses: Path, truth_path: Path, true_trajectory: Trajectory
) -> tuple[Metrics, tuple[str, ...]]:
    """The figures of a run's poses, seen from the frame in which they were given, and what of them cannot be told."""
    found = read_tum(poses).moved(transforms.make_transform(translation=run.map_origin_m))
    compared = compare_trajectories(found, true_trajectory)
    if not compared.poses:
        raise InputError(
            f"{truth_path}: has no pose of a time at which the run {run.path} has one; give the truth of the same drive"
        )
    metrics = _trajectory_metrics(compared)
    apart_m = float(np.median(compared.error_unaligned_m))
    if apart_m < _FRAMES_APART_M:
        return metrics, ()
    metrics |= dict.fromkeys((name for name in metrics if name.startswith("unaligned")), float("nan"))
    return metrics, (
        f"unaligned poses: the run's are {apart_m / 1e3:.1f} km from the true ones, so the two are given in different frames",
    )


def _missing(run: FinishedRun, truth: BagTruth) -> Iterator[str]:
    """What cannot be compared, and why, one line each."""
    if truth.classes is None and truth.building is None:
        yield "labels, doors, maps and rooms: the truth has poses alone"
        return
    if run.trajectory is None:
        yield f"trajectory: {_lacks(run, TRAJECTORY, None)}"
    if truth.classes is None:
        yield f"labels, doors and maps: the truth has no {CLASSES_TOPIC}"
    elif run.labelled is None and run.file(LABELS) is None:
        yield f"labels, doors and maps: {_lacks(run, 'labelled clouds', 'labelled')}"
    if truth.building is None:
        yield f"doors, maps and rooms: the truth has no {BUILDING_TOPIC}"
        return
    if run.map_origin_m[:2].any():
        yield "doors, maps and rooms: the map's origin lies elsewhere than that of its poses (run.json: map_origin)"
        return
    for what, name, output in (
        ("doors", DOORS, "geojson"),
        ("rooms", rooms_file(Segmented.FURNITURE_FREE), "geojson"),
        ("maps", map_file(entities.FURNITURE_FREE), "maps"),
    ):
        if run.file(name) is None:
            yield f"{what}: {_lacks(run, name, output)}"


def _lacks(run: FinishedRun, name: str, output: str | None) -> str:
    why = f"; --outputs with {output} writes it" if run.complete and output is not None else ""
    return f"the run has no {name}" + (why or f", it is {run.outcome}")


def _clouds_of(run: FinishedRun) -> LabelledClouds | None:
    """The labelled bag, or the labels beside the run's own bag; None where the run kept neither."""
    if run.labelled is not None:
        with open_bag(run.labelled) as bag:
            topics = cloud_topics(bag)
            if len(topics) != 1:
                raise InputError(f"{run.labelled}: {len(topics)} topics with clouds where one belongs; run ffmap again")
            # Read as the run read its own bag.
            rig = find_rig(bag, vertical=topics[0], time_from=run.time_from)
        assert rig.vertical is not None
        return LabelledClouds(run.labelled, rig.vertical)
    labels = run.file(LABELS)
    if labels is None:
        return None
    path, options = _bag_of(run), run.input_options
    with open_bag(path) as bag:
        rig = find_rig(bag, options.rig_file, options.horizontal, options.vertical, options.time_from)
    assert rig.vertical is not None
    return LabelledClouds(path, rig.vertical, labels)


@dataclass(frozen=True, eq=False)
class Counted:
    """All clouds of a run. without_truth: how many were left out. parts: of the layer, in order."""

    tally: Tally
    without_truth: int
    ring_count: int
    parts: tuple[Path, ...]


def count_run(
    clouds: LabelledClouds,
    truth_bag: Path,
    doors: TrueDoors,
    workers: int,
    layer: Layer | None = None,
) -> Counted:
    """Count all clouds of a run, in processes side by side."""
    topic = clouds.lidar.topic
    with open_bag(clouds.bag) as bag:
        count = len(index_clouds(bag, topic))
    layer = layer if layer is not None and layer.scans else None
    edges = np.linspace(0, count, max(1, count // CLOUDS_A_SHARE) + 1).astype(int).tolist()
    shares = [_Share(clouds, truth_bag, doors, first, last - first, layer) for first, last in pairwise(edges)]
    processes = min(workers, len(shares))
    if processes == 1:
        with open_bag(clouds.bag) as bag, open_bag(truth_bag) as true_bag:
            bags = _Bags.read(bag, true_bag, topic)
            tally, without_truth = _sum(doors, (_count(share, bags) for share in shares))
    else:
        with make_pool(processes) as pool:
            tally, without_truth = _sum(doors, pool.map(_count_in_worker, shares))
    parts = tuple(share.part for share in shares if layer is not None and share.part.exists())
    return Counted(tally, without_truth, clouds.lidar.ring_count, parts)


def _sum(doors: TrueDoors, counted: Iterable[tuple[Tally, int]]) -> tuple[Tally, int]:
    total, without_truth = Counter(doors), 0
    for tally, missing in counted:
        total.absorb(tally)
        without_truth += missing
    return total.tally(), without_truth


@dataclass(frozen=True, eq=False)
class _Bags:
    """What is counted and what it is compared with, both open."""

    clouds: Bag
    index: CloudIndex
    trajectory: Trajectory
    classes: TruthClasses

    @staticmethod
    def read(clouds: Bag, true_bag: Bag, topic: str) -> "_Bags":
        truth = read_truth(true_bag)
        assert truth is not None
        assert truth.trajectory is not None
        assert truth.classes is not None
        return _Bags(clouds, index_clouds(clouds, topic), truth.trajectory, truth.classes)


def _count_in_worker(share: _Share) -> tuple[Tally, int]:
    return _count(share, _opened(share.clouds.bag, share.truth_bag, share.clouds.lidar.topic))


@cache
def _opened(clouds: Path, truth_bag: Path, topic: str) -> _Bags:
    """Each worker opens the bags once; it lives as long as one evaluation."""
    return _Bags.read(open_bag(clouds), open_bag(truth_bag), topic)


def _count(share: _Share, bags: _Bags) -> tuple[Tally, int]:
    if share.layer is None:
        return _count_clouds(share, bags, lambda *_: None)
    # Rerun is not needed where a run has no recording.
    from ffmap.app.record.errors import ScanErrors
    from ffmap.app.record.stream import open_part

    with open_part(share.part, share.layer.recording_id) as stream:
        errors = ScanErrors(stream)
        counted = _count_clouds(share, bags, errors.log)
        errors.finish()
    return counted


def _count_clouds(
    share: _Share, bags: _Bags, log: Callable[[int, int, UInt8Array, UInt8Array], None]
) -> tuple[Tally, int]:
    """log: called with each counted scan's number, stamp, truth and label."""
    counter = Counter(share.doors)
    without_truth = 0
    lidar, labels = share.clouds.lidar, share.clouds.labels
    stored = read_labels(labels, share.first, share.count) if labels is not None else None
    for number, scan, message in read_clouds(bags.clouds, bags.index, share.first, share.count, lidar.decoding):
        if isinstance(scan, SkippedScan) or message is None:
            counter.skip()
            continue
        classes = bags.classes.at(scan.stamp_ns)
        if classes is None or not bags.trajectory.covers(np.array([scan.start_ns]), _MARGIN_NS)[0]:
            without_truth += 1
            continue
        if len(classes) != scan.cloud_size:
            raise InputError(
                f"{share.truth_bag}: {len(classes)} true classes for a cloud of {scan.cloud_size} points; "
                "give the bag that the run was made from as --truth"
            )
        if stored is None:
            layout = describe_layout(message, lidar.topic)
            full = tuple(field_column(message, layout, name) for name in ("label", "label_scan"))
        else:
            # What was not labelled has no row.
            full = stored.get(number) or (np.full(scan.cloud_size, NO_RETURN, np.uint8),) * 2
        label, label_scan = (values[scan.cloud_index].astype(np.uint8) for values in full)
        truth = classes[scan.cloud_index]
        # As measured, at the true poses: where a return is counted does not depend on what was made of it.
        placed = place_scan(scan, bags.trajectory, lidar.T_base_sensor)
        counter.add(
            placed.to_map(placed.points_level),
            placed.to_map(placed.origin_level[None])[0],
            truth,
            label,
            label_scan,
        )
        log(number, scan.stamp_ns, truth, label)
    return counter.tally(), without_truth


_MARGIN_NS = 200_000_000
"""The first and the last sweep may stand a little outside the true poses."""


def read_building(building: Mapping[str, Any] | None) -> tuple[TrueDoors, FloatArray]:
    """Doors, and wall faces (F, 2, 2), of the truth's GeoJSON.

    `kind` of a feature is wall (a LineString or an outline, every edge a face), door (a LineString along the sill with
    `state`, `height`, and `leaves`, the outlines of its leaves in the plan) or something else, which is left out.
    Where a closed door has no `leaves`, its sill is taken for one.
    """
    faces: list[FloatArray] = []
    ends, heads_m, leaves, states = [], [], [], []
    for feature in building["features"] if building is not None else []:
        properties = feature["properties"]
        edges = _edges(feature["geometry"]["coordinates"])
        if properties["kind"] == "wall":
            faces.append(edges)
        elif properties["kind"] == "door":
            ends.append(edges[0])
            heads_m.append(float(properties.get("height", DEFAULT_DOOR_HEIGHT_M)))
            state = _state(properties["state"])
            outlines = [_edges(leaf) for leaf in properties.get("leaves") or []]
            closed = edges[:1] if state == DoorState.CLOSED else np.zeros((0, 2, 2))
            leaves.append(np.concatenate(outlines) if outlines else closed)
            states.append(state)
    doors = TrueDoors(
        ends=np.array(ends).reshape(-1, 2, 2),
        head_m=np.array(heads_m),
        leaves=tuple(leaves),
        state=np.array(states, np.uint8),
    )
    return doors, np.concatenate(faces) if faces else np.zeros((0, 2, 2))


def _compare_rooms(path: Path, building: Mapping[str, Any], true_trajectory: Trajectory) -> Metrics:
    true = [feature for feature in building["features"] if feature["properties"]["kind"] == "room"]
    names = [feature["properties"].get("name", str(i)) for i, feature in enumerate(true)]
    way = true_trajectory.T_map_base[:, :3, 3]
    found = read_features(path, "outlines", "give the folder of a run of ffmap")
    return _room_metrics(compare_rooms(outlines(true), outlines(found), way), names)


def read_doors(path: Path) -> FoundDoors:
    """A run's `doors.geojson`."""
    features = read_features(path, "doors", "give the folder of a run of ffmap")
    return FoundDoors(
        ends=np.array([[p[:2] for p in f["geometry"]["coordinates"][:2]] for f in features], float).reshape(-1, 2, 2),
        width_m=np.array([feature["properties"]["width"] for feature in features], float),
        state=np.array([_state(feature["properties"]["state"]) for feature in features], np.uint8),
    )


def format_metrics(metrics: Metrics) -> list[Table]:
    """What a person reads on the terminal: the labels beside the paper's Table II, then doors, map and trajectory."""
    tables = []
    if "area" in metrics:
        table = Table(title="Labels by area (Table II)", title_justify="left")
        for heading in ("label", "precision", "recall", "F1", "paper: precision", "recall", "F1", "single scans: F1"):
            table.add_column(heading, justify="left" if heading == "label" else "right")
        for label in (Label.CEILING, Label.FLOOR, Label.WALL, Label.DOOR, Label.CLUTTER, Label.OUTSIDE):
            name = label.name.lower()
            found = metrics["area"][name]
            table.add_row(
                name,
                *(_percent(found[figure]) for figure in ("precision", "recall", "f1")),
                *(_percent(figure) for figure in PAPER.get(label, (None, None, None))),
                _percent(metrics["area_scan"][name]["f1"]),
            )
        tables.append(table)
    if "statistics" in metrics:
        table = Table(title="Statistics (Table I)", title_justify="left")
        for heading in ("", "mean", "std", "min", "max"):
            table.add_column(heading, justify="right" if heading else "left")
        for name, paper in PAPER_STATISTICS.items():
            own = metrics["statistics"][name]
            digits = 1 if name.startswith("milliseconds") else 0
            table.add_row(
                name.replace("_", " "),
                *(f"{own[figure]:,.{digits}f}" for figure in ("mean", "standard_deviation", "min", "max")),
            )
            table.add_row("  in the paper", *(f"{figure:,}" for figure in paper))
        tables.append(table)
    if "maps" in metrics:
        tables.append(maps_table(metrics["maps"], "Grid maps against the truth (Fig. 9)"))
    if "rooms_of_maps" in metrics:
        tables.append(_rooms_table(metrics["rooms_of_maps"]))
    rows = [*_door_rows(metrics), *_map_rows(metrics), *_room_rows(metrics), *_trajectory_rows(metrics)]
    if rows:
        table = Table(title="Doors, map, rooms, trajectory", title_justify="left", show_header=False)
        for row in rows:
            table.add_row(*row)
        tables.append(table)
    return tables


def in_markdown(metrics: Metrics) -> str:
    """The tables of `format_metrics` for the viewer."""
    parts = []
    for table in format_metrics(metrics):
        columns = [[str(cell) for cell in column.cells] for column in table.columns]
        headings = [str(column.header) for column in table.columns]
        rows = [headings, ["---"] * len(headings), *map(list, zip(*columns, strict=True))]
        parts += [f"## {table.title}", "", *("| " + " | ".join(row) + " |" for row in rows), ""]
    return "\n".join(parts)


def _door_rows(metrics: Metrics) -> list[tuple[str, str]]:
    if (doors := metrics.get("doors")) is None:
        return []
    return [
        ("doors found", f"{doors['found_count']} of {doors['passed']} passed, {_percent(doors['found'])} %"),
        ("doors invented", f"{doors['invented_count']} of {doors['detections']}, {_percent(doors['invented'])} %"),
        ("width error, mean", _centimetres(doors["width_error_m"])),
        ("state right", f"{_percent(doors['state_right'])} %"),
    ]


def _map_rows(metrics: Metrics) -> list[tuple[str, str]]:
    rows = []
    if "area" in metrics:
        rows.append(("outside kept as structure", f"{_percent(metrics['area']['outside_kept_as_structure'])} %"))
    return rows


def _room_rows(metrics: Metrics) -> list[tuple[str, str]]:
    if (rooms := metrics.get("rooms")) is None:
        return []
    merged = [" and ".join(pair) for pair in rooms["merged"]]
    return [
        ("rooms entered, recall", f"{_percent(rooms['recall'])} % ({rooms['entered']} of {rooms['true']} true rooms)"),
        ("rooms found, precision", f"{_percent(rooms['precision'])} % ({rooms['found']} rooms)"),
        ("rooms split", ", ".join(rooms["split"]) or "none"),
        ("rooms merged", ", ".join(merged) or "none"),
    ]


def _rooms_table(rooms_of_maps: Mapping[str, Metrics]) -> Table:
    table = Table(title="Rooms of maps against the truth (Fig. 10)", title_justify="left")
    for heading in ("rooms of", "found", "recall %", "precision %", "split", "merged"):
        table.add_column(heading, justify="left" if heading == "rooms of" else "right")
    for name, rooms in rooms_of_maps.items():
        row = [
            _SEGMENTED[Segmented(name)],
            str(rooms["found"]),
            _percent(rooms["recall"]),
            _percent(rooms["precision"]),
        ]
        table.add_row(*row, str(len(rooms["split"])), str(len(rooms["merged"])))
    return table


def _trajectory_rows(metrics: Metrics) -> list[tuple[str, str]]:
    if (trajectory := metrics.get("trajectory")) is None:
        return []
    rotation = trajectory["rotation_rmse_deg"]
    return [
        ("trajectory, ATE RMSE", _centimetres(trajectory["ate_rmse_m"])),
        ("trajectory, unaligned RMSE", _centimetres(trajectory["unaligned_rmse_m"])),
        ("trajectory, rotation RMSE", "–" if rotation is None else f"{rotation:.2f}°"),
        ("trajectory, error in 1 m", _centimetres(trajectory["relative_translation_rmse_m"])),
    ]


def _percent(fraction: float | None) -> str:
    return "–" if fraction is None or np.isnan(fraction) else f"{100 * fraction:.2f}"


def _centimetres(metres: float | None) -> str:
    return "–" if metres is None or np.isnan(metres) else f"{100 * metres:.1f} cm"


def _label_metrics(confusion: IntArray, unit_m2: float | None) -> Metrics:
    section: Metrics = {}
    for label, figures in class_figures(confusion).items():
        counts = (figures.true_positives, figures.false_positives, figures.false_negatives)
        names = ("right", "wrong", "missed")
        section[label.name.lower()] = {
            "precision": figures.precision,
            "recall": figures.recall,
            "f1": figures.f1,
            **(
                {f"{name}_m2": round(count * unit_m2, 4) for name, count in zip(names, counts, strict=True)}
                if unit_m2 is not None
                else dict(zip(names, counts, strict=True))
            ),
        }
    section["outside_kept_as_structure"] = outside_kept(confusion)
    section["confusion"] = {
        "truth": [truth.name.lower() for truth in Truth],
        "label": [*(label.name.lower() for label in Label), "unlabelled"][: UNLABELLED + 1],
        "counts": confusion.tolist(),
    }
    return section


def _door_metrics(figures: DoorFigures) -> Metrics:
    return {
        "true": len(figures.match),
        "passed": int(np.count_nonzero(figures.passed)),
        "found_count": figures.found_count,
        "found": figures.found,
        "detections": figures.detections,
        "invented_count": figures.invented_count,
        "invented": figures.invented,
        "width_error_m": _mean(np.abs(figures.width_error_m)),
        "width_bias_m": _mean(figures.width_error_m),
        "state_right": _mean(figures.state_right),
    }


def _room_metrics(figures: RoomFigures, names: Sequence[str]) -> Metrics:
    return {
        "true": len(figures.recall),
        "entered": int(np.count_nonzero(figures.counted)),
        "found": len(figures.precision),
        "recall": figures.mean_recall,
        "recall_of_all": _mean(figures.recall),
        "precision": figures.mean_precision,
        "split": [names[room] for room in figures.split],
        "merged": [[names[room] for room in pair] for pair in figures.merged],
        "by_room": {name: float(recall) for name, recall in zip(names, figures.recall, strict=True)},
    }


def _trajectory_metrics(figures: TrajectoryFigures) -> Metrics:
    return {
        "poses": figures.poses,
        "ate_rmse_m": figures.ate_rmse_m,
        "ate_mean_m": _mean(figures.error_m),
        "ate_max_m": float(figures.error_m.max(initial=0.0)) if figures.poses else float("nan"),
        "unaligned_rmse_m": rms(figures.error_unaligned_m),
        "unaligned_mean_m": _mean(figures.error_unaligned_m),
        "unaligned_max_m": float(figures.error_unaligned_m.max(initial=0.0)) if figures.poses else float("nan"),
        "rotation_rmse_deg": rms(figures.rotation_error_deg),
        "relative_translation_rmse_m": rms(figures.relative_translation_m),
        "relative_rotation_rmse_deg": rms(figures.relative_rotation_deg),
    }


def _mean(values: np.ndarray[Any, Any]) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _edges(coordinates: Sequence[Any]) -> FloatArray:
    """(k, 2, 2) segments of a LineString's coordinates, or of all rings of a Polygon's."""
    if np.ndim(coordinates[0][0]) > 0:
        return np.concatenate([_edges(part) for part in coordinates])
    vertices = np.array([vertex[:2] for vertex in coordinates], float)
    return np.stack([vertices[:-1], vertices[1:]], axis=1)


def _state(name: str) -> DoorState:
    return DoorState.CLOSED if name == "closed" else DoorState.OPEN


def _bag_of(run: FinishedRun) -> Path:
    """The bag that a run was made from; it may be gone."""
    if run.bag_path is None:
        raise InputError(f"{run.path / RUN_JSON}: it does not say which bag was run; give --truth BAG")
    return run.bag_path
