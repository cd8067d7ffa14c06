"""`scan measure` on a synthetic scene: results compared with the truth, and messages on wrong arguments.

Few points in a huge image take the memory of few points.
"""

import json
import tracemalloc
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calib.geometry import Matches
from scanner.io import read_matches, write_matches
from tests.support.cloud_scene import CAMERA, SPHERE_RADIUS_M
from tests.support.command_line import run
from tests.support.result_folder import Written, enlarge, write_result


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("measure") / "room")


# Two pixels on different walls, and what is true of them: the scene's own points.
PIXELS = (120, 150, 300, 160)


@pytest.fixture(scope="module")
def measured(written: Written) -> dict[str, Any]:
    out = written.folder.with_name("measured")
    assert run("measure", written.folder, "--sphere", "300mm", "--distance", *PIXELS, "--out", out, "--quiet") == 0
    assert {path.name for path in out.iterdir()} == {"measure.json", "measure.png"}
    return dict(json.loads((out / "measure.json").read_text()))


def test_the_sphere(written: Written, measured: dict[str, Any]) -> None:
    (sphere,) = measured["spheres"]
    error = sphere["diameter"] - 2 * SPHERE_RADIUS_M
    assert measured["unit"] == "m"
    assert sphere["nominal_diameter"] == 0.3
    assert 1e-7 < abs(error) < 4 * sphere["diameter_sigma"]
    assert 1e-5 < sphere["diameter_sigma"] < 2e-3
    off_centre = np.linalg.norm(np.array(sphere["centre"]) - written.scene.sphere_centre)
    assert 1e-6 < off_centre < 5 * np.linalg.norm(sphere["centre_sigma"]) < 5e-3
    column, row = CAMERA.project(written.scene.sphere_centre)
    assert np.allclose(sphere["image_px"]["centre"], (column, row), atol=0.1)


def test_the_sphere_sigma_follows_from_its_points(written: Written, measured: dict[str, Any]) -> None:
    (sphere,) = measured["spheres"]
    scan = written.scan
    from_centre = np.linalg.norm(scan.points - written.scene.sphere_centre, axis=1)
    true = (from_centre - SPHERE_RADIUS_M)[np.abs(from_centre - SPHERE_RADIUS_M) < 0.02]
    assert 0.8 * len(true) < sphere["points"] <= len(true)
    assert sphere["strays"] < 5
    assert 0.8 < sphere["mean_absolute_error"] / np.mean(np.abs(true)) < 1.2
    assert 1.2 < sphere["rms_error"] / sphere["mean_absolute_error"] < 1.5  # √(π/2) for normal errors
    assert 4 < sphere["form_error"] / sphere["rms_error"] < 8  # 5.9 for normal errors
    nominal = sphere["with_nominal_diameter"]
    assert sphere["points"] == nominal["points"]
    assert 0.99 < nominal["mean_absolute_error"] / sphere["mean_absolute_error"] < 1.1


def test_the_faces_and_their_angles(written: Written, measured: dict[str, Any]) -> None:
    normals = written.scene.corner.normals
    assert [face["name"] for face in measured["faces"]] == ["A", "B", "C"]
    for face, normal in zip(measured["faces"], normals, strict=True):
        assert 1e-5 < np.degrees(np.arccos(min(1.0, abs(np.array(face["normal"]) @ normal)))) < 0.02
        assert face["offset"] == pytest.approx(-abs(normal @ written.scene.corner.vertex), abs=1e-3)
        assert face["points"] > 5_000
        assert 1e-5 < face["mean_absolute_error"] < face["rms_error"] < 2e-3
    assert [angle["faces"] for angle in measured["angles"]] == [["A", "B"], ["A", "C"], ["B", "C"]]
    for angle in measured["angles"]:
        assert 1e-6 < abs(angle["angle_deg"] - 90) < 4 * angle["sigma_deg"]
        assert 1e-5 < angle["sigma_deg"] < 0.02


def test_the_distance(written: Written, measured: dict[str, Any]) -> None:
    (distance,) = measured["distances"]
    scene = written.scene
    ends = [scene.points[np.all(scene.matches.camera_px == at, axis=1)][0] for at in (PIXELS[:2], PIXELS[2:])]
    error = distance["distance"] - np.linalg.norm(ends[1] - ends[0])
    assert distance["between"] == ["pixel (120, 150)", "pixel (300, 160)"]
    assert 1e-6 < abs(error) < 4 * distance["sigma"]
    assert 1e-5 < distance["sigma"] < 3e-3


def test_distances_err_by_their_sigma(written: Written, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scene, chosen = written.scene, rng.permutation(len(written.scene.matches))[:120].reshape(-1, 2)
    arguments: list[object] = []
    for first, second in chosen:
        arguments += ["--distance", *scene.matches.camera_px[first], *scene.matches.camera_px[second]]
    assert run("measure", written.folder, *arguments, "--out", tmp_path / "m", "--quiet") == 0
    found = json.loads((tmp_path / "m/measure.json").read_text())["distances"]
    truth = np.linalg.norm(scene.points[chosen[:, 0]] - scene.points[chosen[:, 1]], axis=1)
    errors = [(one["distance"] - true) / one["sigma"] for one, true in zip(found, truth, strict=True)]
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.3


def test_the_heat_map_is_a_picture_in_colour(written: Written, measured: dict[str, Any]) -> None:
    picture = cv2.imread(str(written.folder.with_name("measured") / "measure.png"))
    assert picture is not None
    assert picture.shape[1] > 2 * 600
    saturation = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)[..., 1]
    for half in np.array_split(saturation, 2, axis=1):
        assert 0.05 < np.mean(half > 40) < 0.9


