import numpy as np

from calib.pointcloud.organised_cloud import _neighbour_planes


def test_a_point_with_nan_reach_is_isolated_and_faces_the_camera() -> None:
    """As with extreme lens distortion."""
    points = np.random.default_rng(0).normal((0, 0, 5), 0.1, (20, 3)).astype(np.float32)
    normals, isolated = _neighbour_planes(points, points, np.full(20, -1.0))
    assert isolated.all()
    np.testing.assert_allclose(normals, -points / np.linalg.norm(points, axis=1, keepdims=True), rtol=1e-5)
