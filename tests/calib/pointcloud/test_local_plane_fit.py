import numpy as np
import pytest
from numpy.typing import NDArray

from calib.numerics import Floats
from calib.pointcloud.plane_fit import WindowPlanes, window_planes

FOCAL_PX = 400.0


def wavy_surface(height: int, width: int, missing: float, noise: float = 0.002) -> NDArray[np.float32]:
    """Points on a camera's grid, some of them missing."""
    rng = np.random.default_rng(height + width)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    depth = 2 + 0.2 * np.sin(x / 31) + 0.3 * np.cos(y / 23) + noise * rng.normal(size=x.shape)
    points = np.stack([(x - 70) / FOCAL_PX * depth, (y - 40) / FOCAL_PX * depth, depth], axis=-1)
    points[rng.random(depth.shape) < missing] = np.nan
    return points.astype(np.float32)


def fitted_at(points: NDArray[np.float32], row: int, column: int, window: int) -> tuple[Floats, float, int]:
    """Normal, roughness and number of points of a least-squares fit to the window alone."""
    half = window // 2
    around = points[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1].reshape(-1, 3)
    x, y, z = around[np.isfinite(around[:, 2])].astype(np.float64).T
    design = np.column_stack([x / z, y / z, np.ones_like(z)])
    plane = np.linalg.lstsq(design, 1 / z, rcond=None)[0]
    rms = np.sqrt(np.mean((design @ plane - 1 / z) ** 2))
    return -plane / np.linalg.norm(plane), rms * FOCAL_PX * points[row, column, 2], len(z)


@pytest.mark.parametrize(("window", "missing"), [(7, 0.0), (7, 0.3), (11, 0.5), (15, 0.0)])
def test_planes_match_least_squares(window: int, missing: float) -> None:
    """In a picture of several strips and tiles, also at their borders and the border of the picture."""
    points = wavy_surface(140, 530, missing)
    planes = window_planes(points, FOCAL_PX, window)
    there = np.isfinite(points[..., 2])
    rows, columns = (np.r_[0:3, 62:67, 137:140], np.r_[0:3, 254:258, 510:514, 527:530])
    compared = 0
    for row in rows:
        for column in columns:
            if there[row, column]:
                normal, roughness, count = fitted_at(points, row, column, window)
                assert planes.count[row, column] == count
                np.testing.assert_allclose(planes.normals[row, column], normal, atol=2e-5)
                assert planes.roughness[row, column] == pytest.approx(roughness, rel=1e-3)
                compared += 1
    assert compared > 0.4 * len(rows) * len(columns)


def test_degenerate_windows_give_no_plane() -> None:
    points = wavy_surface(60, 60, 0.0)
    lonely, in_a_row = np.full_like(points, np.nan), np.full_like(points, np.nan)
    lonely[::10, ::10] = points[::10, ::10]
    in_a_row[30] = points[30]
    for some, largest_count in ((lonely, 1), (in_a_row, 7)):
        planes = window_planes(some, FOCAL_PX, 7)
        assert np.isnan(planes.normals).all()
        assert np.isnan(planes.roughness).all()
        assert np.array_equal(planes.count > 0, np.isfinite(some[..., 2]))
        assert planes.count.max() == largest_count


def test_pictures_smaller_than_a_window() -> None:
    planes = window_planes(wavy_surface(3, 4, 0.0), FOCAL_PX, 15)
    assert np.all(planes.count == 12)
    assert np.isfinite(planes.normals).all()


def test_an_outlier_affects_only_its_own_windows() -> None:
    points = wavy_surface(80, 80, 0.0)
    spoiled = points.copy()
    spoiled[40, 40] *= 1e-4
    before, after = (window_planes(some, FOCAL_PX, 7) for some in (points, spoiled))
    around = np.zeros((80, 80), dtype=bool)
    around[37:44, 37:44] = True
    assert spoiled_by(before, after)[around].max() > 0.1
    assert spoiled_by(before, after)[~around].max() < 1e-3


def spoiled_by(before: WindowPlanes, after: WindowPlanes) -> Floats:
    return np.linalg.norm((before.normals - after.normals).astype(np.float64), axis=-1)


@pytest.mark.parametrize(("number", "known"), [(4, False), (5, True)])
def test_a_plane_takes_a_point_and_four_neighbours(number: int, known: bool) -> None:
    whole = wavy_surface(40, 40, 0.0)
    points = np.full_like(whole, np.nan)
    for row, column in [(20, 20), (20, 23), (23, 20), (23, 23), (21, 22)][:number]:
        points[row, column] = whole[row, column]
    planes = window_planes(points, FOCAL_PX, 7)
    assert planes.count[20, 20] == number
    assert bool(np.isfinite(planes.normals[20, 20]).all()) == known
    assert bool(np.isfinite(planes.roughness[20, 20])) == known
