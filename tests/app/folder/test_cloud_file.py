"""cloud.ply, read back with trimesh."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from ffmap.algorithms.base.votes import FusedCloud
from ffmap.app.folder.cloud_file import read_ply, write_ply


@pytest.mark.parametrize("count", [0, 100])
def test_it_is_read_by_trimesh_and_by_its_header(tmp_path: Path, count: int) -> None:
    generator, path = np.random.default_rng(0), tmp_path / "cloud.ply"
    points = generator.uniform(-5, 5, (count, 3)).astype(np.float32)
    label = generator.integers(0, 5, count).astype(np.uint8)
    colours = generator.integers(0, 256, (count, 3)).astype(np.uint8)
    write_ply(path, FusedCloud(points, label), colours)
    header, body = path.read_bytes().split(b"end_header\n", 1)
    assert b"binary_little_endian" in header
    assert f"element vertex {count}\n".encode() in header
    assert b"property uchar label" in header
    np.testing.assert_array_equal(np.frombuffer(body, np.uint8).reshape(-1, 16)[:, 12], label)
    for read, written in zip(read_ply(path), (points, label), strict=True):
        np.testing.assert_array_equal(read, written)
    if count:
        mesh = trimesh.load(path)
        np.testing.assert_array_equal(mesh.vertices.astype(np.float32), points)
        np.testing.assert_array_equal(mesh.colors[:, :3], colours)
