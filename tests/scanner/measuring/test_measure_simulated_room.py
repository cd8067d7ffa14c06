"""A ball bar in a simulated room, from frames to `measure.json` and `acceptance.json`, against the room's truth."""

import json
from pathlib import Path

import numpy as np
import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated import DrawnRoom, place_room, true_calibration
from scanner.commands import main
from scanner.quantities import Quantity

CAMERA, PROJECTOR = (612, 512), (427, 240)
RADIUS_M, BAR_M = 0.12, 0.4

pytestmark = pytest.mark.xdist_group("measured room")


@pytest.fixture(scope="module")
def room() -> DrawnRoom:
    settings = SimulatedRigSettings(seed=0, sphere_radius_m=RADIUS_M, ball_bar_m=BAR_M)
    return place_room(settings, CAMERA, PROJECTOR)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, room: DrawnRoom) -> Path:
    folder = tmp_path_factory.mktemp("measured")
    config = folder / "room.yaml"
    config.write_text(
        f"rig: {{backend: simulated, seed: 0, sphere_radius_m: {RADIUS_M}, ball_bar_m: {BAR_M}}}\n"
        f"camera: {{width: {CAMERA[0]}, height: {CAMERA[1]}, principal_point: {{known: [314.1, 263.6]}}}}\n"
        f"projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}\n"
        "corner: {squareness_deg: 0}\n"
        f"scale: {{baseline_m: {true_calibration(room).baseline}, sigma_m: 1.0e-4}}\n"
    )
    assert main(["--config", str(config), "--out", str(folder / "room"), "--quiet"]) == 0
    return folder / "room"


def test_the_ball_of_a_simulated_room(result: Path, room: DrawnRoom, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", str(result), "--sphere", "240mm", "--shares"]) == 0
    assert "1000 mm in the middle of this scene are known to ± " in capsys.readouterr().out
    document = json.loads((result.with_name("room-measured") / "measure.json").read_text())
    (sphere,) = document["spheres"]
    eye = room.camera
    centres = [eye.rotation @ (ball.centre - eye.centre) for ball in room.scene.spheres.values()]
    assert 1e-6 < abs(sphere["diameter"] - 2 * RADIUS_M) < 3 * sphere["diameter_sigma"] < 5e-3
    assert 1e-6 < min(np.linalg.norm(np.array(sphere["centre"]) - centre) for centre in centres) < 0.01
    assert 1e-5 < sphere["mean_absolute_error"] < 1e-3
    for angle in document["angles"]:
        assert 1e-6 < abs(angle["angle_deg"] - 90) < 4 * angle["sigma_deg"] < 0.3
    assert 1e-5 < document["known_lengths"]["relative_sigma"] < 5e-3
    assert document["known_lengths"]["relative_shares"]["scale"] == pytest.approx(
        1e-4 / true_calibration(room).baseline, rel=1e-3
    )


def test_the_report_shows_the_same_values(result: Path) -> None:
    document = json.loads((result.with_name("room-measured") / "measure.json").read_text())
    page = (result / "report.html").read_text().replace("\N{NO-BREAK SPACE}", " ")
    assert document["known_lengths"]["sentence"] in page
    assert document["known_lengths"]["sentence"] in (result / "calibration.yaml").read_text()
    for angle in document["angles"]:
        shown = Quantity("", angle["angle_deg"], "°", angle["sigma_deg"])
        assert f"{shown.shown(angle['angle_deg'])}° ± {shown.shown(angle['sigma_deg'])}°" in page


def test_acceptance_with_a_ball_bar(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["accept", str(result), "--ball-bar", "240mm,0.24,40cm"]) == 0
    output = capsys.readouterr().out
    assert "Sphere-spacing error" in output
    assert "sphere-spacing error 1 of 7" in output
    out = result.with_name("room-accepted")
    errors = json.loads((out / "acceptance.json").read_text())["errors"]
    assert [error["quantity"] for error in errors] == ["PF", "PS", "PF", "PS", "SD", "F", "F", "F"]
    for error in errors:
        budget = error["budget"]
        if budget is None:
            assert 1e-5 < error["dispersion"] < error["value"] < 2e-2
        else:
            assert 1e-7 < abs(error["value"]) < 3 * np.linalg.norm(list(budget.values())) < 1e-2
    assert "Acceptance test with a ball bar" in (out / "acceptance.html").read_text()


@pytest.mark.parametrize("ball_bar", ["240mm,240mm", "240mm,240mm,100mm", "240mm,240mn,400mm"])
def test_wrong_ball_bars_are_refused(result: Path, ball_bar: str, tmp_path: Path) -> None:
    assert main(["accept", str(result), "--ball-bar", ball_bar, "--out", str(tmp_path / "out")]) == 2
    assert list(tmp_path.iterdir()) == []
