"""`scan room` on a simulated room: poses of the stations, the rig, the walls, and every file of the result."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from calib.geometry import Pose
from calib.numerics import Floats
from scanner.configuration import CloudStep
from scanner.exporting import FORMATS, ExportRequest
from scanner.io import read_calibration, read_cloud
from scanner.results import read_joined, write_steps
from scanner.rooms.floorplan import floor_plan
from scanner.rooms.verdict import verdict_on
from scanner.viewing import ViewedResult
from tests.scanner.rooms.conftest import ORDER, SolvedExample
from tests.support.command_line import run


def to_world(example: SolvedExample) -> Pose:
    """From the room's frame to the simulation's, by the first station."""
    found, true = example.solved.stations[0].place, example.true[0].place
    return true @ found.inverse()


def test_all_stations_have_their_true_poses(example: SolvedExample) -> None:
    assert example.solved.group.stations == tuple(range(len(ORDER)))
    assert example.solved.outlier_stations == ()
    world = to_world(example)
    for found, true in zip(example.solved.stations[1:], example.true[1:], strict=True):
        off = world @ found.place.translation - true.place.translation
        turned = Rotation.from_matrix(world.rotation @ found.place.rotation @ true.place.rotation.T)
        assert 0 < np.linalg.norm(off) < 3e-3
        assert 0 < np.degrees(turned.magnitude()) < 0.05
        assert np.linalg.norm(off) < 5 * np.linalg.norm(found.sigma)
        assert 1e-5 < np.linalg.norm(found.sigma) < 5e-3


def test_the_room_determines_the_rig(example: SolvedExample) -> None:
    found, true = read_calibration(example.out / "calibration.yaml"), example.true[0].calibration
    for ours, theirs in ((found.camera, true.camera), (found.projector, true.projector)):
        assert 0 < abs(ours.focal_px[0] / theirs.focal_px[0] - 1) < 1e-3
    assert found.unit == "m"
    assert found.baseline == pytest.approx(true.baseline)


def test_z_is_up_from_the_floor(example: SolvedExample) -> None:
    world = to_world(example)
    assert np.degrees(np.arccos(min(1.0, (world.rotation @ [0, 0, 1])[2]))) < 0.05
    heights = [station.place.translation[2] for station in example.solved.stations]
    np.testing.assert_allclose(heights, [true.place.translation[2] for true in example.true], atol=3e-3)


def distances_to_surfaces(example: SolvedExample, points: Floats) -> Floats:
    """Distances of points (N, 3) in the room's frame from the true surfaces."""
    world = to_world(example)
    seen = np.concatenate([true.place @ true.points for true in example.true])
    distance, _ = cKDTree(seen).query(world @ points)
    return np.asarray(distance)


def test_cloud_and_mesh_are_on_the_surfaces(example: SolvedExample) -> None:
    cloud = read_cloud(example.out / "room.ply")
    assert 10_000 < len(cloud) < 200_000
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-3)
    grid = np.unique(np.floor(cloud.points / 0.01), axis=0)
    assert len(grid) > 0.8 * len(cloud)  # one point in a voxel, not one of each station
    pixel = 0.013  # of the camera at 3 m: what is known of the surfaces
    assert np.percentile(distances_to_surfaces(example, cloud.points[::50]), 95) < pixel
    scene = trimesh.load(example.out / "room.glb", force="mesh")
    assert isinstance(scene, trimesh.Trimesh)
    x, y, z = np.asarray(scene.vertices).T
    assert len(scene.faces) > 10_000
    points = np.stack([x, -z, y], axis=1)
    assert np.percentile(distances_to_surfaces(example, points[::50]), 90) < 2 * pixel
    for plane in example.solved.planes[:3]:
        off = np.abs(points @ plane.normal - plane.offset)
        assert 0 < np.median(off[off < 2 * pixel]) < 0.2 * pixel


