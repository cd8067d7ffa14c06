"""What shifted matches do to a calibration, predicted without a new fit."""

from dataclasses import replace

import numpy as np

from calib.geometry import Matches
from calib.numerics import Floats
from calib.refinement import Shifts
from calib.self_calibration import PrincipalPoint, SelfCalibration, self_calibrate
from calib.synthetic.captures import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

_PX = 0.1


def tilt(camera_px: Floats, projector_px: Floats, gradient: Floats) -> Floats:
    """A projector tilted by so many pixels after x and before y."""
    assert camera_px.shape == projector_px.shape == gradient.shape[:2]
    (_, y), focal = projector_px.T - np.array([[427.0], [240.0]]), PAPER_PROJECTOR.focal_px[0]
    return np.stack([np.zeros(len(y)), _PX * (1 + (y / focal) ** 2)], axis=1)


def intrinsics(found: SelfCalibration) -> Floats:
    camera, projector = found.calibration.camera, found.calibration.projector
    return np.array([camera.focal_px[0], projector.focal_px[0], *projector.principal_point_px])


def test_the_prediction_is_what_a_new_fit_does() -> None:
    capture = random_capture(np.random.default_rng(0), count=20_000, distance=(1.5, 3.0))
    matches = capture.matches
    gradient = np.zeros((len(matches), 2, 2))
    by_tilt = tilt(matches.camera_px, matches.projector_px, gradient)
    shifted = replace(matches, projector_px=matches.projector_px + by_tilt)

    def solve(which: Matches, shifts: Shifts | None) -> SelfCalibration:
        sizes = (PAPER_CAMERA.width, PAPER_CAMERA.height), (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
        point = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)
        return self_calibrate(which, *sizes, principal_point=point, squareness_deg=0.0, shifts=shifts)

    before = solve(matches, Shifts(possible=(tilt,)))
    after = solve(shifted, None)
    percent = 100 * np.mean(np.abs(intrinsics(after) / intrinsics(before) - 1))
    assert 0.6 * percent < before.possible_percent < 1.6 * percent
    assert before.likely_percent == 0.0

    doubted = solve(matches, Shifts(likely=(tilt,)))
    assert 0.9 * before.possible_percent < doubted.likely_percent < 1.1 * before.possible_percent
    sigma = [float(np.max(each.calibration.sigma.camera.focal_px)) for each in (after, before, doubted)]
    assert sigma[1] == sigma[2]
    assert sigma[0] < sigma[1] < sigma[0] + 0.02 * before.possible_percent * PAPER_CAMERA.focal_px[0]
