"""A run from beginning to end: odometry, scans, building, final; each stage as it stands in the design.

Scans are labelled once all poses are final: the last loop of a drive may move the first scan.
"""

import shutil
import time
import uuid
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.fusion import AllScans, Building, fuse_building
from ffmap.algorithms.building.model import BuildingSettings, Walls, Windows
from ffmap.algorithms.building.ray_evidence import WallCells, trace_rays
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, fuse, majority
from ffmap.algorithms.building.windows import without_rays_through
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.algorithms.maps.grid import Drive, GridMap
from ffmap.algorithms.maps.rivals import Rival
from ffmap.algorithms.poses.odometry import Registration, weakness
from ffmap.algorithms.scan.summary import Features
from ffmap.app.folder import writers as results
from ffmap.app.folder.finished_run import FROM_ODOMETRY
from ffmap.app.folder.labels_file import LabelsWriter
from ffmap.app.folder.names import (
    CLOUD,
    DOORS,
    FLOOR_PLAN_DXF,
    FLOOR_PLAN_SVG,
    LABELS,
    PROGRAM,
    RECORDING,
    TRAJECTORY,
    WALLS,
    RunFolder,
    map_file,
    rooms_file,
    written_files,
)
from ffmap.app.folder.plan_files import write_dxf, write_svg
from ffmap.app.folder.room_files import door_rooms, topology, write_rooms
from ffmap.app.progress import Progress
from ffmap.app.record.rooms import log_areas, log_rooms
from ffmap.app.record.scans import Detail, Recorder
from ffmap.app.record.stream import Recording
from ffmap.app.run.blocks import (
    FINAL_EVIDENCE,
    STAGES,
    VOXEL_M,
    Block,
    BlockSummary,
    FinishJob,
    LabelJob,
    finish_block,
    label_block,
    load_features,
    load_labels,
    load_rivals,
    load_summary,
    load_votes,
    save_halo,
    split_blocks,
)
from ffmap.app.run.odometry import Odometry
from ffmap.app.run.odometry_cache import CACHE_VARIABLE, cache_folder
from ffmap.app.run.poses import level_by_first_scans
from ffmap.app.run.workers import make_pool
from ffmap.app.setup.inputs import Inputs, digest_stamps, total_digest, why_skipped
from ffmap.app.setup.outputs import RUN_OUTPUTS, Output
from ffmap.app.setup.settings import Settings
from ffmap.app.setup.versions import versions
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_digest import joined
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import write_tum

_REGISTRATIONS_AT_ONCE = 50


@dataclass(frozen=True)
class RunOptions:
    """What is neither a setting of the method nor an input: how much is written, and where to."""

    detail: Detail = Detail.LINES
    outputs: tuple[Output, ...] = RUN_OUTPUTS
    connect_url: str | None = None
    workers: int = 2
    resume: bool = False


@dataclass
class RunState:
    """What a run gathers for run.json."""

    timings_s: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    counts: dict[str, Any] = field(default_factory=dict)
    statistics: dict[str, Any] = field(default_factory=dict)
    """Table I of the paper."""
    odometry_cached: bool = False
    clouds: dict[str, str] = field(default_factory=dict)
    """The digest of all clouds of each topic that was read to its end, by topic."""
    labels_digest: str = ""
    """See `LabelsWriter.digest`; empty where nothing was labelled."""
    topology: dict[str, Any] = field(default_factory=dict)
    """Rooms and passages."""


@dataclass(frozen=True)
class _Run:
    """What every stage of a run has at hand."""

    inputs: Inputs
    settings: Settings
    options: RunOptions
    folder: RunFolder
    progress: Progress
    record: dict[str, Any]
    recording: Recording | None
    recorder: Recorder | None
    state: RunState


