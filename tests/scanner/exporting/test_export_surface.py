"""`scan export` of points and triangles: PLY, E57, OBJ and GLB, read with the libraries of each."""

import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calib.pointcloud import SeenPoints, image_triangles
from scanner.commands import main
from scanner.exporting.triangles import Mesh, build_mesh
from tests.support.cloud_scene import SPHERE_RADIUS_M
from tests.support.result_folder import Written, write_result

# From the camera's axes (x right, y down, z forward) to y up, looking along −z; and to z up, looking along y.
Y_UP = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]])
Z_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("surface") / "room")


@pytest.fixture(scope="module")
def mesh(written: Written) -> Mesh:
    return build_mesh(written.scan)


def export(result: Path, to: str, out: Path) -> Path:
    assert main(["export", str(result), "--to", to, "--out", str(out), "--quiet"]) == 0
    return out


def test_the_exported_cloud_is_unchanged(written: Written, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    out = export(written.folder, "ply", tmp_path / "cloud.ply")
    assert out.read_bytes() == (written.folder / "cloud.ply").read_bytes()
    cloud = trimesh.load(out)
    assert np.array_equal(cloud.vertices, written.scan.points)
    assert np.array_equal(cloud.colors[:, :3], written.scan.colours)


def test_a_pcd_has_the_same_points(written: Written, tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError, reason="Open3D is not installed")
    cloud = open3d.io.read_point_cloud(str(export(written.folder, "pcd", tmp_path / "cloud.pcd")))
    assert np.allclose(np.asarray(cloud.points), written.scan.points, atol=1e-6)
    assert np.allclose(np.asarray(cloud.normals), written.scan.normals, atol=1e-6)
    assert np.array_equal(np.rint(255 * np.asarray(cloud.colors)), written.scan.colours)


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_e57_is_upright_and_in_metres(tmp_path: Path, unit: str) -> None:
    pye57 = pytest.importorskip("pye57", reason="pye57 is not installed")
    written = write_result(tmp_path / "room", unit=unit)
    with pye57.E57(str(export(written.folder, "e57", tmp_path / "room.e57"))) as file:
        assert file.scan_count == 1
        data = file.read_scan(0, colors=True, row_column=True)
    points = np.stack([data[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
    assert np.allclose(points, written.scan.points @ Z_UP.T * {"m": 1.0, "mm": 1e-3}[unit], rtol=1e-12)
    colours = np.stack([data[f"color{name}"] for name in ("Red", "Green", "Blue")], axis=1)
    assert np.array_equal(colours, written.scan.colours)
    assert np.array_equal(data["columnIndex"], written.scan.pixel[:, 0])
    assert np.array_equal(data["rowIndex"], written.scan.pixel[:, 1])


def loaded(path: Path) -> Any:
    """The mesh as trimesh has it, with nothing merged or reordered."""
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    read = trimesh.load(path, process=False)
    if not isinstance(read, trimesh.Scene):
        return read
    (mesh,) = read.geometry.values()
    assert np.array_equal(read.graph.get(read.graph.nodes_geometry[0])[0], np.eye(4))
    return mesh


@pytest.mark.parametrize(("name", "axes"), [("m.ply", np.eye(3)), ("m.obj", Y_UP), ("m.glb", Y_UP)])
def test_all_mesh_formats_hold_the_same_surface(
    written: Written, mesh: Mesh, tmp_path: Path, name: str, axes: NDArray[np.int64]
) -> None:
    read = loaded(export(written.folder, "mesh", tmp_path / name))
    normals, points, triangles = (np.array(part) for part in (read.vertex_normals, read.vertices, read.faces))
    assert np.allclose(points, mesh.points @ axes.T, rtol=1e-6, atol=1e-6)
    assert np.array_equal(triangles, mesh.triangles)
    assert np.allclose(normals, mesh.normals @ axes.T, atol=1e-4)
    corners = points[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.mean(np.sum(facing * corners[:, 0], axis=1) < 0) > 0.999  # the camera is at the origin


def test_ply_and_obj_show_the_cameras_colours(written: Written, mesh: Mesh, tmp_path: Path) -> None:
    for name in ("m.ply", "m.obj"):
        read = loaded(export(written.folder, "mesh", tmp_path / name))
        assert np.abs(read.visual.vertex_colors[:, :3].astype(int) - mesh.colours).max() <= 1
    assert np.ptp(mesh.colours) > 50


def test_colours_of_glb_are_linear(written: Written, mesh: Mesh, tmp_path: Path) -> None:
    read = loaded(export(written.folder, "mesh", tmp_path / "m.glb"))
    linear = np.asarray(read.visual.vertex_attributes["color"], np.float64)[:, :3] / 65535
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(255 * shown - mesh.colours).max() < 0.6
    assert np.abs(255 * linear - mesh.colours).max() > 30


def test_glb_is_in_metres(tmp_path: Path) -> None:
    written = write_result(tmp_path / "room", unit="mm")
    points = loaded(export(written.folder, "mesh", tmp_path / "m.glb")).vertices
    assert np.allclose(points, 1e-3 * build_mesh(written.scan).points @ Y_UP, rtol=1e-6, atol=1e-9)


def test_no_triangle_bridges_a_depth_step(written: Written, mesh: Mesh) -> None:
    """The ball hangs in front of the walls: a triangle has all of its corners on it, or none."""
    from_centre = np.linalg.norm(mesh.points - written.scene.sphere_centre, axis=1)
    on_ball = np.abs(from_centre - SPHERE_RADIUS_M) < 0.01
    corners = on_ball[mesh.triangles].sum(axis=1)
    assert np.count_nonzero(corners == 3) > 2_000
    assert np.count_nonzero(corners == 0) > 20_000
    assert not np.any((corners == 1) | (corners == 2))


def test_the_surface_is_complete(written: Written, mesh: Mesh) -> None:
    """Two triangles per pixel for nearly all pixels, on the true surfaces, with nearly their area."""
    assert 1.9 < len(mesh.triangles) / len(written.scan) < 2.0
    assert 0.99 < len(mesh.points) / len(written.scan) <= 1.0
    middles = mesh.points[mesh.triangles].mean(axis=1)
    scene = written.scene
    distances = np.abs((middles - scene.corner.vertex) @ scene.corner.normals.T)
    ball = np.abs(np.linalg.norm(middles - scene.sphere_centre, axis=1) - SPHERE_RADIUS_M)
    off = np.minimum(distances.min(axis=1), ball)
    assert 1e-6 < np.median(off) < 1e-3
    assert np.quantile(off, 0.999) < 0.01


def flat(normal: tuple[float, float, float], shape: tuple[int, int] = (40, 50)) -> SeenPoints:
    """A plane through (0, 0, 2) seen by a camera of 100 px focal length, in the order of the pixels."""
    column, row = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    pixel = np.stack([column, row], axis=-1).reshape(-1, 2).astype(float)
    rays = np.column_stack([(pixel - (25, 20)) / 100, np.ones(len(pixel))])
    direction = np.array(normal) / np.linalg.norm(normal)
    points = rays * (2 * direction[2] / (rays @ direction))[:, None]
    return SeenPoints(pixel, points, np.tile(direction, (len(points), 1)), 100)


def some(points: SeenPoints, chosen: NDArray[Any]) -> SeenPoints:
    return SeenPoints(points.pixel[chosen], points.points[chosen], points.normals[chosen], points.focal_px)


@pytest.mark.parametrize("tilt_deg", [0, 60, 80, 86])
def test_a_slanting_plane_is_not_cut(tilt_deg: float) -> None:
    tilt = np.radians(tilt_deg)
    assert len(image_triangles(flat((0, np.sin(tilt), -np.cos(tilt)), (12, 50)))) == 2 * 11 * 49


def test_a_step_is_cut_and_a_missing_pixel_costs_its_triangles() -> None:
    plane = flat((0, 0, -1))
    nearer = np.where(plane.pixel[:, :1] >= 25, 0.9, 1.0)  # by 0.2, ten times the step of a pixel
    assert len(image_triangles(replace(plane, points=nearer * plane.points))) == 2 * 39 * (24 + 24)
    holed = some(plane, np.any(plane.pixel != 20, axis=1))
    assert len(image_triangles(holed)) == 2 * 39 * 49 - 4


@pytest.mark.parametrize("origin", [(0, 0), (14_000, 9_000)])
def test_the_place_in_the_image_does_not_matter(origin: tuple[int, int]) -> None:
    plane = flat((0, 0.3, -1), (140, 50))
    rng = np.random.default_rng(0)
    there = rng.random(len(plane.pixel)) < 0.95
    triangles = image_triangles(some(plane, there))
    moved = image_triangles(some(replace(plane, pixel=plane.pixel + origin), there))
    assert 1.5 * len(plane.pixel) < len(triangles) < 2 * len(plane.pixel)
    assert np.array_equal(triangles, moved)
    shuffled = rng.permutation(np.count_nonzero(there))
    again = shuffled[image_triangles(some(some(plane, there), shuffled))]
    assert {*map(frozenset, again.tolist())} == {*map(frozenset, triangles.tolist())}


def test_memory_is_that_of_the_points_however_large_the_image() -> None:
    plane = flat((0, 0, -1))
    few = replace(plane, pixel=plane.pixel * (300, 300))
    tracemalloc.start()
    try:
        assert len(image_triangles(few)) == 2 * 39 * 49
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 100_000_000  # the image has 176 million pixels


def test_processing_in_strips_leaves_no_seam() -> None:
    assert len(image_triangles(flat((0, 0, -1), (300, 10)))) == 2 * 299 * 9


def test_scattered_points_give_a_surface(tmp_path: Path) -> None:
    """One point for about nine pixels, as if the projector's pixels are larger than the camera's."""
    rng = np.random.default_rng(0)
    written = write_result(tmp_path / "room", keep=lambda pixels: rng.random(len(pixels)) < 0.11)
    mesh = build_mesh(written.scan)
    assert 1.5 < len(mesh.triangles) / len(written.scan) < 2.0
    corners = mesh.points[mesh.triangles]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.mean(np.sum(outward * corners[:, 0], axis=1) < 0) > 0.995
    on_ball = np.linalg.norm(corners - written.scene.sphere_centre, axis=2) < SPHERE_RADIUS_M + 0.01
    assert np.count_nonzero(on_ball.all(axis=1)) > 200
    assert np.count_nonzero(on_ball.any(axis=1) & ~on_ball.all(axis=1)) == 0


def test_a_gap_is_not_bridged() -> None:
    plane = flat((0, 0, -1))
    few = some(plane, (np.arange(len(plane.pixel)) % 3 == 0) & (np.abs(plane.pixel[:, 0] - 25) > 8))
    left = few.pixel[image_triangles(few)][..., 0] < 25
    assert np.count_nonzero(left.all(axis=1)) > 100
    assert np.array_equal(left.all(axis=1), left.any(axis=1))


@pytest.mark.parametrize(("name", "unit"), [("c.las", "m"), ("c.laz", "mm")])
def test_las_is_z_up_in_metres(tmp_path: Path, name: str, unit: str) -> None:
    laspy = pytest.importorskip("laspy", reason="laspy is not installed")
    written = write_result(tmp_path / "room", unit=unit)
    las = laspy.read(export(written.folder, "las", tmp_path / name))
    assert str(las.header.version) == "1.4"
    assert las.header.are_points_compressed == name.endswith("z")
    expected = written.scan.points @ Z_UP.T * {"m": 1.0, "mm": 1e-3}[unit]
    assert np.abs(las.xyz - expected).max() <= 0.51e-6
    colours = np.stack([las.red, las.green, las.blue], axis=1)
    assert np.array_equal(colours // 257, written.scan.colours)
    assert np.array_equal(colours % 257, np.zeros_like(colours))


def test_las_without_laspy_says_what_to_install(
    written: Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "laspy", None)
    assert main(["export", str(written.folder), "--to", "las", "--out", str(tmp_path / "c.las")]) == 2
    assert "[las]" in capsys.readouterr().err
    assert not (tmp_path / "c.las").exists()


def test_usd_holds_the_same_surface(written: Written, mesh: Mesh, tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    assert pxr is not None
    stage = Usd.Stage.Open(str(export(written.folder, "usd", tmp_path / "m.usda")))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    read = UsdGeom.Mesh(stage.GetDefaultPrim())
    points = np.array(read.GetPointsAttr().Get())
    assert np.allclose(points, mesh.points @ Y_UP, rtol=1e-6, atol=1e-6)
    assert np.array_equal(np.array(read.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), mesh.triangles)
    assert np.array_equal(np.array(read.GetFaceVertexCountsAttr().Get()), np.full(len(mesh.triangles), 3))
    assert np.allclose(np.array(read.GetNormalsAttr().Get()), mesh.normals @ Y_UP, atol=1e-4)
    linear = np.array(read.GetDisplayColorAttr().Get())
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(255 * shown - mesh.colours).max() < 0.6
    extent = np.array(read.GetExtentAttr().Get())
    assert np.allclose(extent, [points.min(axis=0), points.max(axis=0)], atol=1e-6)
