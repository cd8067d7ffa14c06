"""Both methods on known corners; undeterminable calibrations are refused."""

from dataclasses import replace

import numpy as np
import pytest

from calib.closed_form import exact_search, objective_for, search
from calib.geometry import Matches
from calib.refinement import ORDINARY_LENSES, LensPrior, PrincipalPoint
from calib.refusal import RefusalError
from calib.self_calibration import Method, SelfCalibration, self_calibrate
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, SyntheticCapture, random_capture
from tests.support.findings import kinds_of

KNOWN = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)
LENSES = {
    "camera": replace(PAPER_CAMERA, distortion=(-0.02, 0.0, 0.0, 0.0, 0.0)),
    "projector": replace(PAPER_PROJECTOR, distortion=(-0.01, 0.0, 0.0, 0.0, 0.0)),
}


def _calibrate(
    capture: SyntheticCapture, method: Method, squareness_deg: float = 0.0, decentering: float | None = None
) -> SelfCalibration:
    return self_calibrate(
        capture.matches,
        (PAPER_CAMERA.width, PAPER_CAMERA.height),
        (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height),
        principal_point=KNOWN,
        method=method,
        squareness_deg=squareness_deg,
        decentering=decentering,
    )


def _errors(found: SelfCalibration) -> np.ndarray:
    """Relative errors of f_c, f_p, x_p, y_p."""
    calibration = found.calibration
    values = [calibration.camera.focal_px[0], calibration.projector.focal_px[0]]
    values += calibration.projector.principal_point_px
    truth = [PAPER_CAMERA.focal_px[0], PAPER_PROJECTOR.focal_px[0], *PAPER_PROJECTOR.principal_point_px]
    return np.array(values) / np.array(truth) - 1


def test_paper_on_exact_matches_is_exact() -> None:
    rng = np.random.default_rng(0)
    for _ in range(4):
        capture = random_capture(rng, count=5000, noise_px=0.0, distance=(1.5, 3.0))
        assert np.abs(_errors(_calibrate(capture, "paper"))).max() < 1e-4


def test_paper_with_noise_errs_as_the_paper_does() -> None:
    rng = np.random.default_rng(0)
    captures = [random_capture(rng, distance=(1.5, 3.0)) for _ in range(8)]
    errors = [np.abs(_errors(_calibrate(capture, "paper"))).mean() for capture in captures]
    # Far from the Cramér–Rao bound of about 0.1 %, and of the order of the 4.3 % that the paper reports.
    assert 0.001 < np.median(errors) < 0.043


def test_bounded_search_ends_below_the_exact_search() -> None:
    capture = random_capture(np.random.default_rng(2), count=20_000)
    objective = objective_for(capture.matches, PAPER_CAMERA.principal_point_px)
    focal_px = np.arange(1000.0, 3000.0, 1.0)
    solution = search(objective, focal_px)
    assert solution is not None
    refined = float(exact_search(objective, np.array([solution.best_focal_px]))[0])
    assert 0 < refined <= solution.objective.min()
    assert abs(solution.best_focal_px - focal_px[np.argmin(solution.objective)]) <= 1.0


def test_every_term_of_the_objective_vanishes_only_at_the_truth() -> None:
    """E_pro and E_cycle each determine the focal length, as in the paper's second table."""
    capture = random_capture(np.random.default_rng(2), count=5_000, noise_px=0.0)
    objective = objective_for(capture.matches, PAPER_CAMERA.principal_point_px)
    focal_px = PAPER_CAMERA.focal_px[0] * np.array([0.8, 0.95, 1.0, 1.05, 1.25])
    forward, in_front = objective.forward(focal_px)
    terms = objective.terms(focal_px, forward)
    for some in (terms[:2], terms[2:]):
        total = np.where(in_front, some.sum(axis=0), np.inf).reshape(2, -1).min(axis=0)
        assert total[2] < 1e-3
        assert np.all(np.delete(total, 2) > 0.5)