def run(
    inputs: Inputs,
    given: Trajectory | None,
    settings: Settings,
    options: RunOptions,
    folder: RunFolder,
    progress: Progress,
    record: dict[str, Any],
) -> dict[str, Any]:
    """Run everything and write the run folder; returns what run.json holds.

    given: T_map_base in place of the odometry, or None. record: what run.json holds at the start; its `recording_id`
    names the recording.
    Raises InputError where the bag has no usable cloud.
    """
    started, worked = time.perf_counter(), time.process_time()
    state = RunState(warnings=list(inputs.warnings))
    folder.write_json({**record, "outcome": "running"})
    recording: Recording | None = None
    recorder: Recorder | None = None
    try:
        recording = _open(inputs, options, folder, record)
        scan_stamps_ns = inputs.vertical.index.stamp_ns if inputs.vertical else None
        recorder = Recorder(recording.stream, options.detail, scan_stamps_ns=scan_stamps_ns) if recording else None
        _run_stages(_Run(inputs, settings, options, folder, progress, record, recording, recorder, state), given)
        outcome = "complete"
        if options.workers == 1:
            # All of it was this process's work, whatever else the machine was busy with.
            state.timings_s["cpu"] = time.process_time() - worked
        _log_result(recorder, record, state, started, outcome)
        if recording is not None:
            recording.finish()
    except BaseException:
        folder.write_json({**record, **_gathered(record, state, started), "outcome": "aborted"})
        # What ended the run is what the user has to hear of.
        with suppress(Exception):
            _log_result(recorder, record, state, started, "aborted")
        with suppress(Exception):
            if recording is not None:
                recording.finish()
        raise
    record = {**record, **_gathered(record, state, started), "files": written_files(folder), "outcome": outcome}
    folder.write_json(record)
    shutil.rmtree(folder.spool, ignore_errors=True)
    return record


def _log_result(
    recorder: Recorder | None, record: dict[str, Any], state: RunState, started: float, outcome: str
) -> None:
    """As properties, which a list of runs asks for."""
    if recorder is not None:
        gathered = _gathered(record, state, started)
        result = {name: value for name, value in gathered.items() if name not in _TOLD_ELSEWHERE}
        recorder.log_properties("result", {**result, "bag_digest": gathered["bag"].get("digest"), "outcome": outcome})
        recorder.log_warnings(state.warnings)


def _open(inputs: Inputs, options: RunOptions, folder: RunFolder, record: dict[str, Any]) -> Recording | None:
    """The run's recording; None where none is wanted. Raises InputError where the viewer has gone."""
    save = Output.RECORDING in options.outputs
    if not save and options.connect_url is None:
        return None
    try:
        return Recording(
            folder.path / RECORDING if save else None,
            folder.spool,
            record["recording_id"],
            _layout(inputs, options.detail, record),
            options.connect_url,
        )
    except ConnectionError as error:
        raise InputError(
            f"{error}: the viewer has ended; is there a display? Leave --spawn or --connect out: the recording can be opened later"
        ) from error


_TOLD_ELSEWHERE = ("statistics", "warnings", "bag")
"""Among the metrics, as a text, and among the properties of the run."""


def _gathered(record: dict[str, Any], state: RunState, started: float) -> dict[str, Any]:
    return {
        "bag": _bag_as_read(record, state),
        "timings_s": {name: round(s, 3) for name, s in state.timings_s.items()}
        | {"total": round(time.perf_counter() - started, 3)},
        "counts": state.counts,
        "statistics": state.statistics,
        "warnings": state.warnings,
        "odometry_cached": state.odometry_cached,
        "labels_digest": state.labels_digest,
        "topology": state.topology,
    }


def _bag_as_read(record: dict[str, Any], state: RunState) -> dict[str, Any]:
    """What run.json says of the bag: with the digest of what was read of it, once all of that is known."""
    bag: dict[str, Any] = {**record["bag"], "clouds": state.clouds}
    read_whole = bag["stamps"].keys() == state.clouds.keys()
    return {**bag, "digest": total_digest(state.clouds)} if read_whole else bag


