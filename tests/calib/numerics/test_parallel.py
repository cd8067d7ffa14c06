"""Parallel work in threads."""

import threading
import time

import pytest

from calib.numerics import in_parallel


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
