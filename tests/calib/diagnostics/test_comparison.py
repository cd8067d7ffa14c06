"""Calibrations of one rig from two sets of boards agree; a changed calibration does not."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnostics import SystematicErrors, compare
from tests.support.known_rigs import before, errors_of

pytestmark = pytest.mark.xdist_group("boards and corner")  # what they share is made once

DEPTHS = np.array([0.8, 1.2])


@pytest.fixture(scope="module")
def boards() -> tuple[SystematicErrors, SystematicErrors]:
    """The calibration from boards, and the truth, which states no sigmas."""
    case = before(1)
    return errors_of(case.known), SystematicErrors.of(case.truth, None)


def grid(errors: SystematicErrors) -> np.ndarray:
    width, height = errors.calibration.camera.size
    x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 7))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def test_the_truth_is_within_the_sigmas(boards: tuple[SystematicErrors, SystematicErrors]) -> None:
    found, truth = boards
    difference = compare(found, truth, grid(found), DEPTHS, metric=True)
    assert difference.agree
    assert 3 <= difference.freedom <= 16
    assert 0.2 < np.sqrt(np.mean(difference.sigmas**2)) < 2.0
    assert 1e-5 < np.sqrt(np.mean(difference.length**2)) < 3e-3
    assert 0.02 < np.sqrt(np.mean(difference.px_sigma**2)) < 2.0
    assert difference.scale == 1.0


def test_a_zoom_of_half_a_per_cent_is_found(boards: tuple[SystematicErrors, SystematicErrors]) -> None:
    found, truth = boards
    projector = truth.calibration.projector
    zoomed = replace(projector, focal_px=(1.005 * projector.focal_px[0],) * 2)
    changed = SystematicErrors.of(replace(truth.calibration, projector=zoomed), None)
    difference = compare(found, changed, grid(found), DEPTHS, metric=True)
    assert not difference.agree
    assert difference.chi2 > 2 * difference.limit
    assert 1.0 < difference.px.max() < 20.0


def test_without_a_scale_only_shapes_are_compared(boards: tuple[SystematicErrors, SystematicErrors]) -> None:
    found, truth = boards
    tripled = SystematicErrors.of(truth.calibration.scaled(3), None)
    free = compare(found, tripled, grid(found), DEPTHS, metric=False)
    assert free.agree
    assert 0.32 < free.scale < 0.345
    assert not compare(found, tripled, grid(found), DEPTHS, metric=True).agree


def test_a_rigid_motion_of_the_camera_is_no_difference(boards: tuple[SystematicErrors, SystematicErrors]) -> None:
    _, truth = boards
    same = compare(truth, truth, grid(truth), DEPTHS, metric=True)
    assert same.length.max() < 1e-10
    assert same.px.max() < 1e-9


def test_rigs_that_see_nothing_in_common_are_not_compared(boards: tuple[SystematicErrors, SystematicErrors]) -> None:
    found, truth = boards
    assert compare(found, truth, grid(found), np.array([0.01]), metric=True) is None