def _run_stages(run: _Run, given: Trajectory | None) -> None:
    inputs, settings, folder, recorder, state = run.inputs, run.settings, run.folder, run.recorder, run.state
    outputs = run.options.outputs
    if recorder:
        _log_start(recorder, inputs, settings, run.record)
    with make_pool(run.options.workers) as pool:
        try:
            # Stage 1: the poses.
            clock = time.perf_counter()
            stage = _ScanStage(run, pool)
            trajectory = given if given is not None else stage.register()
            state.timings_s["odometry"] = time.perf_counter() - clock
            # Before any scan is labelled with these poses, so that a run that is resumed knows what they were made from.
            folder.write_json({**run.record, "bag": _bag_as_read(run.record, state), "outcome": "running"})

            # Stage 2: the scans.
            clock = time.perf_counter()
            stage.label(trajectory)
            state.timings_s["scans"] = time.perf_counter() - clock
            if inputs.vertical is None:
                _write_trajectory(folder, trajectory, trajectory.stamp_ns)
                if recorder:
                    recorder.log_trajectory(trajectory.stamp_ns, trajectory.T_map_base, None)
                return
            if not len(stage.scan_stamps_ns):
                raise InputError(
                    f"{inputs.bag_path}: {inputs.vertical.lidar.topic} has no usable cloud ({_most(stage.reasons)}); "
                    f"'ffmap info' tells more"
                )
            _write_trajectory(folder, trajectory, np.array(stage.scan_stamps_ns))

            # Stage 3: the building.
            clock = time.perf_counter()
            run.progress.stage("building", None)
            building = _build(
                folder,
                stage.blocks,
                stage.take_votes(),
                stage.take_rivals(),
                trajectory,
                settings,
                run.options.workers,
            )
            if recorder:
                recorder.log_fused_walls(building.aligned)
                recorder.log_building(building.model)
                for name, grid in _maps(building).items():
                    recorder.log_grid(name, grid)
            if run.recording:
                log_rooms(run.recording.stream, building.rooms)
                for segmented, graph in building.compared_rooms.items():
                    log_areas(run.recording.stream, graph, f"{entities.ROOMS_COMPARED}/{segmented}")
                run.recording.set_layout(_layout(inputs, run.options.detail, run.record, building.grid))
            if Output.GEOJSON in outputs:
                results.write_walls(folder.path / WALLS, building.walls, building.thickness_m)
                results.write_doors(folder.path / DOORS, building.doors, door_rooms(building.rooms))
                write_rooms(folder.path / rooms_file(Segmented.FURNITURE_FREE), building.rooms)
                for segmented, graph in building.compared_rooms.items():
                    write_rooms(folder.path / rooms_file(segmented), graph)
            if Output.PLAN in outputs:
                write_svg(folder.path / FLOOR_PLAN_SVG, building.plan, inputs.bag_path.name)
                write_dxf(folder.path / FLOOR_PLAN_DXF, building.plan)
            if Output.MAPS in outputs:
                for name, grid in _maps(building).items():
                    results.write_grid(folder.path / map_file(name), grid)
            state.topology = topology(building.rooms)
            state.counts |= {
                "walls": len(building.walls),
                "refused_walls": len(building.judged.refused),
                "doors": len(building.doors),
                "rooms": len(building.rooms),
            }
            state.timings_s["building"] = time.perf_counter() - clock

            # Stage 4: final labels.
            clock = time.perf_counter()
            _finish(run, pool, stage.jobs, building, trajectory)
            state.timings_s["final"] = time.perf_counter() - clock
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _maps(building: Building) -> dict[str, GridMap]:
    """Every grid map by its name, the run's own first."""
    return {entities.FURNITURE_FREE: building.grid} | {str(name): grid for name, grid in building.rivals.items()}


def _log_start(recorder: Recorder, inputs: Inputs, settings: Settings, record: dict[str, Any]) -> None:
    sensors = {
        role: sensor.lidar.T_base_sensor
        for role, sensor in (("horizontal", inputs.horizontal), ("vertical", inputs.vertical))
        if sensor is not None
    }
    recorder.log_static(
        sensors,
        entities.explain(record),
        _ring_count(inputs),
        settings.vertical_structures.slope_max,
    )
    recorder.log_properties("settings", settings.model_dump(mode="json"))
    recorder.log_properties(
        "run", {name: record[name] for name in ("settings_hash", "bag", "versions", "started") if name in record}
    )


def _layout(inputs: Inputs, detail: Detail, record: dict[str, Any], grid: GridMap | None = None) -> rrb.Blueprint:
    """How the recording opens; with the grid, so that the whole building is in view."""
    return run_blueprint.build(
        _ring_count(inputs),
        *run_blueprint.view_of(grid),
        scans=detail is not Detail.MAP,
        registered=record["poses_from"] == FROM_ODOMETRY,
        lines=detail is Detail.LINES,
    )


