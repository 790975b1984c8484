"""`ffmap evaluate`: compare a run with the ground truth; writes metrics.json and evaluation.rrd.

`app.analysis.figures` describes the content of metrics.json. Doors, maps and rooms are compared in
the map's frame, which is defined alike for run and ground truth.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.segments import main_direction_deg
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.truth.doors import RETURNS_MIN, DoorComparison, FoundDoors, compare_doors
from ffmap.algorithms.truth.elements import doors_by_design, tally_elements
from ffmap.algorithms.truth.labels import outside_kept, right_wrong_missed
from ffmap.algorithms.truth.maps import ComparedMap, compare_map
from ffmap.algorithms.truth.poses import compare_trajectories
from ffmap.algorithms.truth.rooms import compare_rooms
from ffmap.algorithms.truth.tally import VOXEL_M, Tally, confusion_by_area
from ffmap.app.analysis import figures
from ffmap.app.analysis.counting import Counting, count_run
from ffmap.app.analysis.figures import Metrics
from ffmap.app.analysis.ground_truth import door_state, parse_building
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
    path = truth_bag if truth_bag is not None else _bag_of(run)
    with (
        _open_truth(path) as truth,
        tempfile.TemporaryDirectory(prefix="evaluation-", dir=run.path) as spool,
    ):
        recorded = run.recording is not None and "recording_id" in run.record
        evaluation = _Evaluation(run, path, truth)
        evaluation.compare(workers, Path(spool) if recorded else None)
        names.check_same_run(names.RunFolder(run.path), run.record)
        write_json(run.path / names.METRICS, evaluation.metrics)
        if evaluation.maps:
            direction_deg = walls_direction_deg(run.path)
            write_overlays(run.path / names.OVERLAY, evaluation.maps, direction_deg)
        if recorded and evaluation.tally is not None:
            evaluation.write_layer(Path(spool))
    return evaluation.metrics


def has_truth(run: FinishedRun) -> bool:
    """Return whether the bag of a run is still there and has ground truth."""
    path = _bag_of(run)
    return path.missing is None and carries_truth(path)


@contextmanager
def _open_truth(path: BagPath) -> Iterator[Truth]:
    """Open a bag's ground truth, or a TUM file of the true poses."""
    file, *others = path.parts
    if not others and file.suffix.lower() in _TRUTH_SUFFIXES:
        yield Truth(read_tum(file), None)
        return
    with open_bag(path) as bag:
        truth = read_truth(bag)
        if truth is None or truth.trajectory is None:
            raise InputError(
                f"{path}: the bag has no {POSE_TOPIC} to compare with; give a bag that does, or a "
                "TUM file of the true poses, to --truth"
            )
        yield truth


