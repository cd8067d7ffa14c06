"""Positions within a fringe, with variances, from its frames; small patches, as OpenCV finds them."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scanner.decoding import plan_sequence
from scanner.decoding.coordinates.axis_decoder import _measure
from scanner.decoding.coordinates.coordinate_map import SMALLEST_PATCH, small_patches
from scanner.patterns import phase_sequence


@pytest.mark.parametrize(("steps", "dtype"), [(3, np.uint8), (4, np.uint16), (5, np.float32)])
def test_positions_are_those_of_the_fringe(steps: int, dtype: np.dtype) -> None:
    """At more pixels than are measured at once."""
    (fringe, *_) = plan_sequence([*phase_sequence("x", 40, steps), *phase_sequence("y", 40, steps)], (40, 40)).fringes
    place = np.random.default_rng(0).uniform(0.2, 39.8, 5000)
    angle = 2 * np.pi * (place[None] / 40 + np.array(fringe.shifts)[:, None])
    levels = (110 + 100 * np.cos(angle)).astype(dtype)
    level = np.full(len(place), 110, np.float32)
    variance, position = np.empty((2, len(place)), np.float32)
    per_radian = np.float32(40 / (2 * np.pi))
    _measure(levels, fringe.weights32, level, np.float32(1), np.float32(0.1), per_radian, variance, position)
    assert np.abs(position - place).max() < 0.1
    assert variance == pytest.approx(np.full(len(place), 12e-4), rel=0.03)


@given(
    image=arrays.arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 40)), elements=st.booleans()),
    grown=st.integers(0, 2),
)
def test_small_patches_match_those_of_opencv(image: NDArray[np.bool_], grown: int) -> None:
    thick = cv2.dilate(image.view(np.uint8), np.ones((2, 2), np.uint8), iterations=grown).view(np.bool_)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thick.view(np.uint8), connectivity=4)
    expected = thick & (stats[labels, cv2.CC_STAT_AREA] < SMALLEST_PATCH)
    assert np.array_equal(small_patches(thick), expected)
