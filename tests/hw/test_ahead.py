"""An iterator that runs ahead in its own thread."""

import threading
import time
from collections.abc import Iterator

import pytest

from hw.ahead import Ahead, in_background


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
