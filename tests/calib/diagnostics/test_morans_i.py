import numpy as np
import pytest

from calib.diagnostics.spatial_errors import spatial_correlation

PIXELS = np.stack(np.meshgrid(np.arange(400.0), np.arange(300.0)), -1).reshape(-1, 2)[::3]


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
