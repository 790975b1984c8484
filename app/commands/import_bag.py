"""The clouds of a bag for the Rerun viewer, in the map and with the labels of a run of it."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import Scan, UInt8Array
from ffmap.algorithms.base.trajectory import seen_at_once
from ffmap.app.analysis.run_labels import read_clouds
from ffmap.app.folder.cloud_file import read_ply
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.labels_file import ScanLabels, stream_labels
from ffmap.app.folder.names import CLOUD, LABELS, RUN_JSON
from ffmap.app.record.drive import DriveMap, log_returns, open_drive
from ffmap.app.setup.inputs import find_lidars
from ffmap.app.setup.options import RunOptions
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.candidates import find_candidates
from ffmap.loaders.errors import InputError
from ffmap.loaders.numbered import numbered
from ffmap.loaders.rig import Lidar
from ffmap.loaders.sensors import cloud_topics
from ffmap.loaders.trajectory_file import read_tum

_MARGIN_NS = 100_000_000
"""Time before the first pose and after the last in which clouds are still placed: a sweep."""
_RETURNS, _OF_CLOUD_MIN, _OF_CLOUD_MAX = 30_000_000, 2_000, 20_000
"""Number of returns of a bag that are shown, about 0.5 GB, and its limits for a cloud.

Clouds are thinned, but none is left out: the drive plays evenly.
"""


def import_bag(path: Path, application_id: str, recording_id: str | None) -> None:
    """Write the clouds of a bag to standard output as a recording, in the order of time.

    Raises InputError where the bag is damaged, or none of its clouds can be read.
    """
    run = find_run(path)
    with open_bag(path) as bag:
        lidars, placed = _find_lidars(bag, run)
        count = sum(len(lidar.index(bag)) for lidar in lidars.values())
        bag_path, duration_s = bag.path, bag.duration_s
    known = _known(run) if run and placed else None
    glance = _explain(bag_path.name, duration_s, lidars, placed, run if known else None)
    of_cloud = int(np.clip(_RETURNS // max(count, 1), _OF_CLOUD_MIN, _OF_CLOUD_MAX))
    mounts = {name: lidar.T_base_sensor if placed else None for name, lidar in lidars.items()}
    with open_drive((application_id, recording_id), glance, mounts, known) as log:
        labels = _Labels(run.file(LABELS) if run and known else None)
        names = [*lidars]
        for _, place, scan in read_clouds(bag_path, [*lidars.values()]):
            lidar, poses, label = lidars[names[place]], None, None
            if not isinstance(scan, Scan):
                continue
            if known is not None:
                reference = np.array([scan.reference_ns])
                if not known.trajectory.covers(reference, _MARGIN_NS).all():
                    continue
                if names[place].startswith("vertical"):
                    label = labels.of(scan, lidar.topic)
                T_map_base = known.trajectory.at(reference)[0]
                poses = T_map_base, T_map_base @ lidar.T_base_sensor
                edges = lidar.decoding.rings.edge_tan
                scan = seen_at_once(scan, known.trajectory, lidar.T_base_sensor, edges)
            # An odd step takes returns of all rings: their number is even.
            shown = slice(None, None, -(-len(scan) // of_cloud) | 1)
            log.at(scan.stamp_ns)
            label = None if label is None else label[shown]
            log_returns(log, names[place], scan.points_sensor[shown], label, poses)


def find_run(bag: Path) -> FinishedRun | None:
    """Find the newest complete run of a bag: beside it, in runs/ beside it, or in runs/ here."""
    folder, bag = bag.absolute().parent, bag.resolve()
    found: list[FinishedRun] = []
    for place in (folder, folder / "runs", Path("runs")):
        for file in place.glob(f"*/{RUN_JSON}"):
            try:
                run = open_run(file.parent.resolve())
            except InputError:
                continue
            parts = run.bag_path.parts if run.bag_path else ()
            # A run that was moved together with its bag, or copied from another machine.
            moved = any(part.name == bag.name and not part.exists() for part in parts)
            if run.complete and run.trajectory and (bag in parts or moved):
                found.append(run)
    return max(found, key=lambda run: run.record.started, default=None)


def _find_lidars(bag: Bag, run: FinishedRun | None) -> tuple[dict[str, Lidar], bool]:
    """Find lidars by role, and whether their extrinsics are known; otherwise they are numbered."""
    try:
        rig = run.find_lidars(bag) if run else find_lidars(bag, RunOptions(), own_body=False)
    except InputError:
        found = find_candidates(bag, cloud_topics(bag), "auto", [])
        return {f"lidar_{i}": lidar for i, lidar in enumerate(found, 1)}, False
    lidars = {numbered("vertical", i): lidar for i, lidar in enumerate(rig.verticals)}
    if rig.horizontal and rig.horizontal.topic not in {own.topic for own in rig.verticals}:
        lidars = {"horizontal": rig.horizontal} | lidars
    return lidars, True


def _known(run: FinishedRun) -> DriveMap:
    assert run.trajectory is not None
    file = run.file(CLOUD)
    points, label = read_ply(file) if file else (np.zeros((0, 3)), np.zeros(0, np.uint8))
    return DriveMap(read_tum(run.trajectory), points, label)


def _explain(
    bag: str, duration_s: float, lidars: Mapping[str, Lidar], placed: bool, run: FinishedRun | None
) -> str:
    """Return Markdown for the first glance."""
    uses = {"horizontal": " for localization", "vertical": " for mapping"}
    own = [
        f"**{name.replace('_', ' ')}** `{lidar.topic}`{uses.get(name.split('_')[0], '')}"
        for name, lidar in lidars.items()
    ]
    text = f"**{bag}**, {duration_s:.0f} s of driving. Lidars: {', '.join(own)}.\n\n"
    if run is not None:
        return f"{text}Map, poses and labels are from the run `{run.path}`. White: no label."
    if not placed:
        text += "Their extrinsics are not known: each lidar has a view of its own.\n\n"
    return f"{text}No run of this bag was found. `ffmap run {bag}` labels it and builds the map."


class _Labels:
    """The labels of a run, read along with its clouds."""

    def __init__(self, file: Path | None) -> None:
        self._following: Iterator[ScanLabels] = iter(()) if file is None else stream_labels(file)
        self._next = next(self._following, None)

    def of(self, scan: Scan, topic: str) -> UInt8Array:
        """Return the labels (n,) of a scan's returns, `NO_RETURN` where it has none."""
        key = scan.stamp_ns, topic
        while self._next is not None and (self._next.stamp_ns, self._next.topic) < key:
            self._next = next(self._following, None)
        own = self._next
        if own is None or (own.stamp_ns, own.topic) != key or len(own.label) != scan.cloud_size:
            return np.full(len(scan), NO_RETURN, np.uint8)
        return own.label[scan.cloud_index]
