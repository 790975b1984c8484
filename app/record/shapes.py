"""Arrays as Rerun draws them: rounded positions, strips, upright rectangles, colours, frames."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.blueprints import entities

Lines = FloatArray | Sequence[npt.ArrayLike]
Colors = entities.Color | Sequence[entities.Color] | UInt8Array
"""One for all, or one each."""
Labels = str | Sequence[str] | None

GRID_M = 1.0 / 256.0
"""Positions are rounded to this grid (m), a fraction of what a lidar's ranges scatter by: rounded, they compress."""
POINT_RADIUS_UI = 1.5
JUMP_M = 0.4
"""No stroke is drawn between neighbours in a line that are farther apart."""
SEE_THROUGH = (255, 255, 255, 90)
"""Factor of a mesh's colours behind which points and lines can be seen."""


def markdown(text: str) -> rr.TextDocument:
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = ["|" + "|".join(f" {cell} " if cell != "" else " " for cell in row) + "|" for row in (headings, *rows)]
    return "\n".join([lines[0], "|---" * len(headings) + "|", *lines[1:]])


def annotations(classes: Mapping[int, tuple[str, entities.Color]]) -> rr.AnnotationContext:
    return rr.AnnotationContext(
        [rr.AnnotationInfo(id=int(key), label=name, color=color) for key, (name, color) in classes.items()]
    )


def transform(T_parent_child: FloatArray) -> rr.Transform3D:
    return rr.Transform3D(
        translation=T_parent_child[:3, 3], quaternion=rr.Quaternion(xyzw=transforms.quaternion_xyzw(T_parent_child))
    )


def transform_columns(T_parent_child: FloatArray) -> dict[str, Any]:
    """Frames (n, 4, 4) as what `rr.Transform3D` has of each."""
    return {"translation": T_parent_child[:, :3, 3], "quaternion": transforms.quaternion_xyzw(T_parent_child)}


def rounded(positions_m: FloatArray) -> FloatArray:
    return np.asarray(np.rint(positions_m.astype(np.float32) * np.float32(1.0 / GRID_M)) * np.float32(GRID_M))


def ui_radius(points: float) -> np.float32:
    """A radius in the viewer's points, which Rerun writes as a negative number."""
    return np.float32(-points)


def strips(
    lines: Lines, color: Colors | None, radius_ui: float, labels: Labels = None, show_labels: bool | None = None
) -> rr.LineStrips3D:
    """Lines in space, their radius in the viewer's points."""
    return rr.LineStrips3D(lines, colors=color, radii=ui_radius(radius_ui), labels=labels, show_labels=show_labels)


def strips_2d(
    lines: Lines, color: Colors | None, radius_ui: float, draw_order: float | None = None, labels: Labels = None
) -> rr.LineStrips2D:
    """Lines on a sheet, their radius in the viewer's points; labels are shown."""
    shown = None if labels is None else True
    return rr.LineStrips2D(
        lines, colors=color, radii=ui_radius(radius_ui), draw_order=draw_order, labels=labels, show_labels=shown
    )


def words(places: npt.ArrayLike, texts: Sequence[str], color: Colors = entities.TEXT_COLOR) -> rr.Points2D:
    """Texts on a sheet, without the points that they stand at."""
    return rr.Points2D(places, labels=texts, show_labels=True, colors=color, radii=0.0)


def at_height(points_map: FloatArray, height_m: float) -> FloatArray:
    """Points (..., 2) in space, all at one height."""
    widths = [(0, 0)] * (points_map.ndim - 1) + [(0, 1)]
    return np.pad(points_map, widths, constant_values=height_m).astype(np.float32)


def unbroken(lines: FloatArray) -> tuple[pa.Array, IntArray]:
    """Line strips of lines (L, n, 3), parted where a line jumps, and the line (S,) that each strip is of."""
    count, length = lines.shape[:2]
    points = lines.reshape(-1, 3)
    step = points[1:] - points[:-1]
    broken = np.ones(len(points), bool)
    broken[1:] = np.einsum("ij,ij->i", step, step) > JUMP_M**2
    broken[::length] = True
    starts = np.flatnonzero(broken)
    return strips_of(points, np.append(starts, count * length)), starts // length


def strips_of(points: FloatArray, starts: IntArray) -> pa.Array:
    """Ragged line strips without a Python loop: strip i is points[starts[i]:starts[i + 1]]; points: (n, 2 or 3)."""
    kind = _STRIPS[points.shape[1]]
    inner = pa.FixedSizeListArray.from_arrays(pa.array(points.astype(np.float32).ravel()), type=kind.value_type)
    return pa.ListArray.from_arrays(pa.array(starts, pa.int32()), inner, type=kind)


_STRIPS = {
    2: rr.components.LineStrip2DBatch([]).as_arrow_array().type,
    3: rr.components.LineStrip3DBatch([]).as_arrow_array().type,
}
"""The Arrow type of line strips by their points' number of coordinates."""


def upright_quads(ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Vertices (4K, 3) and triangles (2K, 3) over ends (K, 2, 2) between heights (K, 2) or (K, 1)."""
    corners = np.empty((len(ends), 4, 3), np.float32)
    corners[:, :2, :2], corners[:, :2, 2] = ends, bottom_m
    corners[:, 2:, :2], corners[:, 2:, 2] = ends[:, ::-1], top_m[:, ::-1]
    first = 4 * np.arange(len(ends), dtype=np.uint32)[:, None, None]
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.uint32) + first
    return corners.reshape(-1, 3), triangles.reshape(-1, 3)


def panel_mesh(ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray, color: entities.Color) -> rr.Mesh3D:
    """Upright rectangles that one can see through, over ends (K, 2, 2) between heights (K,)."""
    vertices, triangles = upright_quads(ends, bottom_m[:, None], top_m[:, None])
    return rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, albedo_factor=(*color, SEE_THROUGH[3]))


def upright_frames(ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray) -> FloatArray:
    """Closed outlines (K, 5, 3) over ends (K, 2, 2) between heights (K,)."""
    corners = upright_quads(ends, bottom_m[:, None], top_m[:, None])[0]
    return corners.reshape(-1, 4, 3)[:, [0, 1, 2, 3, 0]]
