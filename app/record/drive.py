"""The clouds of a bag as a recording on standard output; in the map of a run if there is one."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.record.building import log_cloud
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_odometry_styles, log_trajectory
from ffmap.app.record.shapes import annotations, rounded, transform, ui_radius
from ffmap.app.record.stream import open_stdout
from ffmap.app.record.whole_run import log_label_legend, log_legend
from ffmap.blueprints import drive as drive_blueprint
from ffmap.blueprints.entities import CLASSES, Color

_COLORS: tuple[Color, ...] = ((255, 176, 32), (64, 190, 255), (240, 96, 180), (130, 220, 90))
"""Of the lidars, in turn."""
_PALE: Color = (200, 206, 218)
"""Of a lidar without labels, beside others with labels."""


@dataclass(frozen=True)
class DriveMap:
    """What a run knows of a bag: poses, and points (m, 3) and labels (m,) of its fused cloud."""

    trajectory: Trajectory
    points_map: FloatArray
    label: UInt8Array

    @property
    def view(self) -> tuple[tuple[float, float], float]:
        """Centre and extent (m), without what few rays saw through windows."""
        path = self.trajectory.T_map_base[:, :3, 3]
        places = self.points_map if len(self.points_map) else path
        low, high = np.percentile(places[:, :2], [1, 99], axis=0)
        x, y = (low + high) / 2
        return (float(x), float(y)), 1.15 * float(np.max(high - low))


@contextmanager
def open_drive(
    ids: tuple[str, str | None],
    glance: str,
    lidars: Mapping[str, FloatArray | None],
    known: DriveMap | None,
) -> Iterator[Log]:
    """Open the recording of a bag, and log what does not change.

    ids: of application and recording. glance: explanation in Markdown. lidars:
    T_base_sensor (4, 4) by role, or None where no extrinsics are known.
    """
    names, apart = [*lidars], any(T is None for T in lidars.values())
    layout = drive_blueprint.build(names, apart, known.view if known else None)
    with open_stdout(*ids, layout) as stream:
        log = Log(stream)
        log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, annotations(CLASSES))
        log.static("/world/base", rr.TransformAxes3D(0.6))
        log.text("/glance", glance)
        if known is None:
            colors = dict(zip(names, _COLORS * len(names), strict=False))
        else:
            colors = {name: _PALE for name in names if not name.startswith("vertical")}
        for name, T_base_sensor in lidars.items():
            # Beside a map, the clouds are to be seen in it.
            radius = ui_radius(1.5 if known is None else 2.0)
            style = rr.Points3D.from_fields(colors=colors.get(name), radii=radius)
            log.static(f"{_frame(name, known is not None)}/points", style)
            if known is None and T_base_sensor is not None:
                mount = transform(T_base_sensor), rr.TransformAxes3D(0.3)
                log.static(_frame(name, in_map=False), *mount)
        if known is None:
            log_legend(log, "/legend", [(name.replace("_", " "), c) for name, c in colors.items()])
        else:
            log_label_legend(log, "/legend")
            log_odometry_styles(log)
            trajectory = known.trajectory
            log_trajectory(log, trajectory.stamp_ns, trajectory.T_map_base, None)
            log_cloud(log, known.points_map, known.label)
        try:
            yield log
        finally:
            log.send_rows()


def log_returns(
    log: Log,
    name: str,
    points_sensor: FloatArray,
    label: UInt8Array | None,
    T_map_base_sensor: tuple[FloatArray, FloatArray] | None,
) -> None:
    """Log a cloud of a lidar at the time that is set.

    label: (n,) of its returns, None for a lidar without labels. T_map_base_sensor: poses (4, 4) of
    base and lidar in the map; None without a map.
    """
    frame = _frame(name, T_map_base_sensor is not None)
    if T_map_base_sensor is not None:
        log.pose("/world/base", T_map_base_sensor[0])
        log.pose(frame, T_map_base_sensor[1])
    labels: dict[str, Any] = {} if label is None else {"class_ids": label}
    log.row(f"{frame}/points", rr.Points3D, positions=rounded(points_sensor), **labels)


def _frame(name: str, in_map: bool) -> str:
    """Return the entity of a lidar.

    In the map, each lidar has the pose of its own time: the base moves on between two clouds.
    """
    return f"/world/{name}" if in_map else f"/world/base/{name}"
