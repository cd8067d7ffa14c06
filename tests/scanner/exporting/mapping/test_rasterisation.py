"""Each ray meets the nearest triangle, also through a bent lens, beside it and behind it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Intrinsics
from calib.numerics import Floats, Ints
from scanner.exporting.mapping.rasterisation import TriangleRaster


def rays_of(lens: Intrinsics) -> Floats:
    """(H, W, 2)"""
    x, y = np.meshgrid(np.arange(float(lens.width)), np.arange(float(lens.height)))
    return lens.ideal(np.stack([x, y], axis=-1))


def nearest_hits(rays: Floats, points: Floats, triangles: Ints) -> tuple[Ints, Floats]:
    """Numbers and depths (H, W), -1 and infinity without one: Möller and Trumbore's test of all rays and triangles."""
    number, depth = np.full(rays.shape[:2], -1), np.full(rays.shape[:2], np.inf)
    directions = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
    for index, (a, b, c) in enumerate(points[triangles]):
        normal = np.cross(directions, c - a)
        scale = normal @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = normal @ -a / scale
            cross = np.cross(-a, b - a)
            v, t = directions @ cross / scale, (c - a) @ cross / scale
            closer = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < depth)
        number[closer], depth[closer] = index, t[closer]
    return number, depth


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([(0.0, 0.0), (-0.25, 0.05), (0.2, -0.05)]),
    st.sampled_from([0.1, 1.0, 4.0]),
)
def test_every_ray_meets_the_triangle_that_is_nearest(seed: int, bend: tuple[float, float], size: float) -> None:
    """Some triangles are around the device, some reach behind it, some hide others."""
    rng = np.random.default_rng(seed)
    lens = Intrinsics(67, 41, (50.0, 52.0), (31.0, 36.0), (*bend, 0.0, 0.0, 0.0))
    centres = rng.uniform((-3, -3, -2), (3, 3, 5), (30, 1, 3))
    points = (centres + size * rng.standard_normal((30, 3, 3))).reshape(-1, 3)
    triangles = np.arange(90).reshape(-1, 3)
    rays = rays_of(lens)
    number, depth = nearest_hits(rays, points, triangles)
    hits = TriangleRaster(points, triangles).hits(rays)
    assert np.mean(hits.triangle != number) < 1e-3  # rays along an edge
    same = hits.triangle == number
    assert np.array_equal(np.isfinite(hits.depth[same]), number[same] >= 0)
    lit = same & (number >= 0)
    assert hits.depth[lit] == pytest.approx(depth[lit], rel=1e-5)


def test_a_closed_surface_has_no_cracks() -> None:
    """A plane of many triangles: every ray that meets it has a depth, that of the plane."""
    shares = np.linspace(-2.0, 2.0, 41)
    x, y = np.meshgrid(shares, shares)
    points = np.stack([x, y, 2.0 + 0.3 * x - 0.2 * y], axis=-1).reshape(-1, 3)
    corner = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, 1, 42], corner[:, None] + [0, 42, 41]])
    rays = rays_of(Intrinsics(200, 150, (300.0, 300.0), (99.5, 74.5), (-0.1, 0.02, 0.0, 0.0, 0.0)))
    hits = TriangleRaster(points, triangles).hits(rays)
    assert hits.triangle.min() >= 0
    assert hits.depth == pytest.approx(2.0 / (1 - 0.3 * rays[..., 0] + 0.2 * rays[..., 1]), rel=1e-6)


def test_a_ray_that_the_lens_has_not_meets_nothing() -> None:
    points = np.array([[-9.0, -9.0, 1.0], [9.0, -9.0, 1.0], [0.0, 9.0, 1.0]])
    rays = np.zeros((3, 40, 2))
    rays[1, 5] = np.nan
    rays[2] = np.nan
    triangle = TriangleRaster(points, np.array([[0, 1, 2]])).hits(rays).triangle
    assert triangle[1, 5] == -1
    assert np.all(triangle[2] == -1)
    assert np.all(triangle[0] == 0)
    assert np.count_nonzero(triangle[1] == 0) == 39