def test_refined_reaches_its_own_sigma_with_lens_distortion() -> None:
    rng = np.random.default_rng(5)
    deviations, errors = [], []
    for _ in range(5):
        capture = random_capture(rng, **LENSES, distance=(1.5, 3.0))  # type: ignore[arg-type]
        found = _calibrate(capture, "refined")
        sigma = found.calibration.sigma
        error = _errors(found)
        errors.append(np.abs(error).mean())
        deviations.append(error[0] * PAPER_CAMERA.focal_px[0] / sigma.camera.focal_px[0])
    assert 1e-5 < np.mean(errors) < 0.008  # one of the views determines the lenses poorly, and says so
    assert 0.3 < np.sqrt(np.mean(np.square(deviations))) < 2.0


IDEAL = LensPrior().with_sigmas(decentering=0.0, k3=0.0, radial=0.0)


def test_what_is_said_of_lenses_and_projector_is_used() -> None:
    """With ideal lenses and both principal points, as COLMAP's two views have them."""
    told = IDEAL, replace(IDEAL, point=PrincipalPoint(PAPER_PROJECTOR.principal_point_px, 0.0))
    errors: dict[str, list[float]] = {"told": [], "untold": []}
    deviations, gains = [], []
    rng = np.random.default_rng(5)
    for _ in range(5):
        capture = random_capture(rng, count=20_000, distance=(1.5, 3.0))
        untold, found = (
            self_calibrate(
                capture.matches,
                PAPER_CAMERA.size,
                PAPER_PROJECTOR.size,
                principal_point=KNOWN,
                squareness_deg=0.0,
                lenses=lenses,
            )
            for lenses in (ORDINARY_LENSES, told)
        )
        calibration, sigma = found.calibration, found.calibration.sigma
        assert calibration.projector.principal_point_px == PAPER_PROJECTOR.principal_point_px
        assert calibration.camera.distortion == calibration.projector.distortion == (0.0,) * 5
        assert sigma.projector.principal_point_px == (0.0, 0.0)
        for name, solution in (("told", found), ("untold", untold)):
            errors[name].append(float(np.abs(_errors(solution)[:2]).mean()))
        deviations += list(_errors(found)[:2] / _focal_sigmas(found))
        gains.append(_focal_sigmas(untold) / _focal_sigmas(found))
    assert 1e-6 < np.mean(errors["told"]) < 3e-4
    assert np.mean(errors["told"]) < np.mean(errors["untold"]) / 3
    assert 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.6
    assert 2 < np.median(gains) < 1000


def _focal_sigmas(found: SelfCalibration) -> np.ndarray:
    """Relative, of both focal lengths."""
    sigma, calibration = found.calibration.sigma, found.calibration
    stated = sigma.camera.focal_px[0], sigma.projector.focal_px[0]
    return np.array(stated) / (calibration.camera.focal_px[0], calibration.projector.focal_px[0])


def test_a_projectors_principal_point_is_weighed_by_its_sigma() -> None:
    capture = random_capture(np.random.default_rng(5), count=20_000, distance=(1.5, 3.0))
    x, y = PAPER_PROJECTOR.principal_point_px

    def solve(sigma_px: float) -> SelfCalibration:
        return self_calibrate(
            capture.matches,
            PAPER_CAMERA.size,
            PAPER_PROJECTOR.size,
            principal_point=KNOWN,
            squareness_deg=0.0,
            lenses=(IDEAL, replace(IDEAL, point=PrincipalPoint((x + 5, y), sigma_px))),
        )

    found = solve(5.0).calibration
    sigma = found.sigma.projector.principal_point_px
    assert sigma is not None
    assert 0.01 < sigma[0] < 5
    assert abs(found.projector.principal_point_px[0] - x) < 3 * sigma[0]
    with pytest.raises(RefusalError, match=r"Verify the projector's principal point, too: \(382, 234\) was given"):
        solve(0.0)


