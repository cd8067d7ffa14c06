"""A picture that the projector scales in one direction, in front of corners that are nearly square."""

from dataclasses import replace

import numpy as np
import pytest

from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, SelfCalibration, self_calibrate_jointly
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_captures

SIZES = (PAPER_CAMERA.width, PAPER_CAMERA.height), (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
CENTRE = PrincipalPoint(((SIZES[0][0] - 1) / 2, (SIZES[0][1] - 1) / 2), 70.0)


def calibrated(seed: int, scale: float) -> SelfCalibration:
    """From two captures of a corner, the picture scaled along x about its middle."""
    captures = random_captures(np.random.default_rng([7, seed]), 2, count=5000, walls_off_deg=0.3)
    middle = np.array([(SIZES[1][0] - 1) / 2, 0.0])
    scaled = [
        replace(each.matches, projector_px=(each.matches.projector_px - middle) * (scale, 1.0) + middle)
        for each in captures
    ]
    return self_calibrate_jointly(scaled, *SIZES, principal_point=CENTRE)[0]


def deviation(found: SelfCalibration) -> float:
    """Of the camera's focal length, in sigmas."""
    sigma = found.calibration.sigma
    assert sigma is not None
    return float(abs(found.calibration.camera.focal_px[0] - PAPER_CAMERA.focal_px[0]) / sigma.camera.focal_px[0])


@pytest.mark.parametrize(("seed", "scale"), [(0, 1.01), (9, 1.03)])
def test_sigmas_include_a_picture_scale_that_explains_oblique_walls(seed: int, scale: float) -> None:
    square, scaled = calibrated(seed, 1.0), calibrated(seed, scale)
    assert not any("scaled in one direction" in note for note in square.notes)
    assert any("scaled in one direction" in note for note in scaled.notes)
    sigmas = [each.calibration.sigma.camera.focal_px[0] for each in (square, scaled) if each.calibration.sigma]
    assert 3 < sigmas[1] / sigmas[0] < 50
    assert deviation(square) < 2
    assert deviation(scaled) < 2


def test_a_refusal_of_faces_that_are_not_square_names_the_scale() -> None:
    with pytest.raises(RefusalError, match=r"not square to each other.*may be scaled in one direction \(by \+2"):
        calibrated(2, 1.03)
