"""Clouds and meshes of any program are read, or refused by name."""

import sys
from pathlib import Path

import numpy as np
import pytest

from calib.deferred_imports import open3d
from calib.numerics import Floats
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
    monkeypatch.setattr("scanner.io.stored_points.MOST_POINTS", 400)
    np.savetxt(tmp_path / "a.xyz", Blob().cloud(1000, 0)[0])
    read = read_surface(tmp_path / "a.xyz")
    assert read.thinned_from == 1000
    assert 250 < len(read.points) <= 400


def as_ply(values: Floats, names: str, *, kind: str = "<f4", end: str = "\n", faces: bytes = b"") -> bytes:
    """Vertices with properties of one type, as binary PLY."""
    order = "big" if kind.startswith(">") else "little"
    header = ["ply", f"format binary_{order}_endian 1.0", f"element vertex {len(values)}"]
    header += [f"property {'double' if kind.endswith('8') else 'float'} {name}" for name in names.split()]
    header += ["element face 2", "property list uchar int vertex_indices"] if faces else []
    return end.join([*header, "end_header", ""]).encode() + values.astype(kind).tobytes() + faces


@pytest.mark.parametrize(("kind", "end"), [("<f4", "\n"), (">f4", "\n"), ("<f8", "\n"), ("<f4", "\r\n")])
def test_binary_ply_of_other_programs_is_read(kind: str, end: str, tmp_path: Path) -> None:
    points = Blob().cloud(400, 0)[0]
    far = points + ([500_000.0, 4_000_000.0, 100.0] if kind == "<f8" else [0.0, 0.0, 0.0])
    (tmp_path / "a.ply").write_bytes(as_ply(np.hstack([np.ones((400, 1)), far]), "intensity x y z", kind=kind, end=end))
    read = read_surface(tmp_path / "a.ply")
    assert np.abs(read.points - far).max() < 1e-5
    assert read.normals is None


def test_what_cannot_have_been_measured_is_left_out(tmp_path: Path) -> None:
    points = Blob().cloud(1000, 0)[0] + [0.0, 0.0, 300.0]
    points[:100], points[100:103], points[103:123] = 0.0, 1e30, points[200:220]
    (tmp_path / "a.ply").write_bytes(as_ply(points, "x y z"))
    read = read_surface(tmp_path / "a.ply")
    assert (read.at_origin, read.stray, read.repeated, read.dropped) == (100, 3, 20, 0)
    assert np.abs(read.points - np.delete(points, np.r_[:103, 200:220], axis=0)).max() < 1e-4


def test_one_point_at_the_origin_stays(tmp_path: Path) -> None:
    points = Blob().cloud(100, 0)[0]
    points[7] = 0.0
    (tmp_path / "a.ply").write_bytes(as_ply(points, "x y z"))
    assert len(read_surface(tmp_path / "a.ply").points) == 100


@pytest.mark.parametrize(("wrong", "value", "is_used"), [(20, 0.0, True), (20, np.nan, True), (500, 0.0, False)])
def test_normals_that_are_none_are_not_used(wrong: int, value: float, is_used: bool, tmp_path: Path) -> None:
    points, normals = Blob().cloud(1000, 0)
    given = 2.5 * normals
    given[:wrong] = value
    (tmp_path / "a.ply").write_bytes(as_ply(np.hstack([points, given]), "x y z nx ny nz"))
    read = read_surface(tmp_path / "a.ply")
    assert (read.normals is not None) == is_used
    if read.normals is not None:
        assert np.allclose(np.linalg.norm(read.normals, axis=1), 1.0)
        assert np.abs(read.normals[wrong:] - normals[wrong:]).max() < 1e-6
        assert np.median(np.sum(read.normals[:wrong] * normals[:wrong], axis=1)) > 0.9  # of the nearest points


def test_a_vertex_that_is_very_far_away_is_no_part_of_a_mesh(tmp_path: Path) -> None:
    vertices = np.random.default_rng(1).uniform(0, 1, (30, 3))
    vertices[5] = [1e30, 0, 0]
    faces = np.array([(3, 0, 1, 2), (3, 1, 3, 5)], [("n", "u1"), ("a", "<i4"), ("b", "<i4"), ("c", "<i4")]).tobytes()
    (tmp_path / "a.ply").write_bytes(as_ply(vertices, "x y z", faces=faces))
    read = read_surface(tmp_path / "a.ply")
    assert (len(read.points), read.stray) == (3, 1)


CUT_OFF = as_ply(np.ones((90, 3)), "x y z")[:-100]
CUT_OFF_FACES = as_ply(np.eye(3), "x y z", faces=b"\3\0\0\0\0\1\0\0\0\2\0\0\0")


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.ply", b"Dear Sir,\n", "which begins with 'ply', found something else"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement ver", "header does not end"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "found a header without them"),
        ("a.ply", as_ply(np.ones((90, 3)), "x y w"), "expected points with x, y and z, found x, y, w"),
        ("a.ply", CUT_OFF, "is truncated: its header promises 90 points, and 81 are there"),
        ("a.ply", CUT_OFF_FACES, "promises 2 faces, and 1 triangles can be read"),
        ("a.off", b"OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "promises 2 faces, and 1 triangles can be read"),
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
