"""What a pixel's footprint does to a sphere, against depths averaged over it."""

import numpy as np
import pytest

from calib.diagnostics.spatial_errors import footprint_offsets
from calib.pointcloud import Sphere

FOCAL_PX = 800.0
CORRECTED = 0.6  # share that the decoder corrects, as measured


@pytest.mark.parametrize("from_middle", [0.0, 0.4, 0.7])
def test_a_sphere_seen_by_blurred_pixels_is_further_away(from_middle: float) -> None:
    """The pixel, and a blur of half a pixel; `from_middle`: of the ray, over the radius."""
    radius, away = 0.1, 1.5
    rng = np.random.default_rng(0)
    footprint = rng.uniform(-0.5, 0.5, (400_000, 2)) + rng.normal(0.0, 0.5, (400_000, 2))
    footprint -= footprint.mean(axis=0)
    ray = np.array([from_middle * radius / away, 0.0])
    reach = footprint / FOCAL_PX

    def depths(slopes: np.ndarray) -> np.ndarray:
        """Along the rays (x, y, 1), where they first meet the sphere."""
        rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
        square, middle = np.sum(rays**2, axis=1), rays[:, 2] * away
        return (middle - np.sqrt(middle**2 - square * (away**2 - radius**2))) / square

    depth = depths(ray[None])[0]
    # Steps to both sides, without what is linear.
    bent = (depths(ray + reach) + depths(ray - reach)) / 2 - depth
    point = depth * np.array([*ray, 1.0])
    sphere = Sphere(np.array([0.0, 0.0, away]), radius, np.zeros((4, 4)), np.zeros(0), np.zeros((0, 4)))
    outwards = (point - sphere.centre) / radius
    truth = (1 - CORRECTED) * float(bent.mean()) * -float(outwards[2])
    assert footprint_offsets(sphere, point[None], FOCAL_PX)[0] == pytest.approx(truth, rel=0.12)
