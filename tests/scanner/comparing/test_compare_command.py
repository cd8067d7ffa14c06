"""`scan compare`, and boards and captures calibrated together, from files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from scanner.commands import main
from scanner.io import read_calibration, write_calibration, write_matches
from scanner.results import covariance_entries, read_uncertainty
from tests.support.known_rigs import Before, before, intrinsics_and_length, sigmas

pytestmark = pytest.mark.xdist_group("comparing")  # what the module shares is made once


@pytest.fixture(scope="module")
def case() -> Before:
    return before(1)


@pytest.fixture
def folder(case: Before, tmp_path: Path) -> Path:
    """A configuration, a result of boards, a capture, and the truth."""
    camera, projector = case.truth.camera, case.truth.projector
    settings = {
        "camera": {"width": camera.width, "height": camera.height},
        "projector": {"width": projector.width, "height": projector.height},
    }
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(settings))
    (tmp_path / "boards").mkdir()
    written = tmp_path / "boards" / "calibration.yaml"
    write_calibration(written, case.known.calibration, covariance_entries(case.known.uncertainty))
    write_matches(tmp_path / "matches.npz", case.corner)
    write_calibration(tmp_path / "truth.yaml", case.truth)
    return tmp_path


def test_a_covariance_reads_back_with_the_scale_correlations(case: Before, folder: Path) -> None:
    file = folder / "boards" / "calibration.yaml"
    read = read_uncertainty(file, read_calibration(file))
    told = case.known.uncertainty
    assert np.abs(told.with_log_baseline).max() > 0
    assert np.allclose(read.covariance, told.covariance, rtol=1e-9, atol=1e-18)
    assert np.allclose(read.with_log_baseline, told.with_log_baseline, rtol=1e-9, atol=1e-18)


def test_boards_and_a_capture_are_calibrated_together(case: Before, folder: Path) -> None:
    out = folder / "joint"
    given = [str(folder / "matches.npz"), str(folder / "boards"), "--config", str(folder / "rig.yaml")]
    assert main(["calibrate", *given, "--out", str(out), "--quiet"]) == 0
    joint = read_calibration(out / "calibration.yaml")
    assert joint.unit == "m"
    errors = (intrinsics_and_length(joint) - intrinsics_and_length(case.truth)) / sigmas(joint)
    assert 0.05 < np.sqrt(np.mean(errors**2)) < 2.5
    assert np.all(sigmas(joint) < 1.02 * sigmas(case.known.calibration))
    assert np.any(read_uncertainty(out / "calibration.yaml", joint).with_log_baseline)
    assert "boards of the same rig. Captures and boards agree" in (out / "report.html").read_text(encoding="utf-8")
    # In a configuration boards are an earlier result.
    again = [str(folder / "matches.npz"), "--config", str(folder / "rig.yaml"), "--set", "method=paper"]
    assert main(["calibrate", *again, str(folder / "boards"), "--out", str(folder / "paper")]) == 2


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("boards", "expected captures of a corner to join with"),
        ("matches.npz boards boards", "at most one calibration"),
        ("matches.npz truth.yaml", "has no covariance"),
        ("matches.npz boards --set scale.baseline_m=0.2", "leave out 'scale'"),
        ("matches.npz boards --set camera.width=640", "expected: what is calibrated together comes from one"),
    ],
)
def test_sources_that_cannot_be_joined_are_refused(
    given: str, told: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert main(["calibrate", *given.split(), "--config", "rig.yaml", "--out", "out"]) == 2
    assert told in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_covariance_beyond_any_lens_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], sign: int
) -> None:
    entry = yaml.safe_load((folder / "boards" / "calibration.yaml").read_text(encoding="utf-8"))
    columns = entry["covariance"]["columns"]
    step = [sign * 1000.0 if column == "camera_p1" else 0.0 for column in columns]
    entry["covariance"]["along"] = {"probability": [1e-9], "steps": [step]}
    other = tmp_path / "calibration.yaml"
    other.write_text(yaml.safe_dump(entry), encoding="utf-8")
    assert main(["compare", str(folder / "boards"), str(other)]) == 2
    assert "a covariance reaches lenses that have no ray for some pixels" in " ".join(capsys.readouterr().err.split())


def test_two_calibrations_are_compared(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "compared"
    assert main(["compare", str(folder / "boards"), str(folder / "truth.yaml"), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "✓ The calibrations agree" in told
    assert "truth.yaml has no covariance" in " ".join(told.split())
    document = json.loads((out / "compare.json").read_text(encoding="utf-8"))
    assert document["agree"] is True
    assert document["unit"] == "m"
    assert 0 < document["chi2"] < document["limit"]
    assert len(document["depths"]) == 3
    page = (out / "compare.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 9
    assert 'section class="verdict good"' in page
    assert document["verdict"] in page.replace("&#39;", "'")
    assert main(["compare", str(folder / "boards"), str(folder / "truth.yaml"), "--out", str(out)]) == 2


def test_a_difference_is_reported_with_its_location(
    case: Before, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    focal = 1.01 * case.truth.projector.focal_px[0]
    zoomed = replace(case.truth, projector=replace(case.truth.projector, focal_px=(focal, focal)))
    write_calibration(folder / "zoomed.yaml", zoomed)
    assert main(["compare", str(folder / "boards"), str(folder / "zoomed.yaml"), "--depths", "0.9m,100cm"]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert "✕ The calibrations differ by more than their standard deviations allow" in told
    assert main(["compare", str(folder / "boards"), str(folder / "zoomed.yaml"), "--allow", "--quiet"]) == 0
    assert main(["compare", str(folder / "boards"), str(folder / "boards")]) == 0
    assert "✓ The calibrations are the same." in capsys.readouterr().out
    assert "at camera pixel" in told
    free = zoomed.in_baselines
    write_calibration(folder / "free.yaml", free)
    assert main(["compare", str(folder / "free.yaml"), str(folder / "boards"), "--allow"]) == 0
    assert "They share no known length" in " ".join(capsys.readouterr().out.split())
    assert main(["compare", str(folder / "free.yaml"), str(folder / "truth.yaml")]) == 0
    assert "neither states a covariance" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("boards nowhere.yaml", "no such file"),
        ("boards truth.yaml --depths 1ell", "ell"),
        ("boards truth.yaml --depths ,", "--depths: expected lengths"),
        ("boards truth.yaml --depths 1um", "next to nothing in common"),
        ("boards other.yaml", "these are two rigs"),
    ],
)
def test_calibrations_that_cannot_be_compared_are_refused(
    arguments: str,
    told: str,
    case: Before,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    write_calibration(folder / "other.yaml", replace(case.truth, camera=replace(case.truth.camera, width=640)))
    assert main(["compare", *arguments.split()]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("column", [*range(5), *range(7, 13), *range(15, 22)])
@pytest.mark.parametrize("value", [3.0, 1000.0])
def test_steps_along_that_reach_far_are_compared_or_refused(
    case: Before, folder: Path, column: int, value: float, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = covariance_entries(case.known.uncertainty)
    steps = [0.0] * 22
    steps[column] = value
    entries["covariance"]["along"] = {"probability": [0.5, 0.5], "steps": [steps, [-step for step in steps]]}
    write_calibration(folder / "far.yaml", case.known.calibration, entries)
    code = main(["compare", str(folder / "boards"), str(folder / "far.yaml"), "--out", str(folder / "out")])
    screen = capsys.readouterr()
    assert code in (0, 2)
    assert "nan" not in screen.out
    if code == 2:
        assert "beyond any device" in screen.err or "expected standard deviations that a rig can have" in screen.err