def test_the_plan_has_the_walls_with_their_lengths(example: SolvedExample) -> None:
    plan, world = floor_plan(example.solved), to_world(example)
    scene = example.true[0].scene
    assert len(plan.gaps) + len(plan.corners) >= 3
    for line in plan.lines:
        on = world.rotation @ [*((line.start + line.end) / 2), 0.0] + world.translation
        if line.length is None:
            continue
        assert 1e-5 < line.length.sigma < 5e-3
        assert 3 < line.length.value < 5.3
        assert scene.room.contains(on[:, None] * 0.98 + 0.02)[0] or np.abs(on).min() < 0.2
    for corner in plan.corners:
        assert 0 < abs(corner.angle_deg.value - 90) < 1.5
        assert 1e-4 < corner.angle_deg.sigma < 0.1


def test_files_of_the_plan(example: SolvedExample) -> None:
    plan = floor_plan(example.solved)
    drawing = ezdxf.readfile(example.out / "floorplan.dxf")  # type: ignore[attr-defined]
    lines = [entity for entity in drawing.modelspace() if entity.dxftype() == "LINE"]
    assert len(lines) == len(plan.lines)
    assert drawing.header["$INSUNITS"] == 6
    text = (example.out / "floorplan.svg").read_text()
    assert text.count('<circle class="camera"') == len(ORDER)


def test_the_page_shows_the_results(example: SolvedExample) -> None:
    page = (example.out / "report.html").read_text()
    assert f"All {len(ORDER)} stations fit together as one room." in page
    for part in ('class="points"', '<th scope="row">extent</th>', "room.ply"):
        assert part in page
    assert re.search(r'class="quiet"[^>]*>[0-9]+</text>', page)  # the number of a plane on the plan
    assert page.count("<figcaption>") >= 4 + len(ORDER)
    assert 'src="http' not in page


def test_unmodelled_lens_distortion_is_reported(example: SolvedExample) -> None:
    estimate = example.solved.estimate
    assert verdict_on(example.solved).grade == "good"
    bent = replace(example.solved, estimate=replace(estimate, levels=replace(estimate.levels, alike=4.0)))
    verdict = verdict_on(bent)
    assert verdict.grade == "fair"
    assert "lenses" in verdict.headline
    assert "--calibration" in verdict.advice


def test_the_result_reads_back_and_exports(example: SolvedExample, tmp_path: Path) -> None:
    room = read_joined(example.out)
    assert room is not None
    assert [station.name for station in room.stations] == [str(file) for file in example.files]
    for stored, solved in zip(room.stations, example.solved.stations, strict=True):
        np.testing.assert_allclose(stored.place.rotation, solved.place.rotation)
        np.testing.assert_allclose(stored.place.translation, solved.place.translation)
    viewed = ViewedResult(example.out)
    places = [rig.position for rig in reversed(viewed.cloud(viewed.names[0]).rigs)]
    np.testing.assert_allclose(places, [station.place.translation for station in room.stations])
    pycolmap = pytest.importorskip("pycolmap")
    FORMATS["colmap"].write(ExportRequest(example.out, tmp_path / "colmap", most_points=2000))
    model = pycolmap.Reconstruction(tmp_path / "colmap")
    assert model.num_images() == 2 * len(ORDER)
    points = np.array([point.xyz for point in model.points3D.values()])
    assert np.median(distances_to_surfaces(example, points)) < 5e-3
    pye57 = pytest.importorskip("pye57")
    FORMATS["e57"].write(ExportRequest(example.out, tmp_path / "room.e57"))
    file = pye57.E57(str(tmp_path / "room.e57"))
    assert file.scan_count == len(ORDER)
    scan = file.read_scan(2, ignore_missing_fields=True, transform=True)
    points = np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1)[::100]
    assert np.median(distances_to_surfaces(example, points)) < 5e-3


