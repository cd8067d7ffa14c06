"""The refinement's own steps; what it estimates is compared with the truth in tests/calib/self_calibration."""

import numpy as np
import pytest

from calib.numerics import covariance_of
from calib.refinement.focal_sweep import at_focal
from calib.refinement.parameters import CAMERA
from calib.refinement.profile_minimiser import relax
from calib.refinement.refine import _traced
from tests.calib.refinement.conftest import Case


@pytest.mark.parametrize("sigmas_beside", [-1.5, 1.5])
def test_a_fit_that_stopped_beside_the_bottom_of_a_valley_is_taken_there(case: Case, sigmas_beside: float) -> None:
    sigma = np.sqrt(covariance_of(case.best.information, case.prior.free)[CAMERA.start, CAMERA.start])
    beside = at_focal(case.best.state, case.best.state.camera[0] * float(np.exp(sigmas_beside * sigma)))
    begun = relax(case.problem.holding(CAMERA.start), beside, tolerance=1e-6)
    lowest, valley = _traced(case.problem, begun)
    assert 1.5 < begun.cost - lowest.cost < 4.0  # of a Gaussian, 1.5² = 2.25
    assert abs(lowest.cost - case.best.cost) < 0.05
    assert abs(np.log(lowest.state.camera[0] / case.best.state.camera[0])) < 0.2 * sigma
    assert 0.0 <= valley.gain < 0.3  # there was nothing left to descend to