def test_the_terminal_shows_millimetres(
    written: Written, measured: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("measure", written.folder, "--sphere", "30cm", "--out", tmp_path / "m") == 0
    output = capsys.readouterr().out
    (sphere,) = measured["spheres"]
    shown = next(line for line in output.splitlines() if line.strip().startswith("diameter"))
    assert float(shown.split()[1]) == pytest.approx(1e3 * sphere["diameter"], abs=0.01)
    for words in ("nominal diameter", "300.00 mm", "mean absolute error", "A and B", "squareness_deg", "measure.png"):
        assert words in output


@pytest.mark.parametrize(("unit", "text"), [("mm", "0.3"), ("mm", "0.3mm"), ("baseline", "0.3"), ("mm", "3e-4 m")])
def test_other_units(tmp_path: Path, unit: str, text: str) -> None:
    written = write_result(tmp_path / "room", unit=unit)
    assert run("measure", written.folder, "--sphere", text, "--quiet") == 0
    document = json.loads((tmp_path / "room-measured/measure.json").read_text())
    assert document["unit"] == unit
    assert 1e-7 < abs(document["spheres"][0]["diameter"] - 0.3) < 1e-3


def test_a_sparse_cloud(tmp_path: Path) -> None:
    """One point for about nine pixels, as if the projector's pixels are larger than the camera's."""
    rng = np.random.default_rng(0)
    written = write_result(tmp_path / "room", keep=lambda pixels: rng.random(len(pixels)) < 0.11)
    assert run("measure", written.folder, "--sphere", "300mm", "--quiet") == 0
    (sphere,) = json.loads((tmp_path / "room-measured/measure.json").read_text())["spheres"]
    assert 1e-6 < abs(sphere["diameter"] - 0.3) < 4 * sphere["diameter_sigma"] < 5e-3
    assert 100 < sphere["points"] < 1000


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--sphere", "50.8mn"), 2, ("'mn' is not known", "mm")),
        (("--sphere", "ball"), 2, ("50.8mm", "found 'ball'")),
        (("--sphere", "0mm"), 2, ("found '0mm'",)),
        (("--sphere=-3mm",), 2, ("found '-3mm'",)),
        (("--sphere", "50.8mm"), 4, ("no trustworthy measurement", "50.800 mm", "not the radius")),
        (("--sphere", "200mm"), 4, ("no trustworthy measurement", "Check the diameter")),
        (("--sphere", "3m"), 4, ("no trustworthy measurement",)),
        (("--sphere", "300mm", "--sphere", "300mm"), 4, ("No sphere with a diameter of 300.00 mm",)),
        (("--distance", 0, 0, 120, 150), 2, ("pixel (0, 0) has no point", "the nearest pixel that has one is")),
        (("--distance", 120, 150, 408, 10), 2, ("(408, 10) is outside", "408 × 342")),
        (("--distance", 120, 150, "nan", 10), 2, ("outside",)),
        (("--distance", 120, 150, 120, 150), 2, ("the same",)),
        (("--distance", 120, 150, 120), 2, ("--distance", "4 arguments")),
    ],
)
def test_unmeasurable_requests_are_refused(
    written: Written,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[object, ...],
    code: int,
    words: tuple[str, ...],
) -> None:
    assert run("measure", written.folder, *arguments, "--out", tmp_path / "m") == code
    output = capsys.readouterr()
    assert output.out == ""
    for word in words:
        assert word in output.err
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_measurement_is_replaced_only_on_request(
    written: Written, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for extra, code in ((), 0), ((), 2), (("--overwrite",), 0):
        assert run("measure", written.folder, "--out", tmp_path / "m", *extra) == code
    assert "already exists" in capsys.readouterr().err


def test_millimetres_need_a_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = write_result(tmp_path / "room", unit="baseline")
    assert run("measure", written.folder, "--sphere", "300mm") == 2
    assert "scale.baseline_m" in capsys.readouterr().err


def test_without_faces_a_measurement_must_be_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = write_result(tmp_path / "room")
    matches = read_matches(written.folder)
    write_matches(written.folder / "matches.npz", Matches(matches.camera_px, matches.projector_px))
    assert run("measure", written.folder) == 2
    assert "--sphere 50.8mm" in capsys.readouterr().err
    assert run("measure", written.folder, "--distance", *PIXELS) == 0
    document = json.loads((tmp_path / "room-measured/measure.json").read_text())
    assert document["distances"][0]["sigma"] is None
    assert "measure.png" not in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "room-measured").iterdir()} == {"measure.json"}


def test_a_refused_capture_cannot_be_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = write_result(tmp_path / "room")
    (written.folder / "calibration.yaml").unlink()
    assert run("measure", written.folder) == 2
    assert "report.html" in capsys.readouterr().err


@pytest.mark.parametrize("factor", [1, 30])
def test_a_ball_is_measured_in_an_image_of_126_megapixels(tmp_path: Path, factor: int) -> None:
    written = write_result(tmp_path / "room")
    enlarge(tmp_path / "room", factor)
    tracemalloc.start()
    try:
        assert run("measure", tmp_path / "room", "--sphere", 2 * SPHERE_RADIUS_M, "--quiet") == 0
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    (sphere,) = json.loads((tmp_path / "room-measured" / "measure.json").read_text(encoding="utf-8"))["spheres"]
    assert sphere["diameter"] == pytest.approx(2 * SPHERE_RADIUS_M, abs=1e-3)
    assert sphere["centre"] == pytest.approx(written.scene.sphere_centre, abs=1e-3)
    assert peak < 600_000_000