def _ring_count(inputs: Inputs) -> int | None:
    """Emitters of the lidar that is labelled; None where nothing is."""
    return inputs.vertical.lidar.ring_count if inputs.vertical else None


class _ScanStage:
    """Stages 1 and 2: the poses, then the labelling of every block."""

    def __init__(self, run: _Run, pool: Executor) -> None:
        self._inputs, self._settings, self._options = run.inputs, run.settings, run.options
        self._folder, self._progress, self._record = run.folder, run.progress, run.record
        self._pool, self._recording, self._recorder, self._state = pool, run.recording, run.recorder, run.state
        self.blocks = split_blocks(len(run.inputs.vertical.index)) if run.inputs.vertical else []
        self.jobs: list[LabelJob] = []
        self.scan_stamps_ns: list[int] = []
        self.reasons: list[str] = []
        self._last_T_map_base: FloatArray | None = None
        self._floor_slope: FloatArray = np.zeros(2)
        self._digests: list[UInt8Array] = []
        self._registered: list[Registration] = []
        self._weak: list[str] = []
        self._votes = VoxelTable(VOXEL_M, len(Label))
        self._rivals = VoxelTable(run.settings.grid_map.cell_m, len(Rival))
        self._counts = np.zeros(256, np.int64)
        self._milliseconds: list[FloatArray] = []
        self._sizes: list[FloatArray] = []
        self._beyond_range: list[IntArray] = []

    def register(self) -> Trajectory:
        """Stage 1: the trajectory in the levelled map."""
        sensor = self._inputs.horizontal
        if sensor is None:
            raise InputError(
                f"{self._inputs.bag_path}: no horizontal lidar gives poses; name one with --horizontal, or give a "
                "trajectory with --trajectory"
            )
        self._progress.stage("odometry", len(sensor.index))
        odometry = Odometry(self._inputs, sensor, self._settings)
        self._state.odometry_cached = odometry.from_cache
        if odometry.from_cache:
            self._progress.say(
                f"odometry: taken from the cache in {cache_folder()}; with {CACHE_VARIABLE} it is another folder"
            )
        registered: list[int] = []
        for registration in odometry:
            registered.append(registration.index)
            if len(odometry) == 1 and self._recorder:
                # Until the map is level, the base's first pose is.
                self._recorder.log_odometry_frame(odometry.trajectory.stamp_ns, sensor.lidar.T_base_sensor[None])
            self._registered.append(registration)
            if len(self._registered) >= _REGISTRATIONS_AT_ONCE:
                self._log_registrations()
            self._progress.advance()
        if not len(odometry):
            raise InputError(
                f"{self._inputs.bag_path}: {sensor.lidar.topic} has no usable cloud; 'ffmap info' tells more"
            )
        if odometry.cache_warning is not None:
            self._warn(odometry.cache_warning)
        self._state.clouds |= odometry.clouds
        self._log_registrations()
        self._state.counts |= {"registrations": len(odometry), "weak_registrations": len(self._weak)}
        if unregistered := sorted(set(range(len(sensor.index))) - set(registered)):
            self._warn(
                f"{len(unregistered)} of {len(sensor.index)} horizontal clouds skipped: "
                f"{why_skipped(self._inputs.bag_path, sensor, unregistered)}"
            )
        if self._weak:
            self._warn(
                f"registration was weak for {len(self._weak)} of {len(odometry)} scans (the first: {self._weak[0]}); poses "
                "may be off there: see the recording's tab Odometry"
            )
        trajectory = odometry.trajectory
        level = level_by_first_scans(self._inputs, trajectory, self._settings)
        if not np.isfinite(level.floor_rms_m):
            self._warn("no floor was found in the first seconds: the map keeps the base's own level; is the rig right?")
        self._floor_slope = level.floor_slope
        self._take_loops(odometry, trajectory, level.T_map_odom)
        return trajectory.moved(level.T_map_odom)

    def _take_loops(self, odometry: Odometry, trajectory: Trajectory, T_map_odom: FloatArray) -> None:
        """Count the loops, and record what they did to the poses; trajectory: T_odom_base with them closed."""
        graph, before = odometry.pose_graph, odometry.before_loops
        if graph is not None:
            self._state.counts["loops"] = int(np.count_nonzero(graph.is_loop & (graph.weight > 0)))
        if self._recorder:
            T_correction = trajectory.T_map_base @ transforms.invert(before.T_map_base)
            self._recorder.log_odometry_frame(trajectory.stamp_ns, T_map_odom @ T_correction)
            if graph is not None:
                moved_m = np.linalg.norm((trajectory.T_map_base - before.T_map_base)[:, :3, 3], axis=1)
                self._recorder.log_pose_graph(graph, T_map_odom, trajectory.stamp_ns, moved_m)

    def label(self, trajectory: Trajectory) -> None:
        """Stage 2: every scan that the trajectory covers."""
        self._progress.stage("scans", len(self.blocks) or None)
        running: deque[tuple[Block, Future[BlockSummary] | BlockSummary]] = deque()
        for block in self.blocks:
            job = self._job(block, trajectory)
            self.jobs.append(job)
            finished = job.path.with_suffix(".npz")
            has_evidence = job.detail is None or job.path.with_suffix(".rrd").exists()
            if self._options.resume and finished.exists() and has_evidence:
                running.append((block, load_summary(finished)))
            else:
                running.append((block, self._pool.submit(label_block, job)))
        # In order, so that the recording grows in the order of time.
        while running:
            block, summary = running.popleft()
            self._take(block, summary if isinstance(summary, BlockSummary) else summary.result())
        self._summarise()

    def take_votes(self) -> VoxelVotes:
        """What the scans' own labels say of each cube of the map; they are let go of here, for they grow with it."""
        votes = self._votes.votes()
        self._votes = VoxelTable(VOXEL_M, len(Label))
        return votes

    def take_rivals(self) -> VoxelVotes:
        """What the maps that the paper compares with are drawn from; let go of here."""
        votes = self._rivals.votes()
        self._rivals = VoxelTable(self._rivals.voxel_m, len(Rival))
        return votes

    def _warn(self, text: str) -> None:
        self._state.warnings.append(text)
        self._progress.warn(text)

    def _log_registrations(self) -> None:
        weak = [weakness(registration, self._settings.refinement) for registration in self._registered]
        self._weak.extend(why for why in weak if why is not None)
        if self._recorder and self._recording:
            self._recorder.log_registrations(self._registered, weak)
            self._recording.cut()
        self._registered = []

    def _job(self, block: Block, trajectory: Trajectory) -> LabelJob:
        """Only the poses near the block travel to the worker."""
        assert self._inputs.vertical is not None
        stamps = self._inputs.vertical.index.stamp_ns[block.first : block.first + block.count]
        first = max(0, int(np.searchsorted(trajectory.stamp_ns, stamps.min() - 1_000_000_000)) - 2)
        last = int(np.searchsorted(trajectory.stamp_ns, stamps.max() + 1_000_000_000)) + 2
        return LabelJob(
            block=block,
            inputs=self._inputs,
            trajectory=Trajectory(trajectory.stamp_ns[first:last], trajectory.T_map_base[first:last]),
            base_height_m=float(trajectory.T_map_base[0, 2, 3]),
            floor_slope=self._floor_slope,
            extrapolate_ns=int(self._settings.trajectory.extrapolate_s * 1e9),
            level_scan_max_deg=self._settings.trajectory.level_scan_max_deg,
            method=self._settings.method,
            rival_maps=self._settings.rival_maps,
            cell_m=self._settings.grid_map.cell_m,
            seed=self._settings.seed,
            recording_id=self._record["recording_id"],
            detail=self._options.detail if self._recorder else None,
            path=self._folder.block(block.number, ""),
        )

    def _take(self, block: Block, summary: BlockSummary) -> None:
        self.scan_stamps_ns.extend(summary.stamp_ns.tolist())
        self._digests.append(summary.cloud_digest)
        self.reasons.extend(summary.skipped_reason)
        self._counts += summary.label_counts
        self._beyond_range.append(summary.beyond_range)
        self._milliseconds.append(summary.milliseconds)
        self._sizes.append(np.stack([summary.points_in_cloud, summary.points_in_lines], axis=1, dtype=np.float64))
        for index, reason in zip(summary.skipped_scan.tolist(), summary.skipped_reason, strict=True):
            if len(self.reasons) <= 5:
                self._progress.warn(f"scan {index} skipped: {reason}")
        votes = load_votes(self._folder.block(block.number, ".npz"))
        new = self._votes.absorb(votes)
        self._rivals.absorb(load_rivals(self._folder.block(block.number, ".npz")))
        if self._recorder and self._recording and len(summary.scan):
            self._recording.add(self._folder.block(block.number, ".rrd"))
            self._recorder.log_trajectory(summary.stamp_ns, summary.T_map_base, summary.scan, self._last_T_map_base)
            self._last_T_map_base = summary.T_map_base[-1]
            points, label = votes.mean_position[new].astype(np.float32), majority(votes.counts[new])
            self._recorder.log_map_block(int(summary.scan[-1]), int(summary.stamp_ns[-1]), points, label)
        self._progress.advance()

    def _summarise(self) -> None:
        if not self.blocks:
            return
        assert self._inputs.vertical is not None
        self._state.clouds[self._inputs.vertical.lidar.topic] = joined([np.concatenate(self._digests).tobytes()]).hex()
        milliseconds = np.concatenate(self._milliseconds)
        self._state.counts |= {
            "clouds": sum(b.count for b in self.blocks),
            "scans": len(self.scan_stamps_ns),
            "skipped": {reason: self.reasons.count(reason) for reason in sorted(set(self.reasons))},
            "returns": {label.name.lower(): int(self._counts[label]) for label in Label},
        }
        if len(milliseconds):
            by_stage = dict(zip(STAGES, milliseconds.T, strict=True))
            for name, own in by_stage.items():
                self._state.timings_s[f"{name}_per_scan"] = float(np.median(own)) / 1e3
            sizes = np.concatenate(self._sizes)
            self._state.statistics = {
                "milliseconds_per_cloud": _spread(by_stage["smoothing"] + by_stage["labelling"]),
                "points_in_cloud": _spread(sizes[:, 0]),
                "points_in_lines": _spread(sizes[:, 1]),
            }
        if self.reasons:
            self._state.warnings.append(f"{len(self.reasons)} vertical clouds skipped: {_most(self.reasons)}")
        beyond = np.concatenate(self._beyond_range)
        if beyond.any():
            self._state.counts["beyond_range"] = int(beyond.sum())
            self._warn(
                f"returns farther than {self._settings.scan.range_max_m:g} m away were left out (scan.range_max_m): "
                f"{beyond.sum():,}, in {np.count_nonzero(beyond):,} of {len(beyond):,} scans"
            )


