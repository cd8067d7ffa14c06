"""Lens priors from a configuration."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Calibration, DeviceSigmas, Pose, Sigmas, Size
from calib.refinement import ORDINARY_LENSES
from calib.self_calibration import PrincipalPoint
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR
from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.io import write_calibration
from scanner.reconstruction import lenses_of

CAMERA, PROJECTOR = PAPER_CAMERA.size, PAPER_PROJECTOR.size
TERMS, SIGMAS = (-0.05, 0.01, 1e-4, -2e-4, 0.002), (1e-3, 2e-3, 1e-5, 2e-5, 0.0)


def calibrated(path: Path) -> Path:
    known = DeviceSigmas(None, None, SIGMAS)
    camera = replace(PAPER_CAMERA, distortion=TERMS)
    sigma = Sigmas(camera=known)
    write_calibration(path, Calibration(camera, PAPER_PROJECTOR, Pose(np.eye(3), np.array([1.0, 0, 0])), sigma=sigma))
    return path


def test_ordinary_lenses_are_the_default() -> None:
    assert lenses_of(Config(), CAMERA, PROJECTOR) == ORDINARY_LENSES


@pytest.mark.parametrize("decentering", [0.0, 0.0003, 0.002])
def test_decentering_applies_to_both_devices(decentering: float) -> None:
    config = load_config(None, [f"lens.decentering={decentering}", "lens.k3=0.5"])
    for lens, ordinary in zip(lenses_of(config, CAMERA, PROJECTOR), ORDINARY_LENSES, strict=True):
        assert lens.mean == (0.0,) * 5
        assert lens.sigma == (*ordinary.sigma[:2], decentering, decentering, 0.5)


def test_ideal_lenses_have_no_terms() -> None:
    config = load_config(None, ["lens={radial: 0, decentering: 0, k3: 0}"])
    for lens in lenses_of(config, CAMERA, PROJECTOR):
        assert lens.mean == lens.sigma == (0.0,) * 5
        assert not lens.bends


def test_a_principal_point_is_the_projectors_alone() -> None:
    config = load_config(None, ["projector.principal_point.known=[400, 470]"])
    camera, projector = lenses_of(config, CAMERA, PROJECTOR)
    assert camera == ORDINARY_LENSES[0]
    assert projector.point == PrincipalPoint((400.0, 470.0), 0.0)


def test_a_calibration_with_sigmas_gives_the_lens_priors(tmp_path: Path) -> None:
    calibrated(tmp_path / "calibration.yaml")
    (tmp_path / "room.yaml").write_text("lens: {from: calibration.yaml}\n", encoding="utf-8")
    config = load_config(tmp_path / "room.yaml")
    camera, projector = lenses_of(config, CAMERA, PROJECTOR)
    assert camera.mean == pytest.approx(TERMS)
    assert camera.sigma[:4] == pytest.approx(SIGMAS[:4])
    assert 0 < camera.sigma[4] < 1e-5
    assert projector == ORDINARY_LENSES[1]
    assert config.recorded["lens"] == {"from": str(tmp_path / "calibration.yaml")}


def test_a_calibration_of_other_devices_is_refused(tmp_path: Path) -> None:
    config = load_config(None, [f"lens={{from: {calibrated(tmp_path / 'other.yaml')}}}"])
    with pytest.raises(InputError, match=r"lens\.from: .*other\.yaml states no distortion .* a camera of 640 × 480"):
        lenses_of(config, Size(640, 480), PROJECTOR)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("lens.decentering=-1", "lens.decentering"),
        ("lens={decentering: 0.1, from: a.yaml}", "not both"),
        ("lens.decentring=0.1", "decentering"),
    ],
)
def test_impossible_settings_are_named(setting: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_config(None, [setting])
