"""`ffmap evaluate`: the files of a run against the truth of its bag, as `metrics.json`.

The names in it, all fractions 0 to 1, null where there is nothing to divide by:

    area.<label>.precision | recall | f1         by 5 cm cubes, for clutter, floor, ceiling, wall, door, outside
    area.<label>.right_m2 | wrong_m2 | missed_m2
    area.outside_kept_as_structure
    area.confusion.truth | label | counts        row and column names, cubes before any rule is applied
    area_scan, points, points_scan               the same for the labels of single scans, and by points
    missing                                      what could not be compared, and why
    scans.counted | skipped | without_truth      of all lidars that were labelled
    doors.true | passed | found_count | found | detections | invented_count | invented
    doors.width_error_m | width_bias_m | state_right
    doors.by_design.<design, state>.passed | found | state_right          where the truth tells how its doors look
    elements.<name>.truth | seen | cubes | recall | labels                where the truth tells where its parts are
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
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label, Truth
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.truth.doors import DOOR_RETURNS, DoorFigures, FoundDoors, TrueDoors, compare_doors
from ffmap.algorithms.truth.elements import Element, doors_by_design, tally_elements
from ffmap.algorithms.truth.labels import class_figures, outside_kept
from ffmap.algorithms.truth.maps import ComparedMaps, compare_with_truth
from ffmap.algorithms.truth.poses import TrajectoryFigures, compare_trajectories, rms
from ffmap.algorithms.truth.rooms import RoomFigures, compare_rooms
from ffmap.algorithms.truth.tally import CUBE_M, Tally, confusion_by_area
from ffmap.app.analysis import map_figures
from ffmap.app.analysis.counting import LabelledClouds, Layer, count_run
from ffmap.app.analysis.metrics_tables import Metrics, format_metrics
from ffmap.app.folder import names as run_names
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.pictures import write_overlays
from ffmap.app.folder.room_files import outlines
from ffmap.app.tables import in_markdown
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import read_features, segments
from ffmap.loaders.rig import Lidar
from ffmap.loaders.trajectory_file import read_tum
from ffmap.loaders.truth import BUILDING_TOPIC, CLASSES_TOPIC, POSE_TOPIC, carries_truth, read_truth
from ffmap.loaders.truth import Truth as BagTruth

TRUTH_SUFFIXES = (".tum", ".txt")
"""Of files with the true poses alone."""
_DEFAULT_DOOR_HEIGHT_M = 2.0
_FIG_10 = ("found", "recall", "precision", "split", "merged")
_FRAMES_APART_M = 1_000.0
"""Distance in metres from the true poses beyond which poses are not wrong but given in another frame, as in UTM."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A run beside the truth; what the run does not have is None. parts: of the layer with its errors."""

    metrics: Metrics
    faces: FloatArray
    doors: TrueDoors
    tally: Tally | None = None
    parts: tuple[Path, ...] = ()
    lidars: tuple[Lidar, ...] = ()
    compared_doors: tuple[FoundDoors, DoorFigures] | None = None
    maps: ComparedMaps = field(default_factory=dict)


def evaluate_run(run: FinishedRun, truth_bag: BagPath | None = None, workers: int = 2) -> Metrics:
    """Compare a run's files with the truth, write `metrics.json` and return what it says.

    Where the run has a recording, `evaluation.rrd` becomes its second layer.

    truth_bag: the bag that carries the truth, or a TUM file of the true poses alone; None for the bag that the run was made
    from. workers: processes that are started where there is enough to do.
    Raises InputError where the run does not say which bag it was made from, or the bag has no truth, where run and truth
    have nothing in common, and where nothing can be written into the run folder.
    """
    run_names.require_writable(run.path, "the figures are written there: change its permissions, or evaluate a copy")
    truth_path = truth_bag if truth_bag is not None else _bag_of(run)
    with _opened_truth(truth_path) as truth, tempfile.TemporaryDirectory(prefix="evaluation-", dir=run.path) as spool:
        if truth is None or truth.trajectory is None:
            raise InputError(
                f"{truth_path}: the bag carries no {POSE_TOPIC} to compare with; give a bag that does, or a TUM file of the "
                "true poses, to --truth"
            )
        recorded = run.recording is not None and "recording_id" in run.record
        layer = Layer(Path(spool), run.record["recording_id"]) if recorded else None
        comparison = compare_run(run, truth_path, truth, workers, layer)
        run_names.check_same_run(run_names.RunFolder(run.path), run.record)
        write_json(run.path / run_names.METRICS, comparison.metrics)
        if comparison.maps:
            write_overlays(
                run.path / run_names.OVERLAY, comparison.maps, map_figures.walls_direction_deg(run.path)
            )
        if layer is not None and comparison.tally is not None:
            _write_layer(run, layer, comparison, comparison.tally)
    return comparison.metrics


