"""Clouds and meshes of any program are read, or refused by name."""

import sys
from pathlib import Path

import numpy as np
import pytest

from calib.deferred_imports import open3d
from scanner.errors import InputError
from scanner.exporting import FORMATS, ExportRequest
from scanner.io import is_surface_file, read_surface
from tests.support.blob import Blob
from tests.support.result_folder import Written, write_result
from tests.support.step_file import step_of_box

CLOUDS = {"ply": "a.ply", "pcd": "a.pcd", "e57": "a.e57", "las": "a.las"}
MESHES = {"mesh": "m.obj", "stl": "m.stl", "3mf": "m.3mf"}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("surfaces") / "room")


@pytest.mark.parametrize("kind", CLOUDS)
def test_clouds_that_are_exported_read_back(kind: str, written: Written, tmp_path: Path) -> None:
    out = tmp_path / CLOUDS[kind]
    FORMATS[kind].write(ExportRequest(written.folder, out))
    read = read_surface(out)
    assert read.unit == "m"
    assert read.triangles is None
    assert len(read.points) == len(written.scan)
    upright = kind in ("e57", "las")
    points = read.points @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]) if upright else read.points
    order, own = (values[np.lexsort(values.round(4).T)] for values in (points, written.scan.points))
    assert np.abs(order.mean(axis=0) - own.mean(axis=0)).max() < 1e-5
    assert (read.normals is not None) == (kind in ("ply", "pcd"))
    assert (read.eye is not None) == (kind in ("ply", "e57"))


@pytest.mark.parametrize("kind", MESHES)
def test_meshes_that_are_exported_read_back(kind: str, written: Written, tmp_path: Path) -> None:
    out = tmp_path / MESHES[kind]
    FORMATS[kind].write(ExportRequest(written.folder, out))
    read = read_surface(out)
    assert read.triangles is not None
    assert len(read.triangles) > len(written.scan)
    factor = {"m": 1.0, "mm": 1000.0}[str(read.unit)]
    assert np.allclose(
        np.sort(np.ptp(read.points, axis=0)), np.sort(factor * np.ptp(written.scan.points, axis=0)), rtol=0.01
    )


def test_points_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    points, _ = Blob().cloud(500, 0)
    points[::10] = np.nan
    np.savetxt(tmp_path / "a.xyz", points)
    read = read_surface(tmp_path / "a.xyz")
    assert (len(read.points), read.dropped) == (450, 50)
    assert np.isfinite(read.points).all()


def test_large_clouds_are_thinned_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scanner.io.surface_file.MOST_POINTS", 400)
    np.savetxt(tmp_path / "a.xyz", Blob().cloud(1000, 0)[0])
    read = read_surface(tmp_path / "a.xyz")
    assert read.thinned_from == 1000
    assert 250 < len(read.points) <= 400


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.ply", b"", "is empty"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", "holds no point"),
        ("a.stl", b"solid nothing\nendsolid nothing\n", "no triangle"),
        ("a.3mf", b"PK\x03\x04 not a zip", "damaged"),
        ("a.las", b"LASF" + bytes(400), "damaged"),
        ("a.e57", b"ASTM-E57" + bytes(400), "damaged"),
        ("a.iges", b"x", "export it from the CAD program"),
        ("a.docx", b"x", "expected a cloud or a mesh"),
    ],
)
def test_what_is_no_surface_is_refused(name: str, content: bytes, told: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=told):
        read_surface(tmp_path / name)


def test_a_mesh_of_triangles_without_area_is_refused(tmp_path: Path) -> None:
    o3d = open3d()
    vertices = o3d.utility.Vector3dVector(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]))
    mesh = o3d.geometry.TriangleMesh(vertices, o3d.utility.Vector3iVector(np.array([[0, 1, 2]])))
    o3d.io.write_triangle_mesh(str(tmp_path / "a.obj"), mesh)
    with pytest.raises(InputError, match="no triangle that has an area"):
        read_surface(tmp_path / "a.obj")


@pytest.mark.parametrize("in_metres", [False, True])
def test_step_files_are_read_in_millimetres(in_metres: bool, tmp_path: Path) -> None:
    pytest.importorskip("cascadio", reason="cascadio is not installed")
    size, corner = np.array([100.0, 60.0, 30.0]), np.array([10.0, 20.0, 30.0])
    unit = 1e-3 if in_metres else 1.0
    (tmp_path / "box.stp").write_text(step_of_box(unit * size, unit * corner, in_metres=in_metres))
    read = read_surface(tmp_path / "box.stp")
    assert read.unit == "mm"
    assert read.triangles is not None
    assert len(read.triangles) == 12
    assert np.allclose([read.points.min(axis=0), read.points.max(axis=0)], [corner, corner + size])


def test_damaged_step_files_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("cascadio", reason="cascadio is not installed")
    whole = step_of_box((1, 1, 1), (0, 0, 0))
    for content in ("ISO-10303-21;", whole[: len(whole) // 2], whole[:200] + "ENDSEC;\nEND-ISO-10303-21;\n"):
        (tmp_path / "a.step").write_text(content)
        with pytest.raises(InputError, match="damaged file"):
            read_surface(tmp_path / "a.step")


def test_step_without_cascadio_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cascadio", None)
    (tmp_path / "a.step").write_text(step_of_box((1, 1, 1), (0, 0, 0)))
    with pytest.raises(InputError, match=r"\[step\]"):
        read_surface(tmp_path / "a.step")


def test_files_are_known_by_their_endings() -> None:
    assert all(is_surface_file(Path(name)) for name in ("a.PLY", "b.stl", "c.step", "d.laz"))
    assert not any(is_surface_file(Path(name)) for name in ("calibration.yaml", "calibration", "stereo.xml"))
