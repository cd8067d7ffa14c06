"""Signals, as they are: raised to this process, in the main thread."""

import os
import signal
from collections.abc import Iterator
from threading import Thread

import pytest

from scanner.interruption import finishing, handlers_restored, interrupt, on_ending


@pytest.fixture(autouse=True)
def interrupted() -> Iterator[None]:
    with handlers_restored():
        on_ending(interrupt)
        yield


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_whatever_asks_to_end_is_an_interruption(number: int) -> None:
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), number)


def test_what_must_be_whole_is_finished_first() -> None:
    done = []

    def work() -> None:
        with finishing():
            os.kill(os.getpid(), signal.SIGTERM)
            done.append("first half")
            os.kill(os.getpid(), signal.SIGINT)
            done.append("second half")
        done.append("never")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["first half", "second half"]


def test_on_the_way_out_nothing_more_is_raised() -> None:
    with finishing(ending=True):
        os.kill(os.getpid(), signal.SIGINT)


def test_an_error_comes_before_an_interruption() -> None:
    with pytest.raises(ZeroDivisionError), finishing():  # noqa: PT012
        os.kill(os.getpid(), signal.SIGINT)
        raise ZeroDivisionError


def test_handlers_are_put_back() -> None:
    with handlers_restored():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        with finishing():
            os.kill(os.getpid(), signal.SIGHUP)  # as nohup has it
    assert signal.getsignal(signal.SIGHUP) is interrupt


def test_other_threads_have_no_part_in_it() -> None:
    failed: list[BaseException] = []

    def work() -> None:
        try:
            with handlers_restored(), finishing():
                on_ending(interrupt)
        except BaseException as error:
            failed.append(error)

    thread = Thread(target=work)
    thread.start()
    thread.join()
    assert failed == []