@contextmanager
def _opened_truth(path: BagPath) -> Iterator[BagTruth | None]:
    """A bag's truth, which can be read within the context; of a TUM file, the poses. None where a bag carries none."""
    file, *others = path.parts
    if not others and file.suffix.lower() in TRUTH_SUFFIXES:
        yield BagTruth(read_tum(file), None)
        return
    with open_bag(path) as bag:
        yield read_truth(bag)


def _write_layer(run: FinishedRun, layer: Layer, comparison: Comparison, tally: Tally) -> None:
    # Rerun is not needed where a run has no recording.
    from ffmap.app.record.errors import MapErrors, write_layer

    own = comparison.maps.get(entities.FURNITURE_FREE)
    layout = run_blueprint.build(
        True,
        *run_blueprint.view_of(own.grid if own else None),
        evaluated=True,
        scans=run.has_scans,
        registered=run.registered,
        lines=run.has_lines,
        several_lidars=len(comparison.lidars) > 1,
    )
    errors = MapErrors(
        metrics=comparison.metrics,
        text=in_markdown(format_metrics(comparison.metrics)),
        tally=tally,
        faces=comparison.faces,
        doors=comparison.doors,
        compared_doors=comparison.compared_doors,
        maps=comparison.maps,
    )
    write_layer(run.path / run_names.EVALUATION, comparison.parts, layer.recording_id, layout, errors)


def has_truth(run: FinishedRun) -> bool:
    """Whether the bag of a run is still there and carries the truth."""
    path = _bag_of(run)
    return path.missing is None and carries_truth(path)


