"""The footprint of a camera pixel, measured by the errors that shading causes, and corrected."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from scanner.decoding.fringes import Footprint, shading_shift
from scanner.decoding.fringes.footprint import TYPICAL_PX2, footprint_of, log_amplitude

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
