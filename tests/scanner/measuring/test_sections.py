"""Sections of a simulated corner with a ball: contours against the truth, as a table and as drawings."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.diagnostics import SystematicErrors, Uncertainty
from calib.refinement import SHARED, State, device_of
from scanner.cleaning import read_cleaned
from scanner.commands import main
from scanner.exporting import Mesh
from scanner.measuring import rig_errors
from scanner.measuring.sections import _free_place, cut, parse_plane, section_lines
from tests.support.cloud_scene import SPHERE_RADIUS_M
from tests.support.result_folder import Written, write_result


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("sections") / "room")


def run(result: Path, out: Path, *options: str) -> int:
    return main(["section", str(result), "--out", str(out), *options])


def sphere(rings: int = 60) -> Mesh:
    """Of radius 1 about the origin, closed."""
    o3d = pytest.importorskip("open3d")
    mesh = o3d.geometry.TriangleMesh.create_sphere(1.0, rings)
    points = np.asarray(mesh.vertices)
    return Mesh(points, points, np.zeros(points.shape, np.uint8), np.asarray(mesh.triangles).astype(np.int64), "m")


@pytest.mark.parametrize("text", ["z=0.3", "x=-0.5", "0,0.6,0.8,0.25", "1,1,1,-0.7"])
def test_a_sphere_is_cut_in_one_closed_circle(text: str) -> None:
    plane = parse_plane(text, "m")
    ((points, is_closed),) = section_lines(sphere(), plane)
    assert is_closed
    assert np.abs(points @ plane.normal - plane.offset).max() < 1e-12
    length = np.linalg.norm(np.diff(np.concatenate([points, points[:1]]), axis=0), axis=1).sum()
    assert 0.99 < length / (2 * np.pi * np.sqrt(1 - plane.offset**2)) < 1
    radius = np.sqrt(1 - plane.offset**2)
    assert np.linalg.norm(points @ plane.axes.T, axis=1) == pytest.approx(np.full(len(points), radius), rel=0.02)


def test_contours_of_a_capture_are_on_its_walls_and_as_long(written: Written) -> None:
    """A plane along the floor's normal through the ball's centre cuts it in an arc."""
    corner, centre = written.scene.corner, written.scene.sphere_centre
    floor = corner.normals[int(np.argmax(corner.normals @ [0, -1, 0]))]
    text = ",".join(f"{value:.9f}" for value in (*floor, float(floor @ centre)))
    contours = cut(read_cleaned(written.folder), [text], None, None)
    plane = contours[0].plane
    at = plane.axes @ centre
    arcs = [c for c in contours if np.abs(np.linalg.norm(c.points - at, axis=1) - SPHERE_RADIUS_M).max() < 0.01]
    (arc,) = [c for c in arcs if c.length > 0.1]
    directions = arc.points - at
    turned = np.unwrap(np.arctan2(directions[:, 1], directions[:, 0]))
    truth = SPHERE_RADIUS_M * np.ptp(turned)
    assert 0.98 < arc.length / truth < 1.005
    assert not arc.is_closed
    walls = [c for c in contours if c.length > 0.3 and c is not arc]
    assert walls
    in_space = [c.points @ plane.axes + plane.offset * plane.normal for c in walls]
    off = np.abs((np.concatenate(in_space) - corner.vertex) @ corner.normals.T).min(axis=1)
    assert np.quantile(off, 0.95) < 0.003
    # Drawn within the noise, a line over walls has few points; without that, one for each triangle.
    assert sum(len(c.points) for c in walls) < 60


def test_files_hold_the_contours(written: Written, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    assert run(written.folder, tmp_path / "s", "--plane", "z=1.4", "--plane", "y=0", "--every", "40cm") == 0
    assert "Contours, mm" in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "s" / "section.csv").read_text(encoding="utf-8").splitlines()))
    planes = {row["plane"] for row in rows}
    assert {"y = 0", "z = 1.4", "z = 1.8"} <= planes
    lines = ezdxf.readfile(tmp_path / "s" / "section.dxf").modelspace().query("LWPOLYLINE")
    assert len(lines) == len(rows)
    for line, row in zip(lines, rows, strict=True):
        points = np.array(line.get_points("xy"))
        points = np.concatenate([points, points[:1]]) if line.closed else points
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        assert length == pytest.approx(float(row["length"]), rel=1e-5)
    svg = (tmp_path / "s" / "section.svg").read_text()
    assert svg.count("<path") == len(rows)


def test_a_length_has_the_sigma_of_its_scale_and_its_ends(written: Written) -> None:
    calibration = written.scan.calibration
    state = State(device_of(calibration.camera), device_of(calibration.projector), calibration.pose.in_baselines)
    exact = Uncertainty(state, np.zeros((SHARED, SHARED)), None, 0.05)
    result = read_cleaned(written.folder)
    assert all(contour.sigma is None for contour in cut(result, ["z=1.8"], None, rig_errors(calibration, None)))
    for scale in (0.0, 0.01):
        for contour in cut(result, ["z=1.8"], None, SystematicErrors.of(calibration, exact, scale)):
            assert contour.sigma is not None
            ends = np.sqrt(max(contour.sigma**2 - (scale * contour.length) ** 2, 0.0))
            assert 1e-4 < ends < 2e-3


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "--plane"),
        (["--plane", "z=90"], "reaches from"),
        (["--plane", "z=1.8", "--every", "1um"], "planes or fewer"),
        (["--plane", "q=1"], "normal and an offset"),
        (["--plane", "0,0,0,1"], "normal and an offset"),
        (["--plane", "z=inf"], "expected a length"),
        (["--plane", "z=1.8", "--capture", "4"], "--capture"),
    ],
)
def test_mistakes_are_named(
    written: Written, tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(written.folder, tmp_path / "s", *options) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


@given(st.lists(st.lists(st.tuples(st.integers(0, 900), st.integers(0, 600)), min_size=1, max_size=6), max_size=12))
def test_numbers_of_contours_do_not_lie_over_each_other(contours: list[list[tuple[int, int]]]) -> None:
    places: list[tuple[float, float]] = []
    for contour in contours:
        places.append(_free_place(np.array(contour, np.float64), places))
    for k, (x, y) in enumerate(places):
        assert all(abs(x - a) >= 19.9 or abs(y - b) >= 13.9 for a, b in places[:k])