def compare_run(
    run: FinishedRun, truth_path: BagPath, truth: BagTruth, workers: int, layer: Layer | None = None
) -> Comparison:
    """A run beside the truth, nothing written but the parts of the layer, if one is wanted."""
    assert truth.trajectory is not None
    metrics: Metrics = {"truth": str(truth_path)}
    missing = list(_missing(run, truth))
    if run.trajectory is not None:
        metrics["trajectory"], poses_missing = _compare_poses(run, run.trajectory, truth_path, truth.trajectory)
        missing = [*poses_missing, *missing]
    clouds = _clouds_of(run)
    if run.trajectory is None and clouds is None:
        raise InputError(
            f"{run.path}: holds nothing to compare with the truth, the run is {run.outcome}; "
            f"'ffmap run --resume {run.path}' goes on with one that was stopped"
        )
    metrics |= {"missing": missing} if missing else {}
    metrics |= {"statistics": run.record["statistics"]} if run.record.get("statistics") else {}
    building = None if run.map_origin_m[:2].any() else truth.building
    if building is not None:
        metrics |= _rooms_of_maps(run, building, truth.trajectory)
    doors, faces = read_building(building)
    if clouds is None or not truth.classes:
        return Comparison(metrics, faces, doors)
    topics = truth.classes_topics([lidar.frame_id for lidar in clouds.lidars])
    untold = [lidar for lidar, topic in zip(clouds.lidars, topics, strict=True) if topic is None]
    if untold:
        frames = ", ".join(f"{lidar.topic} (frame {lidar.frame_id})" for lidar in untold)
        metrics["missing"] = [*missing, f"labels of {frames}: no {CLASSES_TOPIC} has clouds of that frame"]
    if len(untold) == len(topics):
        return Comparison(metrics, faces, doors)
    shown = layer if run.has_scans else None
    counted = count_run(clouds, truth_path, truth.trajectory, topics, doors, workers, shown)
    tally = counted.tally
    metrics |= {
        "scans": {"counted": tally.scans, "skipped": tally.skipped, "without_truth": counted.without_truth},
        "area": _label_metrics(confusion_by_area(tally.cubes), CUBE_M**2),
        "area_scan": _label_metrics(confusion_by_area(tally.cubes, single_scans=True), CUBE_M**2),
        "points": _label_metrics(tally.confusion_points, None),
        "points_scan": _label_metrics(tally.confusion_points_scan, None),
    }
    if building is not None and (elements := read_elements(building)):
        metrics["elements"] = {
            name: {"truth": own.truth.name.lower(), "seen": own.seen, "cubes": own.cubes, "recall": own.recall,
                   "labels": dict(own.labels)}
            for name, own in tally_elements(elements, tally.cubes).items()
        }  # fmt: skip
    comparison = Comparison(metrics, faces, doors, tally, counted.parts, clouds.lidars)
    if building is not None and (doors_path := run.file(run_names.DOORS)) is not None:
        found_doors = read_doors(doors_path)
        door_figures = compare_doors(doors, tally.door_returns, found_doors)
        metrics["doors"] = _door_metrics(door_figures)
        if designs := read_designs(building):
            by_design = doors_by_design(designs, door_figures)
            metrics["doors"]["by_design"] = {
                name: {"passed": own.passed, "found": own.found, "state_right": own.state_right}
                for name, own in by_design.items()
            }
        comparison = replace(comparison, compared_doors=(found_doors, door_figures))
    if building is not None and (maps := map_figures.read_maps(run.path)):
        passed = tally.door_returns >= DOOR_RETURNS
        wall_m = map_figures.wall_thickness_of_doors(building)
        compared = compare_with_truth(maps, faces, tally, doors.ends[passed], wall_m[passed])
        metrics["maps"] = map_figures.map_metrics(compared)
        if entities.FURNITURE_FREE in compared:
            metrics["wall_map"] = metrics["maps"][entities.FURNITURE_FREE]
        comparison = replace(comparison, maps=compared)
    return comparison


