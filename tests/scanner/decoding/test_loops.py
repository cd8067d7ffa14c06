"""Compiled loops over pixels, compared with NumPy or with a known case."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calib.numerics import Image
from scanner.decoding.axis_decoder import _measure
from scanner.decoding.checks.code_checks import _changes, _note_changes
from scanner.decoding.codes import CodeWords
from scanner.decoding.fringes import Footprint, shading_shift
from scanner.decoding.fringes.phase_unwrapping import Disagreements, measured_tolerances, widest_tolerances
from scanner.decoding.light import NoiseModel
from scanner.decoding.planning import plan_sequence
from scanner.patterns import Pattern, gray_sequence, phase_sequence

SHAPE = (3, 4)


def gray_fold(images: list[Image], *, half: bool) -> CodeWords:
    """Fold a code of two bits, each brighter in its first image than in its second; `half`: which is its threshold."""
    bits = [*gray_sequence("x", 4, 1, inverses=not half), *gray_sequence("y", 4, 1)]
    (code,) = plan_sequence(bits, (4, 4)).x.codes
    fold = CodeWords(code, SHAPE, images[0].dtype, contrast=True)
    if half:
        fold.fill(dict(zip(code.frames, images[::2], strict=True)), dict(zip(code.frames, images[1::2], strict=True)))
    else:
        fold.fill(dict(zip(code.frames, images, strict=True)), {})
    return fold


@pytest.mark.parametrize("half", [False, True])
@given(frames=arrays.arrays(np.uint8, (4, *SHAPE)))
def test_a_code_keeps_its_smallest_and_largest_difference(frames: Image, half: bool) -> None:
    fold = gray_fold(list(frames), half=half)
    one, other = frames[::2].astype(int), frames[1::2].astype(int)
    difference = np.minimum((1 + half) * np.abs(one - other), 255)
    if half:
        difference[np.abs(one - other) > 127] = 255
    np.testing.assert_array_equal(fold.least, difference.min(axis=0))
    np.testing.assert_array_equal(fold.contrast, difference.max(axis=0))
    bits = (one > other).astype(int)
    np.testing.assert_array_equal(fold.words, 2 * bits[0] + bits[1])


@pytest.mark.parametrize(("steps", "dtype"), [(3, np.uint8), (4, np.uint16), (5, np.float32)])
def test_positions_are_those_of_the_fringe(steps: int, dtype: np.dtype) -> None:
    """At more pixels than are measured at once."""
    (fringe, *_) = plan_sequence([*phase_sequence("x", 40, steps), *phase_sequence("y", 40, steps)], (40, 40)).fringes
    place = np.random.default_rng(0).uniform(0.2, 39.8, 5000)
    angle = 2 * np.pi * (place[None] / 40 + np.array(fringe.shifts)[:, None])
    levels = (110 + 100 * np.cos(angle)).astype(dtype)
    level = np.full(len(place), 110, np.float32)
    variance, position = np.empty((2, len(place)), np.float32)
    per_radian = np.float32(40 / (2 * np.pi))
    _measure(levels, fringe.weights32, level, np.float32(1), np.float32(0.1), per_radian, variance, position)
    assert np.abs(position - place).max() < 0.1
    assert variance == pytest.approx(np.full(len(place), 12e-4), rel=0.03)


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


WORDS = arrays.arrays(np.uint32, (2, 30), elements=st.integers(0, 7))
CHOSEN = arrays.arrays(np.bool_, (2, 30))


@given(WORDS, CHOSEN)
def test_changes_between_certain_pixels(words: np.ndarray, certain: np.ndarray) -> None:
    before, after = np.empty((2, words.size), np.uint32)
    single, changes = _note_changes(words, certain, 16, before, after)
    pairs = [
        (int(line[i]), int(line[j]))
        for line, there in zip(words, certain, strict=True)
        for i, j in pairwise(np.flatnonzero(there))
        if j - i <= 16 and line[i] != line[j]
    ]
    alone = [(a, b) for a, b in pairs if (a ^ b).bit_count() == 1]
    assert changes == len(pairs)
    assert list(zip(before[:single].tolist(), after[:single].tolist(), strict=True)) == alone


@pytest.mark.parametrize(("gain", "is_certain"), [(0.0, True), (0.3, True), (0.7, False)])
def test_only_bits_that_stand_out_of_the_noise_are_compared(gain: float, is_certain: bool) -> None:
    # Bits differ by 20 levels at a level of 50; the noise of a difference is √(2 gain 50): 0, 5.5 and 8.4 levels, of
    # which three times is 0, 16.4 and 25.1.
    bright, dark = np.full(SHAPE, 60, np.uint8), np.full(SHAPE, 40, np.uint8)
    left = np.arange(SHAPE[1]) < 2
    fold = gray_fold([np.where(left, bright, dark), np.where(left, dark, bright), bright, dark], half=False)
    middle, brightest = np.full((2, *SHAPE), [[[50]], [[60]]], np.uint8)
    found, _ = _changes(fold, NoiseModel(1e-6, gain), middle, brightest, None)
    assert found.bit.tolist() == ([0, 0, 0] if is_certain else [])  # bit 0, once in each row


def test_bits_beyond_the_picture_are_not_compared() -> None:
    """One row has a fifth of the swing of lit pixels, as a camera with adaptive tone mapping leaves outside the
    picture.
    """
    bright, dark = np.full(SHAPE, 60, np.uint8), np.full(SHAPE, 40, np.uint8)
    left = np.arange(SHAPE[1]) < 2
    fold = gray_fold([np.where(left, bright, dark), np.where(left, dark, bright), bright, dark], half=False)
    middle, brightest = np.full((2, *SHAPE), [[[50]], [[60]]], np.uint8)
    brightest[1] = 52
    found, _ = _changes(fold, NoiseModel(1e-6, 0.0), middle, brightest, None)
    assert len(found.bit) == SHAPE[0] - 1


@pytest.mark.parametrize(
    ("cell", "outside_px", "interval_px"),
    [
        (16, 0.6, 0.6),  # as measured
        (16, 0.01, 0.1),  # a tenth of a pixel at least
        (64, 0.01, 0.32),  # or a two-hundredth of a cell
        (16, 50.0, np.inf),  # and no more than separates orders
    ],
)
def test_the_tolerance_of_an_interval_is_relative_to_its_bounds(
    cell: int, outside_px: float, interval_px: float
) -> None:
    patterns: list[Pattern] = [
        *gray_sequence("x", 1024, cell),
        *phase_sequence("x", 4 * cell, 4),
        *gray_sequence("y", 8, 1),
    ]
    plan = plan_sequence(patterns, (1024, 8)).x
    rng = np.random.default_rng(0)
    outside = np.concatenate([np.abs(rng.normal(0, outside_px, 20_000)), np.zeros(30_000)]).astype(np.float32)
    found = Disagreements(outside, np.zeros((0, len(outside)), np.float32))
    tolerances = measured_tolerances(plan, found, np.zeros((1, len(outside)), np.float32))
    expected = min(interval_px, widest_tolerances(plan).interval_px)
    assert tolerances.interval_px == pytest.approx(expected, rel=0.02)