class _Evaluation:
    """A run compared with the ground truth.

    metrics: all figures. missing: what could not be compared, and why. The other attributes are
    what the recording shows; None or empty for what run or ground truth lack.
    """

    def __init__(self, run: FinishedRun, truth_path: BagPath, truth: Truth) -> None:
        assert truth.trajectory is not None
        self._run, self._truth_path, self._truth = run, truth_path, truth
        self._true_trajectory = truth.trajectory
        self._building = parse_building({"features": []})
        self.metrics: Metrics = {"truth": str(truth_path)}
        self.missing: list[str] = []
        self.lidars: tuple[Lidar, ...] = ()
        self.tally: Tally | None = None
        self.voxels: VoxelVotes | None = None
        self.doors: tuple[FoundDoors, DoorComparison] | None = None
        self.maps: dict[str, ComparedMap] = {}

    def compare(self, workers: int, spool: Path | None) -> None:
        """Compare all that run and ground truth have.

        spool: folder for the recording of each scan's errors, None for none.
        """
        run, truth, labels = self._run, self._truth, self._run.file(names.LABELS)
        if run.trajectory is None and labels is None:
            raise InputError(
                f"{run.path}: holds nothing to compare with the ground truth, the run is "
                f"{run.outcome}; 'ffmap run --resume {run.path}' continues one that was stopped"
            )
        self._compare_poses(run.trajectory)
        self.metrics |= dotted_keys(run.record.get("statistics") or {})
        building = truth.building
        if not truth.classes and building is None:
            self.missing.append("labels, doors, maps and rooms: the truth has poses alone")
        elif building is None:
            self.missing.append(f"doors, maps and rooms: the truth has no {BUILDING_TOPIC}")
        elif run.map_origin_m[:2].any():
            building = None
            self.missing.append("doors, maps and rooms: the map's origin is not that of its poses")
        if building is not None:
            self._building = parse_building(building)
            self._compare_rooms()
        if labels is None and truth.classes:
            self._report_missing("labels, doors and maps", names.LABELS, "labels")
        elif labels is not None and truth.classes:
            self._compare_labels(labels, workers, spool)
        elif building is not None:
            self.missing.append(f"labels, doors and maps: the truth has no {CLASSES_TOPIC}")
        if building is not None and self.tally is not None and self.voxels is not None:
            self._compare_doors(self.tally)
            self._compare_maps(self.tally, self.voxels)
        if self.missing:
            self.metrics["missing"] = self.missing

    def _report_missing(self, what: str, name: str, output: str | None) -> None:
        """Report a file that the run does not have. output: which of `--outputs` writes it."""
        writes = self._run.complete and output is not None
        why = f"; --outputs with {output} writes it" if writes else f", it is {self._run.outcome}"
        self.missing.append(f"{what}: the run has no {name}{why}")

    def _compare_poses(self, poses: Path | None) -> None:
        """Compare poses in the frame in which they were given."""
        if poses is None:
            self._report_missing("trajectory", names.TRAJECTORY, None)
            return
        T_given_map = transforms.make_transform(translation=self._run.map_origin_m)
        errors = compare_trajectories(read_tum(poses).moved(T_given_map), self._true_trajectory)
        if not len(errors.error_m):
            raise InputError(
                f"{self._truth_path}: has no pose of a time at which the run {self._run.path} has "
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

    def _compare_rooms(self) -> None:
        """Compare the rooms of the run's own map and of those that the paper compares with."""
        if self._run.file(names.ROOMS) is None:
            self._report_missing("rooms", names.ROOMS, "geojson")
        path_map = self._true_trajectory.T_map_base[:, :3, 3]
        for name in figures.ROOM_MAPS:
            if (file := self._run.file(names.rooms_file(name))) is not None:
                found = outlines(read_features(file, "outlines", _ADVICE))
                rooms = compare_rooms(self._building.rooms, found, path_map)
                self.metrics |= figures.room_figures(name, rooms, self._building.room_names)

    def _compare_labels(self, labels: Path, workers: int, spool: Path | None) -> None:
        """Compare labels by area and by points, final ones and those of single scans."""
        bag_path = _bag_of(self._run)
        with open_bag(bag_path) as bag:
            lidars = self._run.find_lidars(bag).verticals
        topics = tuple(self._truth.classes_topics([lidar.frame_id for lidar in lidars]))
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
            truth_bag=self._truth_path,
            topics=topics,
            trajectory=self._true_trajectory,
            doors=self._building.doors,
            spool=spool if self._run.has_scans else None,
            recording_id=str(self._run.record.get("recording_id")),
        )
        tally = count_run(counting, workers)
        voxels = tally.voxels()
        self.lidars, self.tally, self.voxels = lidars, tally, voxels
        self.metrics["scans.counted"] = tally.scans
        self.metrics["scans.skipped"] = tally.skipped
        self.metrics["scans.without_truth"] = tally.without_truth
        for by, confusion, unit in (
            ("", confusion_by_area(voxels), VOXEL_M**2),
            ("single_scan.", confusion_by_area(voxels, single_scans=True), VOXEL_M**2),
            ("points.", tally.confusion_points[0], 1),
            ("points.single_scan.", tally.confusion_points[1], 1),
        ):
            counts, outside = right_wrong_missed(confusion), outside_kept(confusion)
            self.metrics |= figures.label_figures(by, counts, outside, confusion, unit)
        if self._building.elements:
            self.metrics["elements"] = tally_elements(self._building.elements, voxels)

    def _compare_doors(self, tally: Tally) -> None:
        path = self._run.file(names.DOORS)
        if path is None:
            self._report_missing("doors", names.DOORS, "geojson")
            return
        found = read_doors(path)
        doors = compare_doors(self._building.doors, tally.door_returns, found)
        self.doors = found, doors
        self.metrics |= figures.door_figures(doors)
        if designs := self._building.designs:
            self.metrics["doors.by_design"] = doors_by_design(designs, doors)

    def _compare_maps(self, tally: Tally, voxels: VoxelVotes) -> None:
        building, passed = self._building, tally.door_returns >= RETURNS_MIN
        for name in figures.MAPS:
            path = self._run.file(names.map_file(name))
            if path is not None:
                doors, wall_m = building.doors.ends[passed], building.door_wall_m[passed]
                own = compare_map(read_map(path), building.faces, voxels, doors, wall_m)
                self.maps[name] = own
                self.metrics |= figures.map_figures(name, own)
        if entities.FURNITURE_FREE not in self.maps:
            self._report_missing("maps", names.map_file(entities.FURNITURE_FREE), "maps")

    def write_layer(self, spool: Path) -> None:
        """Write evaluation.rrd, the second layer of the run's recording."""
        # Rerun is not needed where a run has no recording.
        from ffmap.app.record.errors import write_layer

        run, own = self._run, self.maps.get(entities.FURNITURE_FREE)
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
            str(run.record["recording_id"]),
            layout,
            properties=figures.comparable(self.metrics),
            text=in_markdown(format_metrics(self.metrics)),
            voxels=self.voxels,
            faces=self._building.faces,
            true_doors=self._building.doors,
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
