import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Intrinsics
from hw.simulated.device import Optics
from hw.simulated.picture import PictureOptics
from hw.simulated.placement import resized

BARREL = Optics(612, 512, 447.8, (314.0, 263.6), k1=-0.05, k2=0.008)
PICTURE = PictureOptics(40, 24, gamma=2.2, contrast=1000.0, blur_px=0.5)


@given(st.floats(-0.06, 0.03), st.floats(-0.01, 0.01), st.integers(0, 1000))
def test_the_lens_agrees_with_the_calibration_model(k1: float, k2: float, seed: int) -> None:
    optics = Optics(612, 512, 447.8, (314.0, 263.6), k1, k2)
    model = Intrinsics(612, 512, (447.8, 447.8), (314.0, 263.6), (k1, k2, 0.0, 0.0, 0.0))
    pixels = np.random.default_rng(seed).uniform((0, 0), (611, 511), (100, 2))
    rays = optics.to_rays(pixels.T)
    np.testing.assert_allclose(rays.T, model.unproject(pixels), atol=1e-8)
    np.testing.assert_allclose(optics.to_pixels(rays[0], rays[1]).T, pixels, atol=1e-5)


def test_a_negative_k1_pulls_the_corners_in() -> None:
    straight = Optics(612, 512, 447.8, (314.0, 263.6))
    corner = straight.to_rays(np.array([[0.0], [0.0]]))
    pulled = BARREL.to_pixels(corner[0], corner[1])[:, 0]
    assert np.all((pulled > 5) & (pulled < 20))


def test_directions_far_outside_the_image_are_not_seen() -> None:
    # Beyond its turning point the lens polynomial leads back into the image.
    assert not BARREL.sees(BARREL.to_pixels(np.array([5.0]), np.array([0.0]))).any()


@pytest.mark.parametrize(("width", "focal_px", "x0"), [(2448, 1791.1, 1256.3), (1224, 895.55, 628.15)])
def test_intrinsics_scale_with_the_width(width: int, focal_px: float, x0: float) -> None:
    optics = resized(Optics(2448, 2048, 1791.1, (1256.3, 1054.3)), width, 1024)
    assert (optics.focal_px, optics.principal_point_px[0]) == pytest.approx((focal_px, x0))


def test_the_response_is_a_power_above_the_black_level() -> None:
    levels = np.array([[0, 51, 128, 255]], np.uint8)
    light = PICTURE.linear(levels)[0]
    assert light[0] == pytest.approx(1e-3)
    assert light[3] == pytest.approx(1.0)
    np.testing.assert_allclose((light[1:3] - 1e-3) / 0.999, (levels[0, 1:3] / 255) ** 2.2, rtol=1e-5)


def test_blur_is_symmetric_and_conserves_light() -> None:
    light = np.zeros((24, 40), np.float32)
    light[11, 20] = 1.0
    fine = PICTURE.blurred(light)
    assert fine.sum() == pytest.approx(9.0, rel=1e-5)
    texels, weights = PICTURE.interpolate(np.array([[20.0, 19.2, 20.8, 20.0, 20.0], [11.0, 11.0, 11.0, 10.2, 11.8]]))
    middle, *sides = (fine[texels] * weights).sum(axis=1)
    assert 0.4 < middle < 0.6  # a square of one pixel under a Gaussian of half a pixel: erf(1 / √2)² = 0.466
    np.testing.assert_allclose(sides, sides[0], rtol=1e-5)
    assert 0.05 < sides[0] < middle / 2


def test_interpolation_at_a_pixel_centre_returns_that_pixel() -> None:
    x, y = np.meshgrid(np.arange(40.0), np.arange(24.0))
    pixels = np.array([[3.0, 20.25, 36.5], [4.0, 12.5, 19.75]])
    texels, weights = PICTURE.interpolate(pixels)
    for ramp, expected in ((x, pixels[0]), (y, pixels[1])):
        fine = PICTURE.blurred(ramp.astype(np.float32))
        np.testing.assert_allclose((fine[texels] * weights).sum(axis=1), expected, atol=0.02)


def test_the_pyramid_averages_over_the_footprint() -> None:
    light = np.random.default_rng(0).random((24, 40)).astype(np.float32)
    pyramid = PICTURE.pyramid(light)
    assert pyramid.size == PICTURE.texel_count
    pixels = np.array([[8.5, 8.0], [4.5, 4.0]])
    coarse, single = PICTURE.texels(pixels, np.array([4.0, 1.0]))
    assert pyramid[coarse] == pytest.approx(light[4:8, 8:12].mean(), rel=1e-5)
    assert pyramid[single] == light[4, 8]
