"""The sign of deviations is right whatever files say of normals, or it is told that it is not known."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.deferred_imports import open3d
from calib.geometry import Pose
from calib.numerics import Floats, Ints
from scanner.comparing import SurfaceComparison, compare_surfaces
from scanner.io import read_surface, write_scalar_ply
from tests.support.blob import Blob
from tests.support.command_line import run

pytestmark = pytest.mark.xdist_group("outer sides")  # what the module shares is made once
DENT = 0.3
TOWARDS = (0.3, 0.1, 1.0)


def write_points(path: Path, points: Floats, normals: Floats | None = None, to: Pose | None = None) -> Path:
    o3d, place = open3d(), to or Pose(np.eye(3), np.zeros(3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(place @ points))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(place.rotate(normals))
    o3d.io.write_point_cloud(str(path), cloud)
    return path


def write_triangles(path: Path, vertices: Floats, triangles: Ints) -> Path:
    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    o3d.io.write_triangle_mesh(str(path), mesh.compute_triangle_normals())
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dented part, scanned from above, and its CAD model, with normals of all kinds."""
    folder, rng = tmp_path_factory.mktemp("sides"), np.random.default_rng(2)
    points, normals = Blob(dent=DENT).cloud(20_000, 1, TOWARDS)
    place = Pose(Rotation.random(rng=rng).as_matrix(), rng.uniform(-200, 200, 3))
    either = rng.choice([-1.0, 1.0], (len(points), 1))
    for name, given in (("plain", None), ("outwards", normals), ("inwards", -normals), ("either", either * normals)):
        write_points(folder / f"{name}.ply", points, given, place)
    vertices, triangles = Blob().mesh(10_000)
    write_triangles(folder / "cad.stl", vertices, triangles)
    write_triangles(folder / "inside-out.stl", vertices, triangles[:, ::-1])
    upper = triangles[(vertices[triangles].mean(axis=1) @ np.array(TOWARDS)) > -15.0]
    write_triangles(folder / "open-inside-out.stl", vertices, upper[:, ::-1])
    sound, outwards = Blob().cloud(30_000, 3, TOWARDS)
    write_points(folder / "sound-plain.ply", sound)
    write_points(folder / "sound-outwards.ply", sound, outwards)
    return folder


def compared(folder: Path, result: str, reference: str) -> SurfaceComparison:
    comparison = compare_surfaces(folder / f"{result}.ply", folder / reference, unit="mm")
    assert comparison.is_aligned
    return comparison


@pytest.mark.parametrize(
    ("result", "reference", "told"),
    [
        ("plain", "cad.stl", ""),
        ("plain", "inside-out.stl", ""),
        ("either", "cad.stl", "its normals are on both sides of the surface"),
        ("outwards", "sound-plain.ply", ""),
        ("inwards", "cad.stl", "its normals are on the other side"),
    ],
)
def test_a_dent_is_a_dent(result: str, reference: str, told: str, folder: Path) -> None:
    comparison = compared(folder, result, reference)
    assert comparison.measured is not None
    assert comparison.measured.knows_outside
    assert comparison.regions
    assert comparison.regions[0].peak == pytest.approx(-0.2, abs=0.1)  # of nine cells
    assert told in " ".join(comparison.notes)
    assert len(comparison.notes) == (1 if told else 0)


@pytest.mark.parametrize(
    ("result", "reference"),
    [("plain", "sound-plain.ply"), ("outwards", "open-inside-out.stl")],
)
def test_signs_that_nothing_decides_are_said_to_be_unknown(
    result: str, reference: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("compare", folder / f"{result}.ply", folder / reference, "--unit", "mm") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "signs of all deviations may be the reverse" in told
    assert ("open" in reference) == ("turned round" in told)
    assert "The surface deviates in one region" in told


def test_clouds_with_normals_on_either_side_are_joined(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [folder / name for name in ("sound-outwards.ply", "inwards.ply")]
    assert run("register", *given, "--out", folder / "joined") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "inwards.ply: its normals are on the other side" in told
    assert "All 2 clouds fit together" in told


def test_places_of_a_survey_keep_their_precision(folder: Path, tmp_path: Path) -> None:
    far = np.array([500_000.0, 4_000_000.0, 100.0])
    dented, sound = Blob(dent=DENT).cloud(20_000, 1, TOWARDS)[0], Blob().mesh(10_000)
    place = Pose(Rotation.from_rotvec([0.0, 0.0, 0.7]).as_matrix(), np.array([30.0, -20.0, 5.0]))
    for name, points in (
        ("result.ply", place.inverse() @ dented),
        ("reference.ply", Blob().cloud(30_000, 3, TOWARDS)[0]),
    ):
        zeros = np.zeros_like(points)
        write_scalar_ply(tmp_path / name, points + far, zeros, zeros.astype(np.uint8), {}, "mm", "")
    write_triangles(tmp_path / "cad.ply", sound[0] + far, sound[1])
    for reference in ("reference.ply", "cad.ply"):
        out = tmp_path / f"out-{reference}"
        assert run("compare", tmp_path / "result.ply", tmp_path / reference, "--out", out) == 0
        document = json.loads((out / "compare.json").read_text(encoding="utf-8"))
        rotation, translation = (np.array(document["alignment"][key]) for key in ("rotation", "translation"))
        found = (place.inverse() @ dented + far) @ rotation.T + translation
        assert np.abs(found - (dented + far)).max() < 0.05
        assert abs(document["regions"][0]["deviation"]) == pytest.approx(0.2, abs=0.1)
        stored = read_surface(out / "deviation.ply")
        assert np.abs(np.sort(stored.points, axis=0) - np.sort(found, axis=0)).max() < 1e-3
    mesh = read_surface(out / "reference.glb")
    assert np.abs(np.ptp(1000 * mesh.points, axis=0) - np.ptp(sound[0], axis=0)).max() < 0.5
