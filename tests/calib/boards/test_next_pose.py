"""Sigmas of focal lengths and principal points are compared as angles."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.boards.next_pose import _scale, _size
from calib.boards.parameters import INTRINSIC_COLUMNS, SHARED, State


@pytest.mark.parametrize("number", range(6))
def test_a_hundredth_of_a_focal_length_counts_alike_everywhere(number: int) -> None:
    """Relative for focals, in pixels for principal points: each is a sixth of the mean square."""
    camera, projector = np.array([1500.0]), np.array([900.0])
    state = cast(State, SimpleNamespace(camera=camera, projector=projector))
    sigma = np.array([0.01, 15.0, 15.0, 0.01, 9.0, 9.0])
    variances = np.zeros(SHARED)
    variances[np.arange(SHARED)[INTRINSIC_COLUMNS][number]] = sigma[number] ** 2
    assert _size(np.diag(variances), _scale(state)) == pytest.approx(0.01 / np.sqrt(6), rel=1e-12)
