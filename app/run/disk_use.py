"""How much a run will write, known before it starts from a few of its clouds; and whether there is room for it."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.scan import Scan
from ffmap.app.folder.names import RunFolder
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.outputs import Detail, Output
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import read_clouds

_SAMPLES = 20

# What follows was measured on runs of three sensors and three buildings; docs/measured.md has the errors.
_RECORDING = {Detail.LINES: (93e3, 7.2), Detail.SCANS: (45e3, 5.9), Detail.MAP: (17e3, 0.0)}
"""Bytes of the recording for each scan, and for each of its returns more."""
_TOLD_ONCE = 1e6
"""Bytes of the recording for its layouts and explanations, however long the drive."""
_SPOOL = (330e3, 11.0)
"""The same of what lies in the spool beside the recording's parts."""
_REGISTRATION = 45e3
"""Bytes of the recording for each scan of a drive that is not labelled."""
_CLOUD, _LABELS_SHARE, _DRAWINGS = 9e3, 0.01, 0.2e6
"""Bytes of cloud.ply for each scan; labels.parquet as a share of the labelled bag; maps, plan and GeoJSON, each."""
_TRANSFORM = 250
"""Bytes of a pose and of a message's head in the labelled bag."""
_COPIES = 3
"""Of the recording at a run's end: the parts, the file that grew, and the whole that takes its place."""
_ERROR = 0.2
"""By which share the estimate may be wrong."""


@dataclass(frozen=True)
class DiskUse:
    """What a run will write, in bytes.

    kept: by output, of those that take much. most: while it runs, together with all that it removes at its end.
    """

    kept: dict[Output, float]
    most: float

    @property
    def total(self) -> float:
        """What stays."""
        return sum(self.kept.values())


@dataclass(frozen=True)
class DiskCheck:
    """What a run will write, in words, and what to warn of."""

    said: str
    warnings: tuple[str, ...] = ()


def estimate(inputs: Inputs, outputs: tuple[Output, ...], detail: Detail) -> DiskUse | None:
    """From some clouds of all over the bag; None where none of them is sound."""
    if not inputs.verticals:
        assert inputs.horizontal is not None
        recording = _REGISTRATION * len(inputs.horizontal.index)
        kept = {Output.RECORDING: recording} if Output.RECORDING in outputs else {}
        return DiskUse(kept, _COPIES * sum(kept.values()))
    sampled = [(len(sensor.index), found) for sensor in inputs.verticals if (found := _sample(inputs, sensor))]
    if not sampled:
        return None
    scans = len(inputs.scans)
    cloud_bytes, places, returns = np.average([means for _, means in sampled], axis=0, weights=[n for n, _ in sampled])
    labelled = scans * (cloud_bytes + 2 * places + _TRANSFORM)
    per_scan, per_return = _RECORDING[detail]
    all_kept = {
        Output.RECORDING: _TOLD_ONCE + scans * (per_scan + per_return * returns),
        Output.LABELLED: labelled,
        Output.LABELS: _LABELS_SHARE * labelled,
        Output.CLOUD: _CLOUD * scans,
        **dict.fromkeys((Output.MAPS, Output.PLAN, Output.GEOJSON), _DRAWINGS),
    }
    kept = {output: size for output, size in all_kept.items() if output in outputs}
    copies = (_COPIES - 1) * kept.get(Output.RECORDING, 0.0)
    return DiskUse(kept, sum(kept.values()) + copies + scans * (_SPOOL[0] + _SPOOL[1] * returns))


def _sample(inputs: Inputs, sensor: Sensor) -> tuple[float, float, float] | None:
    """Means over some clouds: bytes of their points, places for points, returns."""
    found: list[tuple[int, int, int]] = []
    with open_bag(inputs.bag_path) as bag:
        for place in sorted({round(place) for place in np.linspace(0, len(sensor.index) - 1, _SAMPLES)}):
            for _, scan, message in read_clouds(bag, sensor.index, place, 1, sensor.lidar.decoding):
                if isinstance(scan, Scan) and message is not None:
                    found.append((len(message.data), int(message.height) * int(message.width), len(scan)))
    if not found:
        return None
    cloud_bytes, places, returns = np.mean(found, axis=0).tolist()
    return cloud_bytes, places, returns


def check_disk(
    inputs: Inputs, out: Path, outputs: tuple[Output, ...], detail: Detail, resumed: RunFolder | None
) -> DiskCheck:
    """What a run will write at `out`, and whether it may not fit.

    resumed: the folder of a run that is gone on with, which has written some of it.
    Raises InputError where the disk has not enough room by more than the estimate's error.
    """
    use = estimate(inputs, outputs, detail)
    if use is None:
        unsound = "no cloud that was tried of all over the bag is sound"
        return DiskCheck(f"disk: what the run will write cannot be foreseen: {unsound}")
    free = shutil.disk_usage(next(place for place in (out, *out.resolve().parents) if place.exists())).free
    if resumed is not None:
        free += sum(file.stat().st_size for file in resumed.path.rglob("*") if file.is_file())
    large = ", ".join(f"{_NAMES[output]} {_size(size)}" for output, size in use.kept.items() if output in _NAMES)
    said = f"about {_size(use.total)} in {out}{f' ({large})' if large else ''}, {_size(use.most)} while it runs"
    said += f"; {_size(free)} are free there"
    less = _how_to_write_less(use, outputs, detail)
    if use.most * (1 - _ERROR) > free:
        raise InputError(f"{out}: the run does not fit: {said}; free some, or give --out on another disk{less}")
    warnings = (f"the disk may become full: {said}{less}",) if use.most * (1 + _ERROR) > free else ()
    return DiskCheck(f"disk: {said}{less}", warnings)


_NAMES = {Output.RECORDING: "recording", Output.LABELLED: "labelled bag"}


def _how_to_write_less(use: DiskUse, outputs: tuple[Output, ...], detail: Detail) -> str:
    """The option that leaves out what takes most, as the end of a sentence; empty where nothing large is left."""
    recording, labelled = (use.kept.get(output, 0.0) for output in (Output.RECORDING, Output.LABELLED))
    if labelled and labelled >= recording:
        others = ",".join(output for output in outputs if output is not Output.LABELLED)
        return f"; without the labelled bag: --outputs {others or Output.MAPS}"
    if recording and detail is not Detail.MAP:
        return f"; with a smaller recording: --detail {Detail.SCANS if detail is Detail.LINES else Detail.MAP}"
    return ""


def _size(count: float) -> str:
    """Bytes as a person says them."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{max(count / 1e6, 1):.0f} MB"
