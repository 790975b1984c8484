"""cloud.ply, read back with trimesh."""

from pathlib import Path

import numpy as np
import trimesh

from ffmap.algorithms.building.votes import FusedCloud
from ffmap.app.folder.cloud_file import write_ply


class TestPly:
    def test_read_by_trimesh_and_by_its_header(self, tmp_path: Path):
        generator = np.random.default_rng(0)
        points = generator.uniform(-5, 5, (100, 3)).astype(np.float32)
        label = generator.integers(0, 5, 100).astype(np.uint8)
        colours = generator.integers(0, 256, (100, 3)).astype(np.uint8)
        write_ply(tmp_path / "cloud.ply", FusedCloud(points, label), colours)
        mesh = trimesh.load(tmp_path / "cloud.ply")
        np.testing.assert_array_equal(mesh.vertices.astype(np.float32), points)
        np.testing.assert_array_equal(mesh.colors[:, :3], colours)
        header, body = (tmp_path / "cloud.ply").read_bytes().split(b"end_header\n", 1)
        assert b"binary_little_endian" in header
        assert b"property uchar label" in header
        np.testing.assert_array_equal(np.frombuffer(body, np.uint8).reshape(100, 16)[:, 12], label)

    def test_empty(self, tmp_path: Path):
        write_ply(
            tmp_path / "cloud.ply",
            FusedCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint8)),
            np.zeros((0, 3), np.uint8),
        )
        assert (tmp_path / "cloud.ply").read_bytes().endswith(b"element vertex 0\n" + _PROPERTIES)


_PROPERTIES = (
    b"property float x\nproperty float y\nproperty float z\nproperty uchar label\n"
    b"property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
)
