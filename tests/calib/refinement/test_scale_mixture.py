"""Priors of unknown scale: the shares and the evidence of populations, and what they make of sigmas."""

from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import Calibration, Intrinsics, Pose
from calib.refinement import (
    CAMERA,
    PROJECTOR,
    SQUARENESS_DEG,
    TANGENTIAL,
    CornerFit,
    Knowledge,
    LensPrior,
    PrincipalPoint,
)
from calib.refinement.scale_mixture import mix_scales, weigh
from calib.self_calibration import SelfCalibration, self_calibrate
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture
from tests.calib.refinement.conftest import Case

LENSES = (1e-4, 0.5), (1e-3, 0.5)
COLUMNS = np.concatenate([device.start + np.array(TANGENTIAL) for device in (CAMERA, PROJECTOR)])
CENTRE = PrincipalPoint(((PAPER_CAMERA.width - 1) / 2, (PAPER_CAMERA.height - 1) / 2), 70.0)


def _knowledge() -> Knowledge:
    lens = LensPrior(decenterings=LENSES)
    return Knowledge(
        PAPER_CAMERA.size, PAPER_PROJECTOR.size, PAPER_CAMERA.principal_point_px, 0.0, 0.0, lenses=(lens, lens)
    )


@pytest.mark.parametrize("difference", [0.0, 2e-4, 3e-3])
def test_scales_are_those_of_the_mixture(case: Case, difference: float) -> None:
    """Matches that tell the difference of both lenses alone: against the densities of that difference."""
    prior = _knowledge().prior(case.truth)
    sigma_of_data = 2e-5
    values = case.truth.additive()
    of_prior, slope, curvature = prior.misfit(values)
    contrast = np.zeros((2, case.truth.size))
    contrast[:, COLUMNS[:2]], contrast[:, COLUMNS[2:]] = np.eye(2), -np.eye(2)
    told = np.array([difference, -difference])
    apart = contrast @ values - told
    fit = CornerFit(
        float(of_prior.sum() + apart @ apart / sigma_of_data**2),
        slope + contrast.T @ apart / sigma_of_data**2,
        np.diag(np.where(curvature > 0, curvature, 1.0)) + contrast.T @ contrast / sigma_of_data**2,
        case.truth,
        (),
    )
    sigma = mix_scales(fit, prior)
    pairs = [(a, b) for a, _ in LENSES for b, _ in LENSES]
    variance = np.array([a**2 + b**2 + sigma_of_data**2 for a, b in pairs])
    evidence = np.exp(-(told @ told) / variance / 2) / variance
    share = evidence / evidence.sum()
    expected = np.sqrt([share @ [pair[lens] ** 2 for pair in pairs] for lens in (0, 1)])
    np.testing.assert_allclose(sigma, np.repeat(expected, 2), rtol=1e-6)


def test_what_is_said_of_lenses_and_walls_is_of_no_population(case: Case) -> None:
    said = replace(_knowledge(), lenses=(LensPrior().with_sigmas(decentering=3e-4),) * 2, squareness_deg=SQUARENESS_DEG)
    prior = said.prior(case.truth)
    assert prior.populations == ()
    weighed = weigh(case.problem.under(prior), case.best.state)
    assert weighed.problem.prior is prior
    assert weighed.cost == weighed.fit.cost
    unsaid = replace(said, lenses=(LensPrior(), LensPrior())).with_squareness(None).prior(case.truth)
    assert [len(population.columns) for population in unsaid.populations] == [2, 2, 3]


def _calibrated(p1: float, decentering: float | None) -> SelfCalibration:
    """From one capture of a square corner, nothing said of the principal point."""
    rotation = np.array([[np.cos(0.15), 0.0, np.sin(0.15)], [0.0, 1.0, 0.0], [-np.sin(0.15), 0.0, np.cos(0.15)]])
    devices = [
        replace(device, distortion=(-0.02, 0.0, sign * p1, sign * p1, 0.0))
        for device, sign in ((PAPER_CAMERA, 1), (PAPER_PROJECTOR, -1))
    ]
    capture = random_capture(
        np.random.default_rng(3),
        count=20_000,
        distance=(1.5, 2.5),
        camera=devices[0],
        projector=devices[1],
        rig=_rig(devices[0], devices[1], rotation),
    )
    return self_calibrate(
        capture.matches,
        PAPER_CAMERA.size,
        PAPER_PROJECTOR.size,
        principal_point=CENTRE,
        squareness_deg=0.0,
        decentering=decentering,
    )


def _rig(camera: Intrinsics, projector: Intrinsics, rotation: np.ndarray) -> Calibration:
    return Calibration(camera, projector, Pose(rotation, -rotation @ [0.4, 0.0, 0.0]), unit="m")


def _decentering_sigma(calibrated: SelfCalibration) -> float:
    sigma = calibrated.calibration.sigma
    assert sigma is not None
    assert sigma.camera.distortion is not None
    return float(np.mean(sigma.camera.distortion[2:4]))


def test_lenses_that_differ_have_wide_sigmas_and_those_that_agree_narrow_ones() -> None:
    told, centred, decentred = (
        _decentering_sigma(_calibrated(*given)) for given in ((0.0, 3e-4), (0.0, None), (0.001, None))
    )
    assert 0.5 < centred / told < 1.1
    assert 2 < decentred / centred < 10
