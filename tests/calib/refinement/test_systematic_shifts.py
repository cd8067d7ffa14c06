"""The effect of shifted matches on a calibration, predicted without a new fit."""

from dataclasses import replace

import numpy as np

from calib.estimation import Shifts
from calib.geometry import Matches
from calib.numerics import CUBIC, Floats, monomials
from calib.self_calibration import PrincipalPoint, SelfCalibration, self_calibrate
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

_PX = 0.1


def tilt(camera_px: Floats, projector_px: Floats, gradient: Floats) -> Floats:
    """A projector tilted by this many pixels after x and before y."""
    assert camera_px.shape == projector_px.shape == gradient.shape[:2]
    (_, y), focal = projector_px.T - np.array([[427.0], [240.0]]), PAPER_PROJECTOR.focal_px[0]
    return np.stack([np.zeros(len(y)), _PX * (1 + (y / focal) ** 2)], axis=1)


def intrinsics(found: SelfCalibration) -> Floats:
    camera, projector = found.calibration.camera, found.calibration.projector
    return np.array([camera.focal_px[0], projector.focal_px[0], *projector.principal_point_px])


def solve(which: Matches, shifts: Shifts | None) -> SelfCalibration:
    sizes = (PAPER_CAMERA.width, PAPER_CAMERA.height), (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
    point = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)
    return self_calibrate(which, *sizes, principal_point=point, squareness_deg=0.0, shifts=shifts)


def test_the_prediction_matches_a_new_fit() -> None:
    capture = random_capture(np.random.default_rng(0), count=20_000, distance=(1.5, 3.0))
    matches = capture.matches
    gradient = np.zeros((len(matches), 2, 2))
    by_tilt = tilt(matches.camera_px, matches.projector_px, gradient)
    shifted = replace(matches, projector_px=matches.projector_px + by_tilt)

    before = solve(matches, Shifts(possible=(tilt,)))
    after = solve(shifted, None)
    percent = 100 * np.mean(np.abs(intrinsics(after) / intrinsics(before) - 1))
    assert 0.6 * percent < before.possible_percent < 1.6 * percent
    assert before.likely_percent == 0.0

    doubted = solve(matches, Shifts(likely=(tilt,)))
    assert 0.9 * before.possible_percent < doubted.likely_percent < 1.1 * before.possible_percent
    assert doubted.at_rest_percent == before.at_rest_percent
    assert 0.02 < before.at_rest_percent < 0.5
    sigma = [float(np.max(each.calibration.sigma.camera.focal_px)) for each in (after, before, doubted)]
    assert sigma[1] == sigma[2]
    assert sigma[0] < sigma[1] < sigma[0] + 0.02 * before.possible_percent * PAPER_CAMERA.focal_px[0]


def test_smooth_errors_move_the_solution_as_their_covariance_predicts() -> None:
    """Smooth errors are drawn repeatedly on the same noisy matches."""
    rng, smooth_px = np.random.default_rng(1), 0.003
    matches = random_capture(rng, count=20_000, distance=(1.5, 3.0)).matches
    before, doubted = solve(matches, None), solve(matches, Shifts(smooth_px=smooth_px))
    assert before.uncertainty is not None
    assert doubted.uncertainty is not None
    added = np.sqrt(np.diag(doubted.uncertainty.covariance - before.uncertainty.covariance))
    columns = np.flatnonzero(added > 0)
    assert doubted.likely_percent == 0.0
    moved = []
    for _ in range(6):
        after = solve(replace(matches, projector_px=smoothly_off(matches, smooth_px, rng)), None)
        assert after.uncertainty is not None
        moved.append(before.uncertainty.rig.step_to(after.uncertainty.rig)[columns] / added[columns])
    assert 0.6 < np.sqrt(np.mean(np.square(moved))) < 1.5


def smoothly_off(matches: Matches, smooth_px: float, rng: np.random.Generator) -> Floats:
    """The projector's pixels (N, 2) plus random cubic polynomials over each face."""
    off = matches.projector_px.copy()
    for face in range(3):
        members = np.flatnonzero(matches.labels == face)
        modes, _ = np.linalg.qr(monomials(matches.camera_px[members])[:, :CUBIC])
        off[members] += smooth_px * np.sqrt(len(members)) * modes @ rng.standard_normal((CUBIC, 2))
    return off
