"""cloud.ply: the fused semantic cloud."""

from pathlib import Path

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.votes import FusedCloud
from ffmap.app.folder.atomic import written_whole
from ffmap.loaders.errors import InputError

_VERTEX = [(name, "<f4") for name in "xyz"]
_VERTEX += [(name, "u1") for name in ("label", "red", "green", "blue")]


def write_ply(path: Path, cloud: FusedCloud, colours: UInt8Array) -> None:
    """Write a binary PLY: x y z (metres, map frame), label, red green blue.

    colours: (m, 3) uint8, one row a point.
    """
    vertex = np.zeros(len(cloud), _VERTEX)
    columns = (*cloud.points_map.T, cloud.label, *colours.T)
    for (name, _), values in zip(_VERTEX, columns, strict=True):
        vertex[name] = values
    kinds = {"<f4": "float", "u1": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment fused semantic cloud, metres in the map frame",
        f"element vertex {len(cloud)}",
        *(f"property {kinds[kind]} {name}" for name, kind in _VERTEX),
        "end_header\n",
    ]
    with written_whole(path) as part, part.open("wb") as file:
        file.write("\n".join(header).encode())
        vertex.tofile(file)


def read_ply(path: Path) -> tuple[FloatArray, UInt8Array]:
    """Read points (n, 3) and labels (n,) of a cloud that `write_ply` wrote.

    Raises InputError where the file is another one, or cut.
    """
    header, _, body = path.read_bytes().partition(b"end_header\n")
    counts = [line.split()[-1] for line in header.splitlines() if line.startswith(b"element")]
    try:
        vertex = np.frombuffer(body, _VERTEX, int(counts[0]))
    except (IndexError, ValueError) as error:
        raise InputError(f"{path}: is no cloud of a run, or is cut; run ffmap again") from error
    points = np.column_stack([vertex[name] for name in "xyz"])
    return points, vertex["label"].copy()
