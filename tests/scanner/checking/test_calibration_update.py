"""`scan check --update`: a calibration with its prior, what changed is estimated anew, and nothing is ever lost."""

import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calib.diagnostics import Uncertainty, sigmas_of
from calib.geometry import Calibration, Intrinsics, Pose, rotation_about
from calib.numerics import Floats
from scanner.commands import main
from scanner.io import read_calibration, read_yaml, write_calibration, write_matches
from scanner.results import covariance_entries, log_of, read_log, read_uncertainty
from tests.support.things import thing_stations, true_rig

pytestmark = pytest.mark.xdist_group("calibration update")  # what the module shares is made once

_OF_DEVICE = (2e-3, 2.0, 2.0, 2e-3, 2e-3, 5e-5, 5e-5, 5e-5)
_SIGMA = np.array([*_OF_DEVICE, *_OF_DEVICE, *[5e-4] * 5])


def with_errors(truth: Calibration, seed: int) -> tuple[Calibration, Floats]:
    """A calibration that errs as its covariance says, and that covariance (21, 21)."""
    step = _SIGMA * np.random.default_rng(seed).standard_normal(len(_SIGMA))
    rig = true_rig(truth).moved(step)

    def device(own: Floats, found: Intrinsics) -> Intrinsics:
        focal, x0, y0, k1, k2, p1, p2, k3 = own.tolist()
        terms = k1, k2, p1, p2, k3
        return replace(found, focal_px=(focal, focal), principal_point_px=(x0, y0), distortion=terms)

    pose = Pose(rig.pose.rotation, rig.pose.translation * truth.baseline)
    sigma = sigmas_of(rig, np.diag(_SIGMA**2))
    camera, projector = device(rig.camera, truth.camera), device(rig.projector, truth.projector)
    return replace(truth, camera=camera, projector=projector, pose=pose, sigma=sigma), np.diag(_SIGMA**2)


def write_given(path: Path, calibration: Calibration, covariance: Floats) -> None:
    uncertainty = Uncertainty(true_rig(calibration), covariance, None, 0.05)
    write_calibration(path, calibration, covariance_entries(uncertainty))


def in_sigmas(path: Path, truth: Calibration) -> float:
    """Root mean square over the columns of the error of a file's calibration, in its own sigmas."""
    found = read_calibration(path)
    uncertainty = read_uncertainty(path, found)
    assert uncertainty is not None
    step = uncertainty.rig.step_to(true_rig(truth))
    return float(np.sqrt(step @ np.linalg.solve(uncertainty.covariance, step) / len(step)))


def turned(truth: Calibration, degrees: float) -> Calibration:
    turn = rotation_about(np.radians([degrees, 0.0, 0.0]))
    return replace(truth, pose=Pose(turn @ truth.pose.rotation, truth.pose.translation))


@pytest.fixture(scope="module")
def corner(rig: tuple[Calibration, list[Path]]) -> tuple[Calibration, list[str]]:
    """The true rig, in metres, and matches of three captures of a corner."""
    truth, paths = rig
    return truth.scaled(0.4, "m"), [*map(str, paths)]


@pytest.fixture(scope="module")
def thing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Calibration, list[str]]:
    """The true rig, and matches of one capture of a thing."""
    folder = tmp_path_factory.mktemp("thing")
    (station,) = thing_stations([0], (306, 256), seed=3)
    write_matches(folder / "thing.npz", station.matches)
    return station.calibration, [str(folder / "thing.npz")]


