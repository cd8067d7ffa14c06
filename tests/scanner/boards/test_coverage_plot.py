"""The plot of where boards were in a picture."""

import re

import numpy as np
import pytest

from calib.geometry import Size
from scanner.boards.result import _coverage


@pytest.mark.parametrize("size", [Size(200, 150), Size(4096, 3000), Size(3000, 4096)])
def test_dots_are_seen_and_hide_no_other(size: Size) -> None:
    """Each is where its corner is, and its diameter a hundredth of the longer side."""
    pixels = np.array([[0.1, 0.1], [0.5, 0.5], [0.9, 0.3]]) * size
    svg = str(_coverage([pixels[:2], pixels[2:]], size, "Corners"))
    dots = np.array(re.findall(r'<circle cx="([-\d.]+)" cy="([-\d.]+)" r="([-\d.]+)"/>', svg), np.float64)
    assert dots.shape == (3, 3)
    np.testing.assert_allclose(dots[:, :2], pixels, rtol=0, atol=0.5)
    assert (0.003 * max(size) < dots[:, 2]).all()
    assert (dots[:, 2] < 0.006 * max(size)).all()
    assert f'viewBox="0 0 {size.width} {size.height}"' in svg
