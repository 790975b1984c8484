"""ffmap evaluate: compare a run with the ground truth; writes metrics.json and evaluation.rrd.

`app.analysis.figures` describes the content of metrics.json. Doors, maps and rooms are compared in
the map's frame, which is defined alike for run and ground truth.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.segments import main_direction_deg
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.truth.doors import RETURNS_MIN, DoorComparison, FoundDoors, compare_doors
from ffmap.algorithms.truth.elements import doors_by_design, tally_elements
from ffmap.algorithms.truth.maps import ComparedMap, compare_map
from ffmap.algorithms.truth.poses import compare_trajectories
from ffmap.algorithms.truth.rooms import compare_rooms
from ffmap.algorithms.truth.tally import Tally
from ffmap.app.analysis import figures
from ffmap.app.analysis.counting import Counting, count_run
from ffmap.app.analysis.figures import Metrics
from ffmap.app.analysis.ground_truth import TrueBuilding, door_state, parse_building
from ffmap.app.analysis.metrics_tables import format_metrics
from ffmap.app.folder import names
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.map_files import read_map
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
from ffmap.loaders.text_files import dotted_keys
from ffmap.loaders.trajectory_file import read_tum
from ffmap.loaders.truth import (
    BUILDING_TOPIC,
    CLASSES_TOPIC,
    POSE_TOPIC,
    Truth,
    carries_truth,
    read_truth,
)

_TRUTH_SUFFIXES = (".tum", ".txt")
"""Of files with the true poses alone."""
_FRAMES_APART_M = 1_000.0
"""Poses farther (m) from the true ones are given in another frame, as in UTM."""
_ADVICE = "give the folder of a run of ffmap"


def evaluate_run(run: FinishedRun, truth_bag: BagPath | None = None, workers: int = 2) -> Metrics:
    """Compare a run with the ground truth, write its metrics.json and return the content.

    Args:
        truth_bag: bag with the ground truth, or a TUM file of the true poses; None for the run's.
        workers: number of processes.

    Raises InputError if run and ground truth have nothing in common, or the folder is read-only.
    """
    advice = "the figures are written there: change its permissions, or evaluate a copy"
    names.require_writable(run.path, advice)
    if run.trajectory is None and run.file(names.LABELS) is None:
        raise InputError(
            f"{run.path}: holds nothing to compare with the ground truth, the run is "
            f"{run.outcome}; 'ffmap run --resume {run.path}' continues one that was stopped"
        )
    path = truth_bag if truth_bag is not None else _bag_of(run)
    with (
        _open_truth(path) as truth,
        tempfile.TemporaryDirectory(prefix="evaluation-", dir=run.path) as spool,
    ):
        recorded = run.recording is not None and run.record.recording_id != ""
        evaluation = _compare(run, path, truth, workers, Path(spool) if recorded else None)
        write_json(run.path / names.METRICS, evaluation.metrics)
        if evaluation.maps:
            direction_deg = walls_direction_deg(run.path)
            write_overlays(run.path / names.OVERLAY, evaluation.maps, direction_deg)
        if recorded and evaluation.tally is not None:
            evaluation.write_layer(Path(spool))
    return evaluation.metrics


def _compare(
    run: FinishedRun, path: BagPath, truth: Truth, workers: int, spool: Path | None
) -> "_Evaluation":
    """Compare all that run and ground truth have. spool: see `_Evaluation.compare_labels`."""
    assert truth.trajectory is not None
    building, labels = truth.building, run.file(names.LABELS)
    found = _Evaluation(run, path, truth.trajectory, parse_building(building or {"features": []}))
    found.metrics["truth"] = str(path)
    found.compare_poses()
    found.metrics |= dotted_keys(run.record.statistics)
    if not truth.classes and building is None:
        found.missing.append("labels, doors, maps and rooms: the truth has poses alone")
    elif building is None:
        found.missing.append(f"doors, maps and rooms: the truth has no {BUILDING_TOPIC}")
    elif any(run.record.map_origin[:2]):
        building, found.building = None, parse_building({"features": []})
        found.missing.append("doors, maps and rooms: the map's origin is not that of its poses")
    else:
        found.compare_rooms()
    if truth.classes and labels is not None:
        found.compare_labels(labels, truth, workers, spool)
    elif truth.classes:
        found.report_missing("labels, doors and maps", names.LABELS, "labels")
    elif building is not None:
        found.missing.append(f"labels, doors and maps: the truth has no {CLASSES_TOPIC}")
    if building is not None and found.tally is not None and found.voxels is not None:
        found.compare_doors(found.tally)
        found.compare_maps(found.tally, found.voxels)
    if found.missing:
        found.metrics["missing"] = found.missing
    return found


def has_truth(run: FinishedRun) -> bool:
    """Return whether the bag of a run is still there and has ground truth."""
    path = _bag_of(run)
    return path.missing is None and carries_truth(path)


@contextmanager
def _open_truth(path: BagPath) -> Iterator[Truth]:
    """Open a bag's ground truth, or a TUM file of the true poses."""
    file, *others = path.parts
    if not others and file.suffix.lower() in _TRUTH_SUFFIXES:
        yield Truth(read_tum(file), None, {})
        return
    with open_bag(path) as bag:
        truth = read_truth(bag)
        if truth is None or truth.trajectory is None:
            raise InputError(
                f"{path}: the bag has no {POSE_TOPIC} to compare with; give a bag that does, or a "
                "TUM file of the true poses, to --truth"
            )
        yield truth


