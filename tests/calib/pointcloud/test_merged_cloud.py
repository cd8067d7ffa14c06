import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.numerics import Floats, Ints
from calib.pointcloud.merged_cloud import nearest_in_voxels


def nearest_by_definition(points: Floats, distance: Floats, size: float) -> Ints:
    best: dict[tuple[float, ...], int] = {}
    for index, point in enumerate(points):
        cube = tuple(np.floor(point / size).tolist())
        if cube not in best or distance[index] < distance[best[cube]]:
            best[cube] = index
    return np.array(sorted(best.values()), np.int64)


@settings(max_examples=50)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(0, 400),
    size=st.floats(0.01, 3.0),
    far=st.sampled_from([0.0, 1e6, 1e12]),
)
def test_each_cube_keeps_the_nearest(seed: int, count: int, size: float, far: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2, 2, (count, 3))
    points[: count // 8] *= far
    distance = rng.integers(1, 5, count).astype(np.float64)  # often equal: then it is the first
    np.testing.assert_array_equal(
        nearest_in_voxels(points, distance, size), nearest_by_definition(points, distance, size)
    )


def test_many_points_on_a_wall() -> None:
    """A grid of points on the voxels' faces, a hard case for a hash."""
    y, x = np.mgrid[:300, :400].astype(np.float64)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    kept = nearest_in_voxels(points, np.linalg.norm(points, axis=1), 2.0)
    assert len(kept) == len(points) // 4
    assert np.all(points[kept] % 2 == 0)
