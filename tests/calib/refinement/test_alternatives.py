"""A parameter more: its evidence and covariance are those of an exact integration. A picture that the projector scales
in one direction, in front of corners that are nearly square, is such a one.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from calib.refinement import alternative, averaged
from calib.refinement.alternatives import LargerModel
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, SelfCalibration, self_calibrate_jointly
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_captures
from tests.support.findings import kinds_of

PROBABILITY, SPREAD, SIGMA = 0.01, 0.02, 0.1


@given(st.integers(0, 2**32 - 1), st.floats(-0.06, 0.06))
def test_odds_and_moments_of_a_linear_model_are_exact(seed: int, slope: float) -> None:
    """y = a + b t + noise, with b = 0 or b normal with sigma `SPREAD`."""
    rng = np.random.default_rng(seed)
    design = np.stack([np.ones(40), rng.uniform(0, 2, 40)], axis=1)
    seen = design @ [1.0, slope] + SIGMA * rng.normal(size=40)

    def least(b: float) -> float:
        """χ² at the likeliest a."""
        rest = seen - b * design[:, 1]
        return float(np.sum((rest - rest.mean()) ** 2) / SIGMA**2)

    off = (design[:, 0] * seen.mean() - seen) / SIGMA**2
    information = design.T @ design / SIGMA**2 + np.diag([0.0, SPREAD**-2])
    found = alternative(information, design.T @ off, np.array([True, False]), 1, PROBABILITY, SPREAD)

    def density(b: float) -> float:
        return float(np.exp((least(0.0) - least(b)) / 2 - (b / SPREAD) ** 2 / 2) / (np.sqrt(2 * np.pi) * SPREAD))

    evidence, mean, square = (quad(lambda b, n=n: b**n * density(b), -0.3, 0.3, limit=200)[0] for n in range(3))
    np.testing.assert_allclose(found.odds, PROBABILITY * evidence, rtol=1e-6)
    np.testing.assert_allclose(found.value, mean / evidence, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.value**2 + found.sigma**2, square / evidence, rtol=1e-6)
    # A slope of b moves the mean by −b times the mean of t.
    of_mean = found.added(0.5)[0, 0]
    np.testing.assert_allclose(of_mean, 0.5 * square / evidence * design[:, 1].mean() ** 2, rtol=1e-6)


@given(st.integers(0, 2**32 - 1), st.lists(st.floats(0.0, 1.0), max_size=4))
def test_averaged_sigmas_hold_what_their_intervals_promise(seed: int, odds: list[float]) -> None:
    """Against draws from the mixture."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3))
    models = [LargerModel(float(rng.normal()), float(rng.uniform(0.1, 2)), each, rng.normal(size=3)) for each in odds]
    covariance = averaged(root @ root.T, models)
    sigma = np.sqrt(covariance.diagonal())

    shares = np.array([1.0, *odds]) / (1 + sum(odds))
    drawn = rng.choice(len(shares), 40_000, p=shares)
    values = rng.normal(size=(len(drawn), 3)) @ root.T
    for number, model in enumerate(models, start=1):
        chosen = drawn == number
        parameter = rng.normal(model.value, model.sigma, np.count_nonzero(chosen))
        values[chosen] += parameter[:, None] * model.response
    within_one, within_two = (np.mean(np.abs(values) < times * sigma, axis=0) for times in (1, 2))
    assert (within_one > 0.67).all()
    assert (within_two > 0.95).all()
    assert (np.minimum(within_one - 0.6827, within_two - 0.9545) < 0.01).all()
    assert np.linalg.eigvalsh(covariance).min() > -1e-9 * covariance.trace()


def test_an_improbable_model_does_not_widen_sigmas() -> None:
    unlikely = LargerModel(0.0, 100.0, 0.02, np.ones(2))
    sigma = np.sqrt(averaged(np.eye(2), [unlikely]).diagonal())
    assert (sigma > 1.0).all()
    assert (sigma < 1.2).all()
    assert np.sqrt((np.eye(2) + unlikely.added(0.02)).diagonal()).min() > 10


SIZES = (PAPER_CAMERA.width, PAPER_CAMERA.height), (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
CENTRE = PrincipalPoint(((SIZES[0][0] - 1) / 2, (SIZES[0][1] - 1) / 2), 70.0)


def calibrated(seed: int, scale: float) -> SelfCalibration:
    """From two captures of a corner, the picture scaled along x about its middle."""
    captures = random_captures(np.random.default_rng([7, seed]), 2, count=5000, walls_off_deg=0.3)
    middle = np.array([(SIZES[1][0] - 1) / 2, 0.0])
    scaled = [
        replace(capture.matches, projector_px=(capture.matches.projector_px - middle) * (scale, 1.0) + middle)
        for capture in captures
    ]
    return self_calibrate_jointly(scaled, *SIZES, principal_point=CENTRE)[0]


def deviation(found: SelfCalibration) -> float:
    """Of the camera's focal length, in sigmas."""
    sigma = found.calibration.sigma
    assert sigma is not None
    return float(abs(found.calibration.camera.focal_px[0] - PAPER_CAMERA.focal_px[0]) / sigma.camera.focal_px[0])


@pytest.mark.parametrize(("seed", "scale"), [(0, 1.02), (9, 1.03)])
def test_sigmas_include_a_picture_scale_that_explains_oblique_walls(seed: int, scale: float) -> None:
    square, scaled = calibrated(seed, 1.0), calibrated(seed, scale)
    assert "picture-scaled" not in kinds_of(square.findings)
    assert "picture-scaled" in kinds_of(scaled.findings)
    sigmas = [each.calibration.sigma.camera.focal_px[0] for each in (square, scaled) if each.calibration.sigma]
    assert 3 < sigmas[1] / sigmas[0] < 50
    assert deviation(square) < 2
    assert deviation(scaled) < 2


def test_a_refusal_of_faces_that_are_not_square_names_the_scale() -> None:
    with pytest.raises(RefusalError, match=r"not square to each other.*may be scaled in one direction \(by \+2"):
        calibrated(2, 1.03)