def test_distances_between_stations_err_by_their_sigmas(example: SolvedExample, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    arguments, truth = list[object](), []
    for _ in range(60):
        stations = rng.choice(len(ORDER), 2, replace=False)
        ends = []
        for station in stations:
            true = example.true[station]
            number = rng.integers(len(true.points))
            x, y = true.matches.camera_px[number]
            ends.append(true.place @ true.points[number])
            arguments += [*(["--distance"] if len(ends) == 1 else []), f"{station + 1}:{x:g}", f"{y:g}"]
        truth.append(float(np.linalg.norm(ends[1] - ends[0])))
    assert run("measure", example.out, *arguments, "--out", tmp_path / "m", "--quiet") == 0
    distances = json.loads((tmp_path / "m/measure.json").read_text())["distances"]
    errors = [
        (distance["distance"] - true) / distance["sigma"] for distance, true in zip(distances, truth, strict=True)
    ]
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.5
    assert all(0 < distance["shares"]["poses"] < 5e-3 for distance in distances)
    assert {distance["between"][0][:8] for distance in distances} == {f"{number}: pixel" for number in (1, 2, 3, 4)}


def test_clicking_measures_in_the_whole_room(example: SolvedExample) -> None:
    whole = ViewedResult(example.out).cloud("The whole room")
    assert whole.scans is not None
    first, second = (whole.point_number(index) for index in (100, len(whole.points) - 100))
    assert np.linalg.norm(whole.scans.position(first) - whole.points[100]) < 0.02
    budget = whole.scans.distance((first, second)).budget
    assert budget is not None
    assert 1e-5 < budget.sigma < 1e-2


def test_a_room_without_pixels_to_measure(example: SolvedExample, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("measure", example.out) == 2
    assert "--distance 1:X1 Y1 2:X2 Y2" in capsys.readouterr().err
    for words, message in (("7:3", "1 to 4, found 7"), ("a:3", "found 'a:3' '9'")):
        assert run("measure", example.out, "--distance", words, "9", "20", "20") == 2
        assert message in capsys.readouterr().err


def test_steps_are_in_the_exports_of_a_room(example: SolvedExample, tmp_path: Path) -> None:
    """A box, in the room's axes, of cloud and mesh, whose points are in the room's axes in STL, too."""
    points = read_cloud(example.out / "room.ply").points
    low, high = np.quantile(points, 0.2, axis=0), np.quantile(points, 0.8, axis=0)
    low[2], high[2] = points[:, 2].min() - 1, points[:, 2].max() + 1
    write_steps(example.out, [CloudStep(box=",".join(f"{value:.6f}" for value in (*low, *high)))])
    try:
        FORMATS["ply"].write(ExportRequest(example.out, tmp_path / "room.ply"))
        FORMATS["stl"].write(ExportRequest(example.out, tmp_path / "room.stl"))
        FORMATS["mesh"].write(ExportRequest(example.out, tmp_path / "room.glb"))
    finally:
        write_steps(example.out, [])
    cut = read_cloud(tmp_path / "room.ply").points
    inside = np.all((points >= low - 1e-5) & (points <= high + 1e-5), axis=1)
    assert 100 < len(cut) <= inside.sum() < len(points)
    stl: Any = trimesh.load(tmp_path / "room.stl")
    corners = np.asarray(stl.vertices) / 1000
    assert len(corners) > 100
    assert np.all((corners >= low - 1e-4) & (corners <= high + 1e-4))
    glb: Any = trimesh.load(tmp_path / "room.glb", process=False)
    (mesh,) = glb.geometry.values()
    linear = np.asarray(mesh.visual.vertex_attributes["color"], np.float64)[:, :3] / 65535
    encoded = np.rint(255 * (1.055 * linear ** (1 / 2.4) - 0.055)).astype(int)
    shades = read_cloud(tmp_path / "room.ply").colours
    assert shades.min() <= encoded.min() <= encoded.max() <= shades.max()  # the cloud's colours, without its pictures
