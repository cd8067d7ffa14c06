"""Tests of the clouds check that every match is counted, and which match of a pixel is kept."""

import numpy as np
import pytest

from calib.geometry import Matches
from calib.pointcloud.pixel_grid import Organised, organise
from tests.support.cloud_scene import Scene, room, with_mistakes


@pytest.fixture(scope="module")
def scene() -> Scene:
    return with_mistakes(room(), 0.05)[0]


def organised(scene: Scene, order: np.ndarray) -> Organised:
    return organise(scene.matches[order], scene.calibration)


def test_the_order_of_matches_does_not_matter(scene: Scene) -> None:
    """In image order, threads place them in parallel; in another order, one thread does."""
    count = len(scene.matches)
    in_order, shuffled = (
        organised(scene, order) for order in (np.arange(count), np.random.default_rng(0).permutation(count))
    )
    assert in_order.shared_pixel == shuffled.shared_pixel == 0
    assert in_order.disagreeing == pytest.approx(shuffled.disagreeing, rel=0.01)  # the trend is that of another sample
    np.testing.assert_array_equal(in_order.residual_px, shuffled.residual_px)
    both = np.isfinite(in_order.points) & np.isfinite(shuffled.points)
    assert both.mean() > 0.9 * np.isfinite(in_order.residual_px).mean()
    np.testing.assert_array_equal(in_order.points[both], shuffled.points[both])


def test_the_residual_of_a_pixel_belongs_to_its_point(scene: Scene) -> None:
    """Even if a match that was dropped for its residual comes later."""
    matches, alone = scene.matches, organised(scene, np.arange(len(scene.matches)))
    camera_px, wrong = matches.camera_px[::10], matches.projector_px[::10] + np.array([40.0, 25.0])
    spoiled = Matches(np.concatenate([matches.camera_px, camera_px]), np.concatenate([matches.projector_px, wrong]))
    both = organise(spoiled, scene.calibration)
    there = np.isfinite(alone.points[..., 2]) & np.isfinite(both.points[..., 2])
    assert there.mean() > 0.9 * np.isfinite(alone.points[..., 2]).mean()
    assert both.disagreeing > alone.disagreeing + 0.5 * len(camera_px)
    same = both.residual_px[there] == alone.residual_px[there]
    assert same.all()
