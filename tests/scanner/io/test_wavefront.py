"""Meshes as OBJ, with faces of any number of corners."""

from pathlib import Path

import numpy as np
import pytest

from calib.numerics import Floats, Ints
from scanner.errors import InputError
from scanner.io import read_surface
from scanner.io.wavefront import read_obj, triangulated

CUBE = [[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]
QUADRANGLES = [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]]


def area_and_volume(points: Floats, triangles: Ints) -> tuple[float, float]:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    return float(area), float(np.sum(a * np.cross(b, c))) / 6


@pytest.mark.parametrize("style", ["plain", "textures", "backwards", "Windows"])
def test_quadrangles_are_filled(style: str, tmp_path: Path) -> None:
    rows = [f"v {x} {y} {z}" for x, y, z in CUBE] + ["vt 0 0", "vn 0 0 1", "usemtl grey"]
    for face in QUADRANGLES:
        corner = {"textures": "{}/1/1", "backwards": "-{}"}.get(style, "{}")
        numbers = [9 - k if style == "backwards" else k for k in face]
        rows.append("f " + " ".join(corner.format(k) for k in numbers))
    (tmp_path / "a.obj").write_bytes(("\r\n" if style == "Windows" else "\n").join(rows).encode())
    read = read_surface(tmp_path / "a.obj")
    assert read.triangles is not None
    assert len(read.triangles) == 12
    assert area_and_volume(read.points, read.triangles) == pytest.approx((6.0, 1.0))


def test_faces_with_reentrant_corners_are_filled_once() -> None:
    star = np.array([[np.cos(t), np.sin(t), 0.3] for t in np.arange(10) * np.pi / 5])
    star[1::2, :2] *= 0.4
    corners = star * [1.0, 1.0, 0.0]
    true = np.cross(corners, np.roll(corners, -1, axis=0))[:, 2].sum() / 2
    for first in range(10):
        polygon = np.roll(np.arange(10), first)
        triangles = triangulated(star, polygon[None])
        assert len(triangles) == 8
        assert area_and_volume(star, triangles)[0] == pytest.approx(true)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "is damaged.*corners that do not exist"),
        ("v 0 0 0\nv 1 0 x\nf 1 2 2\n", "is damaged"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "holds no triangle"),
        ("Dear Sir\n", "holds no triangle"),
    ],
)
def test_damaged_files_are_refused(text: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(InputError, match=told):
        read_surface(tmp_path / "a.obj")


def test_a_file_without_faces_has_no_triangle(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    vertices, triangles = read_obj(tmp_path / "a.obj")
    assert (vertices.shape, triangles.shape) == ((1, 3), (0, 3))
