"""A calibration is judged by captures of its rig: it holds, or the parameter that changed is named with its amount."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Calibration, Pose, rotation_about
from scanner.checking.calibration_check import check_calibration, config_of
from scanner.commands import main
from scanner.io import write_calibration, write_matches
from scanner.ui import Terminal
from tests.support.things import thing_stations, turned_stations

pytestmark = pytest.mark.xdist_group("calibration check")  # what the module shares is made once


def told(
    tmp_path: Path, rig: tuple[Calibration, list[Path]], change: float = 0.0, turn_deg: float = 0.0
) -> tuple[str, str]:
    """The grade of the true calibration after a change of the projector's focal length or a turn, and why."""
    truth, captures = rig
    width = truth.projector.focal_px[0] * (1 + change)
    turn = rotation_about(np.radians([0.0, turn_deg, 0.0]))
    pose = Pose(turn @ truth.pose.rotation, truth.pose.translation)
    given = replace(truth, projector=replace(truth.projector, focal_px=(width, width)), pose=pose)
    write_calibration(tmp_path / "given.yaml", given)
    config = config_of(tmp_path / "given.yaml")
    check = check_calibration(tmp_path / "given.yaml", captures, config, None, Terminal(quiet=True))
    return check.verdict.grade, check.verdict.reasons[0]


def test_the_true_calibration_holds(tmp_path: Path, rig: tuple[Calibration, list[Path]]) -> None:
    grade, reason = told(tmp_path, rig)
    assert grade == "good"
    assert reason.startswith("The file's focal length of the camera is 0.")


def test_a_zoomed_projector_is_named_with_its_amount(tmp_path: Path, rig: tuple[Calibration, list[Path]]) -> None:
    grade, reason = told(tmp_path, rig, change=0.02)
    assert grade == "refused"
    assert reason.startswith("A change of the projector's focal length by 2 %")


def test_a_turned_device_is_named_with_its_amount(tmp_path: Path, rig: tuple[Calibration, list[Path]]) -> None:
    grade, reason = told(tmp_path, rig, turn_deg=0.5)
    assert grade == "refused"
    assert reason.startswith("A change of the rotation between them by 0.5°")


def test_the_command_ends_with_1_where_it_does_not_hold(
    tmp_path: Path, rig: tuple[Calibration, list[Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    truth, captures = rig
    camera = truth.camera.focal_px[0] * 1.03
    path = tmp_path / "wrong.yaml"
    write_calibration(path, replace(truth, camera=replace(truth.camera, focal_px=(camera, camera))))
    assert main(["check", *map(str, captures), "--calibration", str(path)]) == 1
    shown = capsys.readouterr().out
    assert "✕ The calibration does not hold." in shown
    assert "A change of the camera's focal length by 3" in shown
    assert not list(tmp_path.glob("*check*"))


def test_one_capture_of_anything_tells_whether_rays_meet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    (station,) = turned_stations(1, (306, 256), seed=3)
    truth = station.calibration
    write_matches(tmp_path / "thing.npz", station.matches)
    write_calibration(tmp_path / "true.yaml", truth)
    turn = Pose(rotation_about(np.radians([0.1, 0.0, 0.0])) @ truth.pose.rotation, truth.pose.translation)
    write_calibration(tmp_path / "turned.yaml", replace(truth, pose=turn))
    assert main(["check", str(tmp_path / "thing.npz"), "--calibration", str(tmp_path / "true.yaml")]) == 0
    assert "The calibration holds, as far as rays that meet can tell." in capsys.readouterr().out
    assert main(["check", str(tmp_path / "thing.npz"), "--calibration", str(tmp_path / "turned.yaml")]) == 1
    shown = capsys.readouterr().out
    assert "The calibration does not hold: rays do not meet." in shown
    turned = re.search(r"A change of the rotation between them by ([0-9.]+)°", shown)
    assert turned is not None
    assert 0.095 < float(turned.group(1)) < 0.105


def test_what_good_calibrations_leave_is_told_and_nearly_holds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    (station,) = turned_stations(1, (306, 256), seed=3)
    truth = station.calibration
    write_matches(tmp_path / "thing.npz", station.matches)
    turn = Pose(rotation_about(np.radians([0.01, 0.0, 0.0])) @ truth.pose.rotation, truth.pose.translation)
    write_calibration(tmp_path / "turned.yaml", replace(truth, pose=turn))
    asked = ["check", str(tmp_path / "thing.npz"), "--calibration", str(tmp_path / "turned.yaml")]
    assert main([*asked, "--require", "fair"]) == 0
    shown = capsys.readouterr().out
    assert "The calibration nearly holds: rays miss each other by no more than good calibrations leave." in shown
    turned = re.search(r"A change of the rotation between them by ([0-9.]+)°", shown)
    assert turned is not None
    assert 0.008 < float(turned.group(1)) < 0.012
    assert main([*asked, "--require", "good"]) == 4


def test_a_rig_takes_the_capture_that_checks_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    text = (
        "rig: {backend: simulated, seed: 3, thing: {kind: lump}}\nsequence: {preset: quick}\n"
        "camera: {width: 306, height: 256}\nprojector: {width: 854, height: 480}\n"
    )
    (tmp_path / "rig.yaml").write_text(text)
    (station,) = thing_stations([0], (306, 256), seed=3)
    write_calibration(tmp_path / "true.yaml", station.calibration)
    zoomed = station.calibration.projector.focal_px[0] * 1.01
    projector = replace(station.calibration.projector, focal_px=(zoomed, zoomed))
    write_calibration(tmp_path / "zoomed.yaml", replace(station.calibration, projector=projector))
    arguments = ["check", "--config", str(tmp_path / "rig.yaml"), "--calibration"]
    assert main([*arguments, str(tmp_path / "true.yaml")]) == 0
    assert "as far as rays that meet can tell" in capsys.readouterr().out
    assert main([*arguments, str(tmp_path / "zoomed.yaml")]) == 1
    assert "The calibration does not hold" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["check"], "scan check needs --config FILE, or captures and --calibration FILE"),
        (["check", "--calibration", "rig.yaml"], "scan check CAPTURE… --calibration FILE"),
        (["check", "capture", "--calibration", "rig.yaml", "--write"], "--write and --watch are of a check without"),
        (["check", "capture", "--calibration", "none.yaml"], "none.yaml: cannot be read: no such file"),
        (["check", "none", "--calibration", "rig.yaml"], "none: no such matches file, result or capture"),
    ],
)
def test_what_is_missing_is_said(
    arguments: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("capture").mkdir()
    Path("rig.yaml").touch()
    assert main(arguments) == 2
    assert words in capsys.readouterr().err
