"""What a pixel's footprint does to a sphere, against depths averaged over it."""

import numpy as np
import pytest

from calib.diagnostics.spatial_errors import footprint_offsets, spatial_correlation
from calib.pointcloud import Sphere

FOCAL_PX = 800.0
CORRECTED = 0.6  # share that the decoder corrects, as measured
PIXELS = np.stack(np.meshgrid(np.arange(400.0), np.arange(300.0)), -1).reshape(-1, 2)[::3]


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


def test_independent_residuals_are_random() -> None:
    found = [
        spatial_correlation(PIXELS, np.random.default_rng(seed).normal(0, 0.1, (len(PIXELS), 2)), 10)
        for seed in range(40)
    ]
    scores = np.array([(one.correlation - one.expected) / one.sigma for one in found if one])
    assert len(scores) == 40
    assert abs(scores.mean()) < 0.5
    assert 0.7 < scores.std() < 1.3
    assert not any(one.structured for one in found if one)


@pytest.mark.parametrize("size_px", [0.03, 0.2])
def test_a_smooth_part_is_found_and_measured(size_px: float) -> None:
    smooth = np.sqrt(2) * size_px * np.sin(PIXELS[:, 0] / 60)
    found = spatial_correlation(PIXELS, smooth + np.random.default_rng(0).normal(0, 0.1, len(PIXELS)), 10)
    assert found is not None
    assert found.structured
    assert found.shared_px == pytest.approx(size_px, rel=0.15)
    assert found.total_px == pytest.approx(np.hypot(size_px, 0.1), rel=0.05)


def test_a_pattern_too_weak_to_matter_is_significant_but_not_structure() -> None:
    smooth = 0.01 * np.sin(PIXELS[:, 0] / 60)
    found = spatial_correlation(PIXELS, smooth + np.random.default_rng(0).normal(0, 0.1, len(PIXELS)), 10)
    assert found is not None
    assert (found.significant, found.structured) == (True, False)


def test_a_common_offset_is_structure() -> None:
    found = spatial_correlation(PIXELS, np.random.default_rng(0).normal(0.1, 0.1, len(PIXELS)), 10)
    assert found is not None
    assert found.shared_px == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("count", [0, 1, 30])
def test_too_few_cells_give_no_answer(count: int) -> None:
    assert spatial_correlation(PIXELS[:count], np.zeros(count), 50) is None