def _compare_poses(
    run: FinishedRun, poses: Path, truth_path: BagPath, true_trajectory: Trajectory
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
    if not truth.classes and truth.building is None:
        yield "labels, doors, maps and rooms: the truth has poses alone"
        return
    if run.trajectory is None:
        yield f"trajectory: {_lacks(run, run_names.TRAJECTORY, None)}"
    if not truth.classes:
        yield f"labels, doors and maps: the truth has no {CLASSES_TOPIC}"
    elif run.file(run_names.LABELS) is None:
        yield f"labels, doors and maps: {_lacks(run, run_names.LABELS, 'labels')}"
    if truth.building is None:
        yield f"doors, maps and rooms: the truth has no {BUILDING_TOPIC}"
        return
    if run.map_origin_m[:2].any():
        yield "doors, maps and rooms: the map's origin lies elsewhere than that of its poses (run.json: map_origin)"
        return
    for what, name, output in (
        ("doors", run_names.DOORS, "geojson"),
        ("rooms", run_names.rooms_file(Segmented.FURNITURE_FREE), "geojson"),
        ("maps", run_names.map_file(entities.FURNITURE_FREE), "maps"),
    ):
        if run.file(name) is None:
            yield f"{what}: {_lacks(run, name, output)}"


def _lacks(run: FinishedRun, name: str, output: str | None) -> str:
    why = f"; --outputs with {output} writes it" if run.complete and output is not None else ""
    return f"the run has no {name}" + (why or f", it is {run.outcome}")


def _clouds_of(run: FinishedRun) -> LabelledClouds | None:
    """The run's labels beside its bag's clouds; None where it kept none."""
    labels = run.file(run_names.LABELS)
    if labels is None:
        return None
    path = _bag_of(run)
    with open_bag(path) as bag:
        return LabelledClouds(path, run.find_lidars(bag).verticals, labels)


def _rooms_of_maps(run: FinishedRun, building: Mapping[str, Any], true_trajectory: Trajectory) -> Metrics:
    """The rooms of the run's own map, and in short those of the maps that the paper compares with."""
    files = {name: path for name in Segmented if (path := run.file(run_names.rooms_file(name))) is not None}
    compared = {name: _compare_rooms(path, building, true_trajectory) for name, path in files.items()}
    if Segmented.FURNITURE_FREE not in compared:
        return {}
    in_short = {name: {figure: own[figure] for figure in _FIG_10} for name, own in compared.items()}
    return {"rooms": compared[Segmented.FURNITURE_FREE], "rooms_of_maps": in_short}


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
            heads_m.append(float(properties.get("height", _DEFAULT_DOOR_HEIGHT_M)))
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


def read_designs(building: Mapping[str, Any]) -> list[str]:
    """How each true door looks, and its state; empty where the truth does not tell."""
    doors = [own["properties"] for own in building["features"] if own["properties"]["kind"] == "door"]
    return [f"{door['design']}, {door['state']}" for door in doors if "design" in door]


def read_elements(building: Mapping[str, Any]) -> list[Element]:
    """The features of the kind `element`: Polygons with a name, a class, and a lowest and highest place."""
    return [
        Element(
            own["properties"]["element"], Truth[own["properties"]["truth"].upper()],
            shapely.Polygon(own["geometry"]["coordinates"][0]), (own["properties"]["bottom"], own["properties"]["height"])
        )
        for own in building["features"] if own["properties"]["kind"] == "element"
    ]  # fmt: skip


def _compare_rooms(path: Path, building: Mapping[str, Any], true_trajectory: Trajectory) -> Metrics:
    true = [feature for feature in building["features"] if feature["properties"]["kind"] == "room"]
    rooms = [feature["properties"].get("name", str(i)) for i, feature in enumerate(true)]
    way = true_trajectory.T_map_base[:, :3, 3]
    found = read_features(path, "outlines", "give the folder of a run of ffmap")
    return _room_metrics(compare_rooms(outlines(true), outlines(found), way), rooms)


def read_doors(path: Path) -> FoundDoors:
    """A run's `doors.geojson`."""
    features = read_features(path, "doors", "give the folder of a run of ffmap")
    return FoundDoors(
        ends=segments(features),
        width_m=np.array([feature["properties"]["width"] for feature in features], float),
        state=np.array([_state(feature["properties"]["state"]) for feature in features], np.uint8),
    )


def _label_metrics(confusion: IntArray, unit_m2: float | None) -> Metrics:
    """Of each label, the figures and counts; as areas where `unit_m2` says what one count is."""
    section: Metrics = {}
    for label, figures in class_figures(confusion).items():
        counts: dict[str, float] = {
            "right": figures.true_positives,
            "wrong": figures.false_positives,
            "missed": figures.false_negatives,
        }
        if unit_m2 is not None:
            counts = {f"{name}_m2": round(count * unit_m2, 4) for name, count in counts.items()}
        shares = {"precision": figures.precision, "recall": figures.recall, "f1": figures.f1}
        section[label.name.lower()] = shares | counts
    section["outside_kept_as_structure"] = outside_kept(confusion)
    section["confusion"] = {
        "truth": [truth.name.lower() for truth in Truth],
        "label": [*(label.name.lower() for label in Label), "unlabelled"],
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
    metrics: Metrics = {"poses": figures.poses}
    for name, error_m in (("ate", figures.error_m), ("unaligned", figures.error_unaligned_m)):
        metrics[f"{name}_rmse_m"] = rms(error_m)
        metrics[f"{name}_mean_m"] = _mean(error_m)
        metrics[f"{name}_max_m"] = float(error_m.max())
    return metrics | {
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


def _bag_of(run: FinishedRun) -> BagPath:
    """The bag that a run was made from; it may be gone."""
    if run.bag_path is None:
        raise InputError(f"{run.path / run_names.RUN_JSON}: it does not say which bag was run; give --truth BAG")
    return run.bag_path
