"""cloud.ply: the fused semantic cloud."""

from pathlib import Path

import numpy as np

from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.building.votes import FusedCloud
from ffmap.app.folder.atomic import written_whole


def write_ply(path: Path, cloud: FusedCloud, colours: UInt8Array) -> None:
    """Binary little-endian PLY: x y z (metres, map frame), label, red green blue.

    colours: (m, 3) uint8, one row a point.
    """
    axes, channels = ("x", "y", "z"), ("label", "red", "green", "blue")
    vertex = np.zeros(len(cloud), [(name, "<f4") for name in axes] + [(name, "u1") for name in channels])
    for name, values in zip(axes + channels, (*cloud.points_map.T, cloud.label, *colours.T), strict=True):
        vertex[name] = values
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment fused semantic cloud, metres in the map frame",
        f"element vertex {len(cloud)}",
        *(f"property float {name}" for name in axes),
        *(f"property uchar {name}" for name in channels),
        "end_header\n",
    ]

    with written_whole(path) as part, part.open("wb") as file:
        file.write("\n".join(header).encode())
        vertex.tofile(file)