def _spread(values: FloatArray) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "standard_deviation": float(values.std()),
        "min": float(values.min()),
        "max": float(values.max()),
    }


def _most(reasons: list[str]) -> str:
    """The commonest reason."""
    if not reasons:
        return "none is there"
    return max(sorted(set(reasons)), key=reasons.count)


def _write_trajectory(folder: RunFolder, trajectory: Trajectory, stamps_ns: IntArray) -> None:
    write_tum(folder.path / TRAJECTORY, Trajectory(stamps_ns, trajectory.at(stamps_ns)))


def _build(
    folder: RunFolder,
    blocks: list[Block],
    votes: VoxelVotes,
    rivals: VoxelVotes,
    trajectory: Trajectory,
    settings: Settings,
    workers: int,
) -> Building:
    """The building of all scans; their rays are read block by block."""

    def trace(faces: Walls, building: BuildingSettings, windows: Windows) -> WallCells:
        return _trace(faces, folder, blocks, building, windows, workers)

    drive = Drive(trajectory.T_map_base[:, :3, 3], lambda: _features(folder, blocks))
    return fuse_building(AllScans(drive=drive, votes=votes, rivals=rivals, trace=trace), settings.fusion, workers)


def _trace(
    walls: Walls, folder: RunFolder, blocks: list[Block], settings: BuildingSettings, windows: Windows, workers: int
) -> WallCells:
    """`trace_rays` on so many cores: block by block, summed in their order, so that no sum depends on how many they are."""

    def trace_block(block: Block) -> WallCells:
        features = _features(folder, [block])
        if len(windows):
            features = (without_rays_through(windows, part) for part in features)
        return trace_rays(walls, features, settings)

    cells = trace_rays(walls, [], settings)
    with ThreadPoolExecutor(workers) as threads:
        for part in threads.map(trace_block, blocks):
            cells.counts[...] += part.counts
    return cells


