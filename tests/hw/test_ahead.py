"""An iterator that runs ahead in its own thread."""

import threading
import time
from collections.abc import Iterator

import pytest

from hw.ahead import Ahead, in_background, prefetched


def numbers(count: int, made: list[int], closed: list[bool]) -> Iterator[int]:
    for number in range(count):
        made.append(number)
        yield number
    closed.append(True)


def test_all_items_come_in_order() -> None:
    made, closed = list[int](), list[bool]()
    assert list(Ahead(numbers(20, made, closed), 3)) == list(range(20))
    assert closed == [True]


def test_the_number_of_items_made_ahead_is_limited() -> None:
    made = list[int]()
    ahead = Ahead(numbers(20, made, []), 3)
    items = iter(ahead)
    assert made == []
    next(items)
    until = time.monotonic() + 10
    while len(made) < 3 and time.monotonic() < until:
        time.sleep(0.001)
    time.sleep(0.02)
    assert made == [0, 1, 2]  # the first is still in the hands of who asked for it
    assert list(items) == list(range(1, 20))
    assert ahead.waited_s > 0.01


def test_an_error_is_raised_after_the_items_before_it() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("the second")

    found = iter(Ahead(items(), 5))
    assert next(found) == 1
    with pytest.raises(ValueError, match="the second"):
        next(found)


def test_leaving_the_loop_waits_for_the_thread() -> None:
    before = threading.active_count()
    made = list[int]()
    items = iter(Ahead(numbers(10**9, made, []), 4))
    next(items)
    del items
    assert threading.active_count() == before
    assert len(made) <= 5


def test_another_thread_can_stop_it() -> None:
    before = threading.active_count()
    made, closed = list[int](), list[bool]()

    def items() -> Iterator[int]:
        try:
            yield from numbers(10**9, made, [])
        finally:
            closed.append(True)

    ahead = Ahead(items(), 4)
    ahead.stop()  # it has not begun
    ahead = Ahead(items(), 4)
    asking = iter(ahead)
    next(asking)
    ahead.stop()
    assert closed == [True]
    assert threading.active_count() == before
    ahead.stop()


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 20])
def test_results_come_in_order_however_long_each_takes(threads: int, count: int) -> None:
    def slow_if_even(number: int) -> int:
        time.sleep(0.002 * (number % 2 == 0))
        return number * number

    assert list(prefetched(slow_if_even, range(count), threads)) == [number * number for number in range(count)]


def test_results_are_computed_side_by_side_and_no_more_than_asked_for() -> None:
    begun, both = list[int](), threading.Barrier(2, timeout=10)

    def meet(number: int) -> int:
        begun.append(number)
        both.wait()  # passes only if another one runs at the same time
        return number

    results = prefetched(meet, range(4), 2)
    assert next(results) == 0
    assert len(begun) <= 3
    assert list(results) == [1, 2, 3]


def test_a_failed_result_is_raised_in_its_place_and_ends_the_work() -> None:
    begun = list[int]()

    def fails_at_three(number: int) -> int:
        begun.append(number)
        if number == 3:
            raise ValueError("the fourth")
        return number

    before = threading.active_count()
    results = prefetched(fails_at_three, range(100), 2)
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="the fourth"):
        next(results)
    assert threading.active_count() == before
    assert 4 <= len(begun) <= 6


def test_background_work_is_done_in_order_and_by_the_end() -> None:
    done = list[int]()

    def work(number: int) -> None:
        time.sleep(0.002)
        done.append(number)

    with in_background(work, 3) as begin:
        for number in range(10):
            begin(number)
            assert number - len(done) < 3 + 1
    assert done == list(range(10))


def test_an_error_in_background_work_is_raised() -> None:
    def work(number: int) -> None:
        if number == 1:
            raise ValueError("the second")

    def all_of(numbers: int, then: type[BaseException] | None = None) -> None:
        with in_background(work) as begin:
            for number in range(numbers):
                begin(number)
            if then is not None:
                raise then

    with pytest.raises(ValueError, match="the second"):
        all_of(2)
    with pytest.raises(ValueError, match="the second"):
        all_of(10)
    with pytest.raises(KeyError):
        all_of(1, then=KeyError)
