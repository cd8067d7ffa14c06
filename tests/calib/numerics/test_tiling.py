"""Parallel work in threads, and the parts that it is done in."""

import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.numerics import around, in_parallel, in_tiles, widened


def test_results_are_in_the_order_of_the_items() -> None:
    assert in_parallel(lambda item: item * item, range(1000)) == [item * item for item in range(1000)]


def test_parallel_work_may_be_nested() -> None:
    """More nested calls than threads, each of which would wait for another."""

    def row(number: int) -> int:
        return sum(in_parallel(lambda column: number * column, range(50)))

    assert in_parallel(row, range(64)) == [number * 1225 for number in range(64)]


def test_calls_share_one_thread_pool() -> None:
    def used(_: int) -> str:
        return threading.current_thread().name

    names = {name for _ in range(20) for name in in_parallel(used, range(20))}
    assert 1 <= len(names) <= (threading.active_count())


def test_an_error_is_raised_and_later_work_runs() -> None:
    def inverse(item: int) -> float:
        return 1 / item

    with pytest.raises(ZeroDivisionError):
        in_parallel(inverse, range(10))
    assert in_parallel(inverse, [1, 2, 4]) == [1.0, 0.5, 0.25]


def test_of_several_errors_the_first_item_s_is_raised() -> None:
    def fails(item: int) -> None:
        if item == 3:
            time.sleep(0.05)
        if item in (3, 4):
            raise ValueError(f"item {item}")

    with pytest.raises(ValueError, match="item 3"):
        in_parallel(fails, range(10))


@given(st.integers(1, 500), st.integers(1, 4000))
def test_tiles_cover_an_image_once(height: int, width: int) -> None:
    covered = np.zeros((height, width), np.uint8)

    def cover(rows: slice, columns: slice) -> tuple[int, int]:
        covered[rows, columns] += 1
        return rows.stop - rows.start, columns.stop - columns.start

    sizes = np.array(in_tiles((height, width), cover))
    assert (covered == 1).all()
    assert (sizes <= (120, 1224)).all()


@given(st.integers(0, 20), st.integers(1, 30), st.integers(0, 9), st.integers(40, 60))
def test_a_widened_part_holds_the_part(start: int, length: int, by: int, size: int) -> None:
    numbers = np.arange(size)
    part = slice(start, min(start + length, size))
    wide, inner = widened(part, by, size)
    np.testing.assert_array_equal(numbers[wide][inner], numbers[part])
    assert len(numbers[wide]) == min(part.stop + by, size) - max(start - by, 0)


def test_the_window_around_pixels_is_tight() -> None:
    pixels = np.zeros((9, 12), np.bool_)
    pixels[3, 5] = pixels[6, 2] = True
    assert around(pixels) == (slice(3, 7), slice(2, 6))
    assert around(pixels, 4) == (slice(0, 9), slice(0, 10))