def _features(folder: RunFolder, blocks: list[Block]) -> Iterator[Features]:
    for block in blocks:
        features = load_features(folder.block(block.number, ".npz"))
        if features is not None:
            yield features


def _finish(run: _Run, pool: Executor, jobs: Sequence[LabelJob], building: Building, trajectory: Trajectory) -> None:
    """Final labels by the workers, while this process writes the labelled bag behind them."""
    inputs, folder, recording = run.inputs, run.folder, run.recording
    run.progress.stage("final", len(jobs))
    halo = folder.spool / "halo.npz"
    save_halo(halo, building.halo)
    pending: list[Future[None] | None] = []
    for job in jobs:
        done = job.path.with_suffix(".final.npz").exists() and run.options.resume
        finish = FinishJob(job, building.model, halo, run.settings.relabelling)
        pending.append(None if done else pool.submit(finish_block, finish))
    table = VoxelTable(VOXEL_M, len(Label))

    def labels() -> Iterator[tuple[int, Any, Any]]:
        for job, future in zip(jobs, pending, strict=True):
            if future is not None:
                future.result()
            final_path = job.path.with_suffix(".final.npz")
            if recording is not None and job.path.with_suffix(FINAL_EVIDENCE).exists():
                recording.add(job.path.with_suffix(FINAL_EVIDENCE))
            table.absorb(load_votes(final_path))
            label, label_scan = load_labels(final_path), load_labels(job.path.with_suffix(".npz"))
            for index in sorted(label):
                yield index, label[index], label_scan[index]
            run.progress.advance()

    assert inputs.vertical is not None
    outputs = run.options.outputs
    with LabelsWriter(folder.path / LABELS if Output.LABELS in outputs else None) as writer:
        kept = writer.passing(labels())
        if Output.LABELLED in outputs:
            with open_bag(inputs.bag_path) as bag:
                results.write_labelled_bag(folder.path, bag, inputs.vertical.index, inputs.rig, trajectory, kept)
        else:
            deque(kept, maxlen=0)
    run.state.labels_digest = writer.digest
    pool.shutdown()  # the workers' memory goes before the whole cloud is made
    cloud = fuse(table.votes())
    if Output.CLOUD in outputs:
        colours = np.array([entities.CLASSES[label][1] for label in Label], np.uint8)
        results.write_ply(folder.path / CLOUD, cloud, colours[cloud.label])
    if run.recorder:
        run.recorder.log_cloud(cloud.points_map, cloud.label)
    run.state.counts["cloud_points"] = len(cloud)


def first_record(
    inputs: Inputs, settings: Settings, options: dict[str, Any], bag_path: Path, given_poses: str | None
) -> dict[str, Any]:
    """What run.json holds from the start: everything that the run is made from.

    given_poses: the file or topic that the poses are taken from; None for the odometry.
    """
    rig = {
        role: {"topic": s.lidar.topic, "frame": s.lidar.frame_id, "why": s.lidar.reasons}
        for role, s in (("horizontal", inputs.horizontal), ("vertical", inputs.vertical))
        if s is not None
    }
    return {
        "program": PROGRAM,
        "recording_id": str(uuid.uuid4()),
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "bag": {
            "path": str(bag_path.resolve()),
            "container": inputs.container,
            "stamps": digest_stamps(inputs.used(given_poses is not None)),
        },
        "base_frame": inputs.rig.base_frame,
        "rig": rig,
        "poses_from": given_poses or FROM_ODOMETRY,
        "settings_hash": settings.short_hash(),
        "settings": settings.model_dump(mode="json"),
        "options": options,
        "versions": versions(),
    }
