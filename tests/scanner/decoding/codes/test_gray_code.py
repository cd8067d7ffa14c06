"""Gray codes: how frames are folded into words, their cell numbers, and the intervals that several codes leave."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calib.numerics import Image
from scanner.decoding import PixelFlags, plan_sequence
from scanner.decoding.codes import CodeWords, cell_numbers, interval_of
from scanner.patterns import Gray, gray_sequence

SHAPE = (3, 4)


@given(st.integers(0, 2**32 - 1))
def test_cell_numbers_follow_the_pattern(n: int) -> None:
    assert cell_numbers(np.array([n ^ n >> 1], np.uint32))[0] == n


@given(cell=st.integers(1, 40), offset=st.integers(0, 100), length=st.integers(50, 700))
def test_the_interval_of_a_word_holds_the_pixel_that_shows_it(cell: int, offset: int, length: int) -> None:
    bits = int((length - 1 + offset) // cell).bit_length() or 1
    code = tuple(Gray("x", bit, bits, cell, offset) for bit in range(bits))
    plan = plan_sequence((*code, *gray_sequence("y", 8, 1)), (length, 8)).x
    x = np.arange(length, dtype=np.float64)
    word = np.sum([(p.brightness(x, x) > 0.5).astype(np.uint32) << (bits - 1 - p.bit) for p in code], axis=0)
    interval = interval_of(plan, [word.astype(np.uint32)], length)
    assert np.all(x >= interval.low + 0.5 - 1e-3)
    assert np.all(x <= interval.high - 0.5 + 1e-3)
    assert interval.possible.all()
    assert np.all(interval.high - interval.low <= cell)


def test_contradicting_codes_are_noted() -> None:
    codes = [Gray("x", bit, 6, 8, offset) for offset in (0, 4) for bit in range(6)]
    plan = plan_sequence([*codes, *gray_sequence("y", 8, 1)], (300, 8)).x
    # Cells 3 (24 to 31) and 3 or 4 (20 to 27, 28 to 35) overlap, cell 6 (44 to 51) overlaps neither; cell 40 begins at
    # 320.
    cells = np.array([[3, 3, 3, 40], [3, 4, 6, 40]], np.uint32)
    interval = interval_of(plan, list(cells ^ cells >> 1), 4)
    assert interval.flags[:3].tolist() == [0, 0, PixelFlags.CONTRADICTORY]
    assert (interval.flags & PixelFlags.OUTSIDE).tolist() == [0, 0, 0, PixelFlags.OUTSIDE]
    assert interval.low[:2].tolist() == [23.5, 27.5]
    assert interval.high[:2].tolist() == [27.5, 31.5]


def test_cells_of_two_codes_that_only_touch_leave_a_cell() -> None:
    codes = [Gray("x", bit, 6, 8, offset) for offset in (0, 8) for bit in range(6)]
    plan = plan_sequence([*codes, *gray_sequence("y", 8, 1)], (300, 8)).x
    # Cell 3 (24 to 31) is cell 4 of the second code, whose cell 5 begins where it ends.
    cells = np.array([[3, 3], [4, 5]], np.uint32)
    interval = interval_of(plan, list(cells ^ cells >> 1), 2)
    assert interval.possible.all()
    np.testing.assert_allclose(interval.variance(plan.cell), 64 / 12, rtol=1e-6)
    assert interval.centre.tolist() == [27.5, 31.5]


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