@pytest.mark.parametrize("scene", ["corner", "thing"])
def test_what_holds_is_sharpened_and_both_are_kept(
    scene: str, tmp_path: Path, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, captures = request.getfixturevalue(scene)
    given, covariance = with_errors(truth, 1)
    file = tmp_path / "rig.yaml"
    write_given(file, given, covariance)
    before = file.read_bytes()
    assert main(["check", *captures, "--calibration", str(file), "--update"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "The calibration holds" in shown
    kept = next(tmp_path.glob("rig-until-*.yaml"))
    assert kept.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["rig.yaml", kept.name, "rig.log.yaml"])
    found = read_calibration(file)
    assert found.unit == "m"
    assert found.baseline == pytest.approx(truth.baseline)
    assert 0.3 < in_sigmas(file, truth) < 1.8
    uncertainty = read_uncertainty(file, found)
    assert uncertainty is not None
    ratio = np.linalg.eigvalsh(np.diag(1 / _SIGMA) @ uncertainty.covariance @ np.diag(1 / _SIGMA))
    assert 0 < ratio.min() < 0.1
    assert 0.9 < ratio.max() < 1.1 if scene == "thing" else ratio.max() < 1.1


def test_a_turned_projector_is_estimated_anew(
    tmp_path: Path, thing: tuple[Calibration, list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    truth, captures = thing
    earlier = turned(truth, 0.3)
    given, covariance = with_errors(earlier, 2)
    covariance = 1e-4 * covariance
    given = earlier  # known to a hundredth of the usual sigmas
    write_given(tmp_path / "rig.yaml", given, covariance)
    assert main(["check", *captures, "--calibration", str(tmp_path / "rig.yaml"), "--update"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert re.search(r"A change of the rotation between them by 0\.3° ± 0\.0\d+° explains it", shown)
    off = read_calibration(tmp_path / "rig.yaml").pose @ truth.pose.inverse()
    assert 1e-5 < np.degrees(off.angle) < 0.01
    assert main(["check", *captures, "--calibration", str(tmp_path / "rig.yaml")]) == 0


def test_captures_of_a_corner_replace_what_they_contradict(
    tmp_path: Path, corner: tuple[Calibration, list[str]]
) -> None:
    truth, captures = corner
    zoomed = replace(truth, projector=replace(truth.projector, focal_px=(1.03 * truth.projector.focal_px[0],) * 2))
    write_given(tmp_path / "rig.yaml", zoomed, np.diag(_SIGMA**2) / 100)
    assert main(["check", *captures, "--calibration", str(tmp_path / "rig.yaml"), "--update", "--quiet"]) == 0
    found = read_calibration(tmp_path / "rig.yaml")
    assert 1e-6 < abs(found.projector.focal_px[0] / truth.projector.focal_px[0] - 1) < 4e-3
    assert 1e-7 < abs(found.camera.focal_px[0] / truth.camera.focal_px[0] - 1) < 4e-4  # the prior's own sigma


def test_the_log_lists_all_that_were_in_use(tmp_path: Path, thing: tuple[Calibration, list[str]]) -> None:
    truth, captures = thing
    file = tmp_path / "rig.yaml"
    write_given(file, turned(truth, 0.2), np.diag(_SIGMA**2) / 1e4)
    arguments = ["check", *captures, "--calibration", str(file), "--update", "--quiet"]
    assert main(arguments) == 0
    assert main(arguments) == 0
    first, second, third = read_log(log_of(file))
    assert (first.captures, first.change, first.kept) == ([], "", "")
    assert second.captures == captures
    assert (second.holds, third.holds) == (False, True)
    assert second.change.startswith("A change of the rotation between them by 0.2°")
    assert first.date <= second.date <= third.date < datetime.now(UTC)
    assert read_calibration(tmp_path / second.kept).pose.angle == pytest.approx(turned(truth, 0.2).pose.angle)
    moved = np.subtract(second.values["rotation_deg"], first.values["rotation_deg"])
    assert 0.19 < np.linalg.norm(moved) < 0.21
    assert 0 < max(second.sigmas["rotation_deg"]) < 0.05
    assert len(list(tmp_path.glob("rig-until-*.yaml"))) == 2
    assert read_yaml(file)["updated"]["before"] == third.kept


def test_captures_that_do_not_suffice_change_nothing(
    tmp_path: Path, thing: tuple[Calibration, list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    truth, captures = thing
    wrong = turned(replace(truth, camera=replace(truth.camera, focal_px=(1.1 * truth.camera.focal_px[0],) * 2)), 2.0)
    file = tmp_path / "rig.yaml"
    write_given(file, wrong, np.diag(_SIGMA**2) / 1e4)
    before = file.read_bytes()
    assert main(["check", *captures, "--calibration", str(file), "--update"]) == 4
    assert "three of anything from different sides" in capsys.readouterr().err
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["rig.yaml"]


@pytest.mark.parametrize(
    ("beside", "log", "words"),
    [
        ("matches.npz", "", "belongs to a result, whose cloud was made with it"),
        ("note.txt", "", "states no covariance"),
        ("note.txt", "- {date: yesterday}", "rig.log.yaml: expected a list of calibrations over time"),
    ],
)
def test_files_that_are_not_updated(
    beside: str,
    log: str,
    words: str,
    tmp_path: Path,
    thing: tuple[Calibration, list[str]],
    capsys: pytest.CaptureFixture[str],
) -> None:
    truth, captures = thing
    file = tmp_path / "rig.yaml"
    if log:
        write_given(file, truth, np.diag(_SIGMA**2))
        (tmp_path / "rig.log.yaml").write_text(log)
    else:
        write_calibration(file, truth)
    (tmp_path / beside).write_text("")
    before = file.read_bytes()
    assert main(["check", *captures, "--calibration", str(file), "--update"]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert file.read_bytes() == before
