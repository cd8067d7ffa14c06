"""The footprint of a camera pixel, measured by the errors that shading causes, and corrected."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from calib.numerics import Floats32
from scanner.decoding.fringes import Footprint, shading_shift
from scanner.decoding.fringes.footprint import (
    CROSS,
    TYPICAL_PX2,
    correct_curvature_shift,
    curvature_kernel,
    footprint_of,
    log_amplitude,
    noise_gain2,
    surrounded,
)

TILE = 48
OVERSAMPLED = 8
Floats = NDArray[np.float32]


def seen(
    sigma_px: float,
    seed: int = 1,
    *,
    slope: tuple[float, float] = (0.7, 0.2),
    shaken_px: float = 0.0,
    darkest: float = 0.5,
) -> tuple[Floats, Floats, Floats]:
    """Return true and observed value of a slanted coordinate, and ln A, for a Gaussian footprint on patchy paint.

    `slope`: per column and per row. `shaken_px`: standard deviation of a diagonal camera shake during the exposure, in
    columns and rows. `darkest`: of the paint.
    """
    rng = np.random.default_rng(seed)
    paint = np.kron(rng.uniform(darkest, 1.0, (6, 6)), np.ones((TILE * OVERSAMPLED // 6,) * 2))
    step = (np.arange(TILE * OVERSAMPLED) + 0.5) / OVERSAMPLED - 0.5
    coordinate = slope[0] * step[None, :] + slope[1] * step[:, None]
    phasor = paint * np.exp(2j * np.pi * coordinate / 8)
    blurred = [cv2.GaussianBlur(part, (0, 0), sigma_px * OVERSAMPLED) for part in (phasor.real, phasor.imag)]
    if shaken_px:
        along = np.diag(cv2.getGaussianKernel(round(6 * shaken_px * OVERSAMPLED) | 1, shaken_px * OVERSAMPLED)[:, 0])
        blurred = [cv2.filter2D(part, -1, along) for part in blurred]
    middle = np.s_[OVERSAMPLED // 2 :: OVERSAMPLED]
    cosine, sine = (part[middle, middle].astype(np.float32) for part in blurred)
    true = coordinate[middle, middle].astype(np.float32)
    phase = np.arctan2(sine, cosine) / (2 * np.pi) * 8
    return true, true + (phase - true + 4) % 8 - 4, log_amplitude(cosine**2 + sine**2)


@pytest.mark.parametrize("sigma_px", [0.5, 0.8])
def test_shading_is_corrected(sigma_px: float) -> None:
    true, value, log_a = seen(sigma_px)
    usable = np.ones(value.shape, np.bool_)
    inner = np.s_[4:-4, 4:-4]
    shift = shading_shift(value, log_a, usable, Footprint.round(sigma_px**2))
    before, after = (np.sqrt(np.mean((v - true)[inner] ** 2)) for v in (value, value - shift))
    assert before > 0.01
    assert 1e-4 < after < before / 2


@pytest.mark.parametrize("sigma_px", [0.5, 0.8])
def test_the_footprint_is_measured(sigma_px: float) -> None:
    found = measured([[seen(sigma_px, seed) for seed in range(12)]])
    assert found.across_px2 == found.down_px2
    assert found.mixed_px2 == 0
    assert 0.8 * sigma_px**2 < found.across_px2 < 1.3 * sigma_px**2


def measured(axes: list[list[tuple[Floats, Floats, Floats]]], noise_px: float = 0.02) -> Footprint:
    """Estimate the footprint from noisy tiles of each axis, made as in `seen`."""
    rng = np.random.default_rng(0)
    shaded, log_lit = [], np.empty(0, np.float32)
    for tiles in axes:
        value, log_a = (np.concatenate([tile[k] for tile in tiles]) for k in (1, 2))
        shaded.append((value + rng.normal(0, noise_px, value.shape).astype(np.float32), log_a))
        log_lit = log_a + rng.normal(0, 0.01, value.shape).astype(np.float32)
    return footprint_of(shaded, log_lit, np.ones(log_lit.shape, np.bool_), TILE, TYPICAL_PX2)


def test_camera_shake_elongates_the_footprint() -> None:
    slopes = (0.7, 0.2), (-0.15, 0.6)
    found = measured([[seen(0.5, seed, slope=slope, shaken_px=0.8) for seed in range(16)] for slope in slopes])
    lens, motion = 0.5**2, 0.8**2
    assert 0.8 * (lens + motion) < found.across_px2 < 1.3 * (lens + motion)
    assert 0.8 * (lens + motion) < found.down_px2 < 1.3 * (lens + motion)
    assert 0.8 * motion < found.mixed_px2 < 1.3 * motion
    assert 0.8 * (lens + 2 * motion) < found.largest_px2 < 1.3 * (lens + 2 * motion)


def test_camera_shake_is_found_even_if_few_patches_dominate() -> None:
    slopes = (0.7, 0.2), (-0.15, 0.6)
    found = measured(
        [
            [seen(0.5, k, slope=slope, darkest=0.1 if k < 3 else 0.6, shaken_px=0.8) for k in range(20)]
            for slope in slopes
        ]
    )
    assert 0.7 * 0.8**2 < found.mixed_px2 < 1.4 * 0.8**2


def test_a_plain_wall_gives_a_typical_footprint() -> None:
    rng = np.random.default_rng(0)
    shape = (8 * TILE, TILE)
    value = np.broadcast_to(0.7 * np.arange(TILE), shape) + rng.normal(0, 0.02, shape)
    log_a, log_lit = (rng.normal(0, 0.01, shape).astype(np.float32) for _ in range(2))
    found = footprint_of([(value.astype(np.float32), log_a)], log_lit, np.ones(shape, np.bool_), TILE, TYPICAL_PX2)
    assert found.across_px2 == found.down_px2
    assert 0.15 < found.across_px2 < 0.25


def test_the_measured_footprint_of_a_sharp_lens_is_used_although_insignificant() -> None:
    found = measured([[seen(0.3, seed) for seed in range(4)]], noise_px=0.06)
    assert found.across_px2 == found.down_px2
    assert 0.03 < found.across_px2 < 0.17


@pytest.mark.parametrize("first", range(0, 60, 20))
def test_few_dominant_patches_do_not_elongate_the_footprint(first: int) -> None:
    slopes = (0.7, 0.2), (-0.15, 0.6)
    found = measured(
        [
            [seen(0.5, first + k, slope=slope, darkest=0.2 if k < 3 else 0.97, shaken_px=0.0) for k in range(20)]
            for slope in slopes
        ]
    )
    assert found.mixed_px2 == 0
    assert 0.6 * 0.25 < found.across_px2 < 1.5 * 0.25


def test_nothing_is_corrected_beside_unusable_pixels() -> None:
    _, value, log_a = seen(0.5)
    usable = np.ones(value.shape, np.bool_)
    usable[20, 20] = False
    shift = shading_shift(value, log_a, usable, Footprint.round(1.0))
    assert not shift[[20, 19, 21, 20, 20], [20, 20, 20, 19, 21]].any()
    assert shift[18, 18] != 0


SHAPE = 40, 48
ROUND = Footprint.round(0.3)


def unshaded() -> Floats32:
    return np.zeros(SHAPE, np.float32)


@given(
    st.tuples(*[st.floats(-0.2, 0.2)] * 3),
    st.builds(Footprint, st.floats(0.05, 0.7), st.floats(0.05, 0.7), st.floats(-0.04, 0.04)),
)
def test_the_footprint_error_of_a_curved_surface_is_corrected(
    bends: tuple[float, float, float], footprint: Footprint
) -> None:
    along_x, along_y, both = bends
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] - 20.0
    true = 100 + 2 * x - y + 0.5 * along_x * x**2 + 0.5 * along_y * y**2 + both * x * y
    shift = 0.5 * (footprint.across_px2 * along_x + footprint.down_px2 * along_y) + footprint.mixed_px2 * both
    value, variance = (true + shift).astype(np.float32), np.full(SHAPE, 1e-4, np.float32)
    correct_curvature_shift(value, variance, unshaded(), np.ones(SHAPE, np.bool_), footprint)
    np.testing.assert_allclose(value, true, atol=1e-3)  # beside the border as well, where it is that of neighbours
    assert np.all(variance >= 1e-4)


def test_noise_grows_by_the_stated_amount() -> None:
    noise = np.random.default_rng(0).normal(0, 0.02, (400, 400)).astype(np.float32)
    value, variance = 5 + noise, np.full(noise.shape, 0.02**2, np.float32)
    correct_curvature_shift(value, variance, np.zeros_like(noise), np.ones(noise.shape, np.bool_), ROUND)
    found, gain = np.var(value[2:-2, 2:-2]) / 0.02**2, noise_gain2(curvature_kernel(ROUND))
    assert found == pytest.approx(gain, rel=0.01)
    assert 1.02 < gain < 1.06
    assert np.median(variance) == pytest.approx(0.02**2 * gain, rel=0.01)


def test_a_depth_step_is_not_taken_for_curvature() -> None:
    true = np.where(np.arange(SHAPE[1]) < 20, 10, 30).astype(np.float32) * np.ones(SHAPE, np.float32)
    value = true.copy()
    correct_curvature_shift(value, np.full(SHAPE, 1e-4, np.float32), unshaded(), np.ones(SHAPE, np.bool_), ROUND)
    np.testing.assert_array_equal(value, true)


def test_shading_at_the_rim_is_extrapolated() -> None:
    surface = np.ones(SHAPE, np.bool_)
    surface[:, :10] = False
    shift = np.full(SHAPE, 0.05, np.float32)
    shift[:, :11] = np.nan
    value, variance = np.zeros(SHAPE, np.float32), np.full(SHAPE, 1e-4, np.float32)
    correct_curvature_shift(value, variance, shift, surface, ROUND)
    np.testing.assert_allclose(value[:, 10], -0.05, atol=0.01)
    assert np.all(variance[:, 10] > 0.04**2)
    np.testing.assert_array_equal(value[:, :10], 0)


def test_a_ball_keeps_its_shape() -> None:
    """Fringes on a ball, lit from the camera's position, averaged over each pixel's footprint."""
    fine, radius, period = 8, 20.0, 12.0
    side = np.arange(-24 * fine, 24 * fine) / fine
    r2 = side[:, None] ** 2 + side**2
    depth = -np.sqrt(np.maximum(radius**2 - r2, 1.0))
    light = np.where(r2 < radius**2, np.sqrt(np.maximum(radius**2 - r2, 1.0)) / radius, 0.0)
    phase = 2 * np.pi * (0.5 * depth + 0.3 * side) / period
    seen = [
        ndimage.gaussian_filter(part, fine * np.sqrt(ROUND.across_px2))[::fine, ::fine]
        for part in (light * np.cos(phase), light * np.sin(phase))
    ]
    true = (0.5 * depth + 0.3 * side)[::fine, ::fine]
    surface = r2[::fine, ::fine] < (0.95 * radius) ** 2
    off = (np.arctan2(seen[1], seen[0]) - 2 * np.pi * true / period + np.pi) % (2 * np.pi) - np.pi
    value = (true + off * period / (2 * np.pi)).astype(np.float32)
    before = value - true
    log_amplitude = np.log(np.hypot(*seen) + 1e-6).astype(np.float32)
    shading = shading_shift(value, log_amplitude, surface, ROUND)
    value -= shading
    shading[~surrounded(surface, CROSS)] = np.nan
    correct_curvature_shift(value, np.full(value.shape, 1e-4, np.float32), shading, surface, ROUND)
    inner = r2[::fine, ::fine] < (0.8 * radius) ** 2
    assert np.max(np.abs(before[inner])) > 0.01
    assert np.max(np.abs((value - true)[inner])) < 0.003
    ring = (r2[::fine, ::fine] < (0.9 * radius) ** 2) & ~inner
    with_shading_alone = float(np.mean((true + before - shading)[ring] - true[ring]))
    assert with_shading_alone > 0.03
    assert abs(np.mean((value - true)[ring])) < 0.5 * with_shading_alone


def test_a_tile_gives_the_result_of_the_whole_image() -> None:
    """A tile with a margin, at a corner of the image and in its middle, gives the same result as the whole image."""
    rng = np.random.default_rng(1)
    value, variance = rng.normal(0, 0.02, SHAPE).astype(np.float32), np.full(SHAPE, 1e-4, np.float32)
    surface, shading = rng.random(SHAPE) > 0.1, rng.normal(0, 0.01, SHAPE).astype(np.float32)
    shading[rng.random(SHAPE) < 0.1] = np.nan
    whole = value.copy(), variance.copy()
    correct_curvature_shift(*whole, shading, surface, ROUND)
    for wide, wanted in ((np.s_[0:20, 0:30], np.s_[0:14, 0:24]), (np.s_[10:36, 8:40], np.s_[6:20, 6:26])):
        part = value[wide].copy(), variance[wide].copy()
        correct_curvature_shift(*part, shading[wide].copy(), surface[wide].copy(), ROUND, wanted)
        for found, expected in zip(part, whole, strict=True):
            np.testing.assert_array_equal(found[wanted], expected[wide][wanted])
    assert np.any(whole[0] != value)


def test_the_shift_is_the_product_of_the_slopes() -> None:
    # Central differences are exact for these; the four slopes differ and are not constant.
    v, u = np.mgrid[:9, :11].astype(np.float32)
    value, log_amplitude = 0.5 * u * u - 0.3 * v * v, 0.2 * u * v + 0.1 * v * v
    shift = shading_shift(value, log_amplitude, np.ones(u.shape, np.bool_), Footprint(2.0, 3.0, -0.5))
    value_u, value_v, log_u, log_v = u, -0.6 * v, 0.2 * v, 0.2 * u + 0.2 * v
    expected = 2 * value_u * log_u + 3 * value_v * log_v - 0.5 * (value_u * log_v + value_v * log_u)
    np.testing.assert_allclose(shift[1:-1, 1:-1], expected[1:-1, 1:-1], rtol=1e-4, atol=1e-4)
    assert not shift[[0, -1]].any()
    assert not shift[:, [0, -1]].any()