@dataclass(eq=False)
class _Evaluation:
    """A run compared with the ground truth.

    metrics: all figures. missing: what could not be compared, and why. The last attributes are
    what the recording shows; None or empty for what run or ground truth lack.
    """

    run: FinishedRun
    truth_path: BagPath
    trajectory: Trajectory
    building: TrueBuilding
    metrics: Metrics = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    lidars: tuple[Lidar, ...] = ()
    tally: Tally | None = None
    voxels: VoxelVotes | None = None
    doors: tuple[FoundDoors, DoorComparison] | None = None
    maps: dict[str, ComparedMap] = field(default_factory=dict)

    def report_missing(self, what: str, name: str, output: str | None) -> None:
        """Report a file that the run does not have. output: which of `--outputs` writes it."""
        writes = self.run.complete and output is not None
        why = f"; --outputs with {output} writes it" if writes else f", it is {self.run.outcome}"
        self.missing.append(f"{what}: the run has no {name}{why}")

    def compare_poses(self) -> None:
        """Compare poses in the frame in which they were given."""
        poses = self.run.trajectory
        if poses is None:
            self.report_missing("trajectory", names.TRAJECTORY, None)
            return
        T_given_map = transforms.make_transform(translation=np.array(self.run.record.map_origin))
        errors = compare_trajectories(read_tum(poses).moved(T_given_map), self.trajectory)
        if not len(errors.error_m):
            raise InputError(
                f"{self.truth_path}: has no pose of a time at which the run {self.run.path} has "
                "one; give the truth of the same drive"
            )
        self.metrics |= figures.trajectory_figures(errors)
        apart_m = float(np.median(errors.error_unaligned_m))
        if apart_m >= _FRAMES_APART_M:
            unaligned = [name for name in self.metrics if name.startswith("trajectory.unaligned")]
            self.metrics |= dict.fromkeys(unaligned, float("nan"))
            self.missing.append(
                f"unaligned poses: the run's are {apart_m / 1e3:.1f} km from the true ones, so "
                "the two are given in different frames"
            )

    def compare_rooms(self) -> None:
        """Compare the rooms of the run's own map and of those that the paper compares with."""
        if self.run.file(names.ROOMS) is None:
            self.report_missing("rooms", names.ROOMS, "geojson")
        for name in figures.ROOM_MAPS:
            if (file := self.run.file(names.rooms_file(name))) is not None:
                found = outlines(read_features(file, "outlines", _ADVICE))
                path_map = self.trajectory.T_map_base[:, :3, 3]
                rooms = compare_rooms(self.building.rooms, found, path_map)
                self.metrics |= figures.room_figures(name, rooms, self.building.room_names)

    def compare_labels(self, labels: Path, truth: Truth, workers: int, spool: Path | None) -> None:
        """Compare labels by area and by points, final ones and those of single scans.

        spool: folder for the recording of each scan's errors, None for none.
        """
        bag_path = _bag_of(self.run)
        with open_bag(bag_path) as bag:
            lidars = self.run.find_lidars(bag).verticals
        topics = tuple(truth.classes.get(lidar.frame_id) for lidar in lidars)
        without = [
            f"{lidar.topic} (frame {lidar.frame_id})"
            for lidar, topic in zip(lidars, topics, strict=True)
            if topic is None
        ]
        if without:
            frames = ", ".join(without)
            self.missing.append(f"labels of {frames}: no {CLASSES_TOPIC} has clouds of that frame")
        if len(without) == len(topics):
            return
        counting = Counting(
            bag=bag_path,
            lidars=lidars,
            labels=labels,
            truth_bag=self.truth_path,
            topics=topics,
            trajectory=self.trajectory,
            doors=self.building.doors,
            spool=spool if self.run.has_scans else None,
            recording_id=self.run.record.recording_id,
        )
        self.lidars, self.tally = lidars, count_run(counting, workers)
        if self.tally.without_truth and not self.tally.scans:
            raise InputError(
                f"{self.truth_path}: has no ground truth of any scan of {self.run.path}; give the "
                "truth of the same drive"
            )
        self.voxels = self.tally.voxels()
        self.metrics |= figures.tally_figures(self.tally, self.voxels)
        if self.building.elements:
            self.metrics["elements"] = tally_elements(self.building.elements, self.voxels)

    def compare_doors(self, tally: Tally) -> None:
        path = self.run.file(names.DOORS)
        if path is None:
            self.report_missing("doors", names.DOORS, "geojson")
            return
        found = read_doors(path)
        doors = compare_doors(self.building.doors, tally.door_returns, found)
        self.doors = found, doors
        self.metrics |= figures.door_figures(doors)
        if designs := self.building.designs:
            self.metrics["doors.by_design"] = doors_by_design(designs, doors)

    def compare_maps(self, tally: Tally, voxels: VoxelVotes) -> None:
        building, passed = self.building, tally.door_returns >= RETURNS_MIN
        doors, wall_m = building.doors.ends[passed], building.door_wall_m[passed]
        for name in figures.MAPS:
            if (path := self.run.file(names.map_file(name))) is not None:
                own = compare_map(read_map(path), building.faces, voxels, doors, wall_m)
                self.maps[name] = own
                self.metrics |= figures.map_figures(name, own)
        if entities.FURNITURE_FREE not in self.maps:
            self.report_missing("maps", names.map_file(entities.FURNITURE_FREE), "maps")

    def write_layer(self, spool: Path) -> None:
        """Write evaluation.rrd, the second layer of the run's recording."""
        # Rerun is not needed where a run has no recording.
        from ffmap.app.record.errors import write_layer

        run, own = self.run, self.maps.get(entities.FURNITURE_FREE)
        assert self.voxels is not None
        layout = run_blueprint.build(
            True,
            *run_blueprint.view_of(own.grid if own else None),
            evaluated=True,
            scans=run.has_scans,
            registered=run.registered,
            lines=run.has_lines,
            several_lidars=len(self.lidars) > 1,
        )
        write_layer(
            run.path / names.EVALUATION,
            spool,
            run.record.recording_id,
            layout,
            properties=figures.comparable(self.metrics),
            text=in_markdown(format_metrics(self.metrics)),
            voxels=self.voxels,
            faces=self.building.faces,
            true_doors=self.building.doors,
            found_doors=self.doors,
            maps=self.maps,
        )


def read_doors(path: Path) -> FoundDoors:
    """Read a run's doors.geojson."""
    features = read_features(path, "doors", _ADVICE)
    properties = [feature["properties"] for feature in features]
    return FoundDoors(
        ends=segments(features),
        width_m=np.array([own["width"] for own in properties], float),
        state=np.array([door_state(own["state"]) for own in properties], np.uint8),
    )


def walls_direction_deg(run_dir: Path) -> float:
    """Return the direction of most walls of a run; 0 without a file of walls."""
    path = run_dir / names.WALLS
    if not path.exists():
        return 0.0
    return main_direction_deg(segments(read_features(path, "lines", "run ffmap again")))


def _bag_of(run: FinishedRun) -> BagPath:
    """The bag that a run was made from; it may be missing."""
    if run.bag_path is None:
        raise InputError(f"{run.path / names.RUN_JSON}: names no bag; give --truth BAG")
    return run.bag_path
