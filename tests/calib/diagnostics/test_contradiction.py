"""What contradicts is named: the parameter that was moved, by how much."""

from functools import cache

import numpy as np
import pytest

from calib.diagnostics.contradiction import _differences_from
from calib.refinement import SHARED, CornerFit, KnownRig
from tests.support.known_rigs import before

CAMERA, PROJECTOR, ROTATION, BASELINE = 0, 8, 16, 19  # first columns
SIGMA = 1e-9  # of the fit: small beside that of the known rig


@cache
def known_rig() -> KnownRig:
    return before(1).known.rig


def words_of(column: int, sigmas: float) -> str:
    """What is said of a fit in which one parameter differs."""
    rig = known_rig()
    step = np.zeros(SHARED)
    step[column] = sigmas * np.sqrt(rig.covariance[column, column])
    information = np.diag(np.full(SHARED, SIGMA**-2))
    fit = CornerFit(0.0, np.zeros(SHARED), information, rig.state.moved(step), ())
    return _differences_from(rig, fit, np.ones(SHARED, np.bool_))


@pytest.mark.parametrize(
    ("column", "name"),
    [
        (CAMERA, "the camera's focal length"),
        (CAMERA + 1, "the camera's principal point"),
        (CAMERA + 2, "the camera's principal point"),
        (CAMERA + 3, "the camera's distortion"),
        (CAMERA + 4, "the camera's distortion"),
        (PROJECTOR, "the projector's focal length"),
        (PROJECTOR + 1, "the projector's principal point"),
        (PROJECTOR + 2, "the projector's principal point"),
        (PROJECTOR + 3, "the projector's distortion"),
        (PROJECTOR + 4, "the projector's distortion"),
        (ROTATION, "the rotation between them"),
        (ROTATION + 2, "the rotation between them"),
        (BASELINE, "the direction of the baseline"),
        (BASELINE + 1, "the direction of the baseline"),
    ],
)
def test_the_parameter_that_was_moved_is_named_first(column: int, name: str) -> None:
    first, *further = words_of(column, 9.0).split(", ")
    assert first.startswith(f"{name} by ")
    assert first.endswith("(9.0 sigmas)")
    assert len(further) == 2
    assert all(float(text.split("(")[1].split()[0]) < 1 for text in further)


def test_a_difference_has_its_unit() -> None:
    rig = known_rig()
    focal, turn = (float(np.sqrt(rig.covariance[column, column])) for column in (CAMERA, ROTATION))
    assert f"by {100 * 9 * focal:.2g} %" in words_of(CAMERA, 9.0)
    assert f"by {np.degrees(9 * turn):.2g}°" in words_of(ROTATION, 9.0)