def test_walls_off_square_stay_within_the_sigma() -> None:
    rng = np.random.default_rng(8)
    deviations = []
    for _ in range(3):
        capture = random_capture(rng, **LENSES, walls_off_deg=0.3, distance=(1.5, 2.5))  # type: ignore[arg-type]
        found = _calibrate(capture, "refined", squareness_deg=0.3, decentering=0.0)
        sigma = found.calibration.sigma.camera.focal_px[0]
        assert 0.002 < sigma / PAPER_CAMERA.focal_px[0] < 0.2
        deviations.append(_errors(found)[0] * PAPER_CAMERA.focal_px[0] / sigma)
    assert 0.05 < np.sqrt(np.mean(np.square(deviations))) < 2.0


def test_walls_farther_off_square_than_assumed_stay_within_a_wider_sigma() -> None:
    rng = np.random.default_rng(8)
    deviations, warned = [], 0
    for _ in range(5):
        capture = random_capture(rng, **LENSES, walls_off_deg=0.8, distance=(1.5, 2.5))  # type: ignore[arg-type]
        found = _calibrate(capture, "refined", squareness_deg=0.3, decentering=0.0)
        sigma = found.calibration.sigma.camera.focal_px[0]
        deviations.append(_errors(found)[0] * PAPER_CAMERA.focal_px[0] / sigma)
        warned += "far-from-square" in kinds_of(found.findings)
    assert 0.05 < np.sqrt(np.mean(np.square(deviations))) < 2.0
    assert 1 <= warned <= 5


@pytest.mark.parametrize("method", ["paper", "refined"])
def test_legs_leave_the_vertex_along_the_faces(method: Method) -> None:
    capture = random_capture(np.random.default_rng(9), noise_px=0.02, distance=(1.5, 2.0))
    found = _calibrate(capture, method).corner
    assert np.sum(found.legs * capture.corner.legs, axis=1).min() > 0.999
    assert np.sum(found.normals * capture.corner.normals, axis=1).min() > 0.999


def test_the_residual_matches_the_noise() -> None:
    capture = random_capture(np.random.default_rng(4), noise_px=0.1)
    # Two coordinates of 0.1 px each.
    assert 0.13 < _calibrate(capture, "refined").residual_px < 0.15


def test_outliers_do_not_move_the_solution() -> None:
    capture = random_capture(np.random.default_rng(4), **LENSES, outliers=0.02)  # type: ignore[arg-type]
    face = capture.matches.face
    assert face is not None
    hidden = np.where(face < 0, np.arange(len(face)) % 3, face).astype(np.int32)
    spoiled = replace(capture, matches=capture.matches.with_faces(hidden))
    assert np.abs(_errors(_calibrate(spoiled, "refined"))).mean() < 0.01


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_walls_far_from_square_are_refused(seed: int) -> None:
    capture = random_capture(np.random.default_rng(seed), walls_off_deg=7.0)
    with pytest.raises(RefusalError):
        _calibrate(capture, "refined", squareness_deg=0.3)


@pytest.mark.parametrize("method", ["paper", "refined"])
def test_a_face_without_matches_is_refused(method: Method) -> None:
    capture = random_capture(np.random.default_rng(0), count=2000)
    face = capture.matches.face
    assert face is not None
    missing = replace(capture, matches=capture.matches.with_faces(np.where(face == 2, -1, face)))
    with pytest.raises(RefusalError, match="too few"):
        _calibrate(missing, method)


@pytest.mark.parametrize("method", ["paper", "refined"])
def test_one_plane_labelled_as_three_is_refused(method: Method) -> None:
    rng = np.random.default_rng(6)
    capture = random_capture(rng, count=20_000)
    plane = capture.matches.on_face(0)
    x = plane.camera_px[:, 0]
    face = np.digitize(x, np.quantile(x, [1 / 3, 2 / 3])).astype(np.int32)
    flat = replace(capture, matches=Matches(plane.camera_px, plane.projector_px, face))
    with pytest.raises(RefusalError):
        _calibrate(flat, method)
