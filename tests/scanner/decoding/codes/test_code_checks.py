"""Changes of single bits between neighbouring pixels, which show frames of codes that were exchanged."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from scanner.decoding.codes.code_checks import _changes, _note_changes
from scanner.decoding.light import NoiseModel
from tests.scanner.decoding.codes.test_gray_code import SHAPE, gray_fold

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
