"""Where windows hold too few points, neighbours within a window's width decide."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calib.pointcloud import surface

FOCAL_PX = 500.0
WINDOW = 7  # the smallest, which smooth surfaces get


def wall_and_lone_point(apart: int) -> NDArray[np.float32]:
    """A slanted wall, and one more point of it `apart` px to the right of its edge."""
    y, x = np.mgrid[:80, :120].astype(np.float64)
    inverse = 0.5 + 0.1 * (x - 60) / FOCAL_PX
    points = np.stack([(x - 60) / FOCAL_PX, (y - 40) / FOCAL_PX, np.ones_like(x)], axis=-1) / inverse[..., None]
    kept = x < 60
    kept[40, 59 + apart] = True
    points[~kept] = np.nan
    return points.astype(np.float32)


@pytest.mark.parametrize(("apart", "isolated"), [(WINDOW - 2, False), (WINDOW, False), (WINDOW + 1, True)])
def test_a_point_beside_a_wall_belongs_to_it_within_a_window(apart: int, isolated: bool) -> None:
    points = wall_and_lone_point(apart)
    normals = surface(points, FOCAL_PX)
    assert bool(normals.isolated[40, 59 + apart]) == isolated
    assert np.count_nonzero(normals.isolated) == isolated
    if not isolated:
        expected = -np.array([0.1, 0.0, 0.5]) / np.hypot(0.1, 0.5)
        np.testing.assert_allclose(normals.normals[40, 59 + apart], expected, atol=2e-3)
