from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from calib.geometry import Matches
from calib.pointcloud import Cloud, build_cloud
from scanner.io.ply import write_ply
from tests.support.cloud_scene import room

_TYPES = {"float": "<f4", "uchar": "u1", "int": "<i4"}


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    scene = room()
    return build_cloud(scene.matches, scene.texture, scene.calibration)


def parse_ply(path: Path) -> tuple[list[str], NDArray[np.void]]:
    """Header lines and vertices, by the definition of the format."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    fields = [(line.split()[2], _TYPES[line.split()[1]]) for line in lines if line.startswith("property")]
    vertices = np.frombuffer(body, dtype=np.dtype(fields))
    assert len(vertices) == count
    return lines, vertices


def test_the_cloud_is_written(cloud: Cloud, tmp_path: Path) -> None:
    write_ply(tmp_path / "cloud.ply", cloud, match=cloud.match)
    lines, vertices = parse_ply(tmp_path / "cloud.ply")
    assert vertices.dtype.names == ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "match")
    assert np.array_equal(vertices["match"], cloud.match[cloud.there])
    for names, values in (("x y z", cloud.points), ("nx ny nz", cloud.normals), ("red green blue", cloud.colours)):
        written = np.stack([vertices[name] for name in names.split()], axis=1)
        assert np.array_equal(written, values[cloud.there])
    assert len(vertices) == cloud.statistics.kept > 10_000
    assert "comment unit m (of x, y, z)" in lines


def test_an_empty_cloud_is_a_valid_file(tmp_path: Path) -> None:
    scene = room()
    nothing = Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    write_ply(tmp_path / "cloud.ply", build_cloud(nothing, None, scene.calibration))
    assert len(parse_ply(tmp_path / "cloud.ply")[1]) == 0


@pytest.mark.parametrize("unit", ["m\nend_header\n", "µm", "  in\tches \r\n"])
def test_an_odd_unit_does_not_break_the_header(cloud: Cloud, tmp_path: Path, unit: str) -> None:
    write_ply(tmp_path / "cloud.ply", replace(cloud, unit=unit))
    lines, vertices = parse_ply(tmp_path / "cloud.ply")
    assert sum(line.startswith("comment unit") for line in lines) == 1
    assert len(vertices) == cloud.statistics.kept


def test_open3d_reads_it(cloud: Cloud, tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d", reason="Open3D is not installed")
    write_ply(tmp_path / "cloud.ply", cloud)
    read = open3d.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    assert np.abs(np.asarray(read.points) - cloud.points[cloud.there]).max() < 1e-6
    assert np.abs(np.asarray(read.normals) - cloud.normals[cloud.there]).max() < 1e-6
    assert np.abs(np.asarray(read.colors) * 255 - cloud.colours[cloud.there]).max() < 1
