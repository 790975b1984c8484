"""Arrays as Rerun archetypes: rounded positions, strips, upright rectangles, transforms, texts."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.blueprints.entities import Color

Lines = FloatArray | Sequence[npt.ArrayLike]
Colors = Color | Sequence[Color] | UInt8Array
Labels = str | Sequence[str] | None

GRID_M = 1.0 / 256.0
"""Grid (m) of rounded positions, finer than the noise of a lidar: rounded positions compress."""
JUMP_M = 0.4
"""Distance (m) between neighbours of a line beyond which the line is interrupted."""
SEE_THROUGH = 90
"""Opacity of walls, of 255."""
TEXT_COLOR: Color = (160, 165, 175)


def markdown(text: str) -> rr.TextDocument:
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def annotations(classes: Mapping[int, tuple[str, Color]]) -> rr.AnnotationContext:
    infos = classes.items()
    return rr.AnnotationContext([rr.AnnotationInfo(int(id), *info) for id, info in infos])


def transform(T_parent_child: FloatArray) -> rr.Transform3D:
    """Return a transform (4, 4) as the transform of an entity."""
    quaternion = rr.Quaternion(xyzw=transforms.quaternion_xyzw(T_parent_child))
    return rr.Transform3D.from_fields(translation=T_parent_child[:3, 3], quaternion=quaternion)


def rounded(positions_m: FloatArray) -> FloatArray:
    grid = positions_m.astype(np.float32)
    grid *= np.float32(1.0 / GRID_M)
    np.rint(grid, out=grid)
    grid *= np.float32(GRID_M)
    return grid


def packed_colors(*colors: Color) -> IntArray:
    """Return colours (n,) as Rerun packs them into integers."""
    return np.array([(r << 24) | (g << 16) | (b << 8) | 255 for r, g, b in colors], np.uint32)


def ui_radius(points: float) -> np.float32:
    """Return a radius in the viewer's points, which Rerun writes as a negative number."""
    return np.float32(-points)


def strips(
    lines: Lines | pa.Array,
    color: Colors | None,
    radius_ui: float,
    labels: Labels = None,
    show_labels: bool | None = None,
) -> rr.LineStrips3D:
    """Return lines in space, their radius in the viewer's points."""
    radii = ui_radius(radius_ui)
    return rr.LineStrips3D(lines, colors=color, radii=radii, labels=labels, show_labels=show_labels)


def strip_style(
    color: Color | None, radius_ui: float, show_labels: bool | None = None
) -> rr.LineStrips3D:
    """Return how the lines of an entity are drawn, their radius in the viewer's points."""
    return rr.LineStrips3D.from_fields(
        colors=color, radii=ui_radius(radius_ui), show_labels=show_labels
    )


def strip_style_2d(
    color: Color | None, radius_ui: float, order: float, show_labels: bool | None = None
) -> rr.LineStrips2D:
    """Return how the lines of an entity on a plane are drawn."""
    return rr.LineStrips2D.from_fields(
        colors=color, radii=ui_radius(radius_ui), draw_order=order, show_labels=show_labels
    )


def strips_2d(
    lines: Lines, color: Colors | None, radius_ui: float, order: float, labels: Labels = None
) -> rr.LineStrips2D:
    """Return lines on a plane, their radius in the viewer's points; labels are shown."""
    return rr.LineStrips2D(
        lines,
        colors=color,
        radii=ui_radius(radius_ui),
        draw_order=order,
        labels=labels,
        show_labels=None if labels is None else True,
    )


def words(places: npt.ArrayLike, texts: Sequence[str], color: Colors = TEXT_COLOR) -> rr.Points2D:
    """Return texts on a plane, without points."""
    return rr.Points2D(places, labels=texts, show_labels=True, colors=color, radii=0.0)


def at_height(points_map: FloatArray, height_m: float) -> FloatArray:
    """Return points (..., 2) in space, all at one height."""
    widths = [(0, 0)] * (points_map.ndim - 1) + [(0, 1)]
    return np.pad(points_map, widths, constant_values=height_m).astype(np.float32)


def unbroken(lines: FloatArray) -> tuple[pa.Array, IntArray]:
    """Split lines (L, n, 3) at jumps into strips; also return the line (S,) of each strip."""
    count, length = lines.shape[:2]
    points = lines.reshape(-1, 3)
    step = points[1:] - points[:-1]
    broken = np.ones(len(points), bool)
    broken[1:] = np.einsum("ij,ij->i", step, step) > JUMP_M**2
    broken[::length] = True
    starts = np.flatnonzero(broken)
    return strips_of(points, np.append(starts, count * length)), starts // length


def strips_of(points: FloatArray, starts: IntArray) -> pa.Array:
    """Return ragged line strips: strip i is points[starts[i]:starts[i + 1]]; points: (n, 3)."""
    flat = pa.array(points.astype(np.float32).ravel())
    inner = pa.FixedSizeListArray.from_arrays(flat, type=_STRIPS.value_type)
    return pa.ListArray.from_arrays(pa.array(starts, pa.int32()), inner, type=_STRIPS)


_STRIPS: Any = rr.components.LineStrip3DBatch([]).as_arrow_array().type


def upright_quads(
    ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return vertices (4K, 3) and triangles (2K, 3) over ends (K, 2, 2).

    bottom_m, top_m: heights (K, 2) or (K, 1).
    """
    corners = np.empty((len(ends), 4, 3), np.float32)
    corners[:, :2, :2], corners[:, :2, 2] = ends, bottom_m
    corners[:, 2:, :2], corners[:, 2:, 2] = ends[:, ::-1], top_m[:, ::-1]
    first = 4 * np.arange(len(ends), dtype=np.uint32)[:, None, None]
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.uint32) + first
    return corners.reshape(-1, 3), triangles.reshape(-1, 3)


def panel_mesh(
    ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray, color: Color
) -> rr.Mesh3D:
    """Return translucent upright rectangles over ends (K, 2, 2) between heights (K,)."""
    vertices, triangles = upright_quads(ends, bottom_m[:, None], top_m[:, None])
    return rr.Mesh3D(
        vertex_positions=vertices,
        triangle_indices=triangles,
        albedo_factor=(*color, SEE_THROUGH),
    )


def upright_frames(ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray) -> FloatArray:
    """Return closed outlines (K, 5, 3) over ends (K, 2, 2) between heights (K,)."""
    corners = upright_quads(ends, bottom_m[:, None], top_m[:, None])[0]
    return corners.reshape(-1, 4, 3)[:, [0, 1, 2, 3, 0]]
