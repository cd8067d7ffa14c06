"""Small patches of a mask, compared with OpenCV's connected components."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scanner.decoding.coordinates.coordinate_maps import SMALLEST_PATCH, small_patches


@given(
    image=arrays.arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 40)), elements=st.booleans()),
    grown=st.integers(0, 2),
)
def test_small_patches_match_those_of_opencv(image: NDArray[np.bool_], grown: int) -> None:
    thick = cv2.dilate(image.view(np.uint8), np.ones((2, 2), np.uint8), iterations=grown).view(np.bool_)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thick.view(np.uint8), connectivity=4)
    expected = thick & (stats[labels, cv2.CC_STAT_AREA] < SMALLEST_PATCH)
    assert np.array_equal(small_patches(thick), expected)
