"""Codes that contradict their fringes by whole periods are refused."""

from contextlib import nullcontext

import numpy as np
import pytest

from scanner.decoding.map_checks import check_cycles
from scanner.errors import InputError
from tests.scanner.decoding.motion.test_wrong_bits import PERIOD, PLAN, SHAPE, maps, wall


@pytest.mark.parametrize("slip", [0, 1, -1, 2])
def test_a_code_that_is_not_that_of_the_fringes_is_refused(slip: int) -> None:
    """A quarter of each cell is off by a period, as after a motion, or by two, as if the code ran backwards."""
    px = wall()
    px[px[..., 0] % 16 > 12, 0] += slip * PERIOD
    px[30:90, 40:100, 0] += 1.9 * PERIOD  # an object, whose edges are no slips
    found = maps(px, np.zeros(SHAPE, np.bool_)).projector_px
    with pytest.raises(InputError, match=r"along x .* whole periods") if slip else nullcontext():
        check_cycles(PLAN, found)
