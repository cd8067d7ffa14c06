"""Real signals, sent to this process and handled in the main thread."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from threading import Condition, Event, Lock, Thread, get_ident

import pytest

from scanner.interruption import finishing, handlers_restored, interrupt, on_ending


@pytest.fixture(autouse=True)
def interrupted() -> Iterator[None]:
    with handlers_restored():
        on_ending(interrupt)
        yield


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_ending_signal_raises_keyboard_interrupt(number: int) -> None:
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), number)


def test_an_interrupt_swallowed_by_a_destructor_is_raised_again(capfd: pytest.CaptureFixture[str]) -> None:
    class Last:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.01)

    with pytest.raises(KeyboardInterrupt):  # noqa: PT012
        Last()
        time.sleep(1)
    assert capfd.readouterr().err == ""


def test_protected_work_is_finished_first() -> None:
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


def test_while_ending_further_signals_raise_nothing() -> None:
    with finishing(ending=True):
        os.kill(os.getpid(), signal.SIGINT)


def test_an_error_takes_precedence_over_an_interrupt() -> None:
    with pytest.raises(ZeroDivisionError), finishing():  # noqa: PT012
        os.kill(os.getpid(), signal.SIGINT)
        raise ZeroDivisionError


def test_handlers_are_restored() -> None:
    with handlers_restored():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        with finishing():
            os.kill(os.getpid(), signal.SIGHUP)  # as nohup has it
    assert signal.getsignal(signal.SIGHUP) is interrupt


def test_other_threads_leave_the_handlers_alone() -> None:
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


class LockTakenAsTheSignalComes:
    """Its __enter__ has no Python frame, like a lock's: the signal is handled in the frame of `threading`."""

    acquire = release = None
    __enter__ = partial(signal.raise_signal, signal.SIGTERM)

    def __init__(self) -> None:
        self.given_back = False

    def __exit__(self, *_: object) -> None:
        self.given_back = True


def test_a_lock_acquired_during_the_signal_is_released() -> None:
    lock = LockTakenAsTheSignalComes()
    with pytest.raises(KeyboardInterrupt), Condition(lock):  # type: ignore[arg-type]
        time.sleep(10)
    assert lock.given_back


def joined() -> None:
    thread = Thread(target=time.sleep, args=(3,), daemon=True)
    thread.start()
    thread.join()


def contended() -> None:
    lock = Lock()
    with lock, Condition(lock):
        raise AssertionError


@pytest.mark.parametrize("waiting", [lambda: Event().wait(3), joined, contended])
def test_waiting_is_interrupted(waiting: Callable[[], object]) -> None:
    main, begun_s = get_ident(), time.monotonic()

    def ask_to_end() -> None:
        time.sleep(0.1)
        signal.pthread_kill(main, signal.SIGTERM)

    Thread(target=ask_to_end).start()
    with pytest.raises(KeyboardInterrupt):
        waiting()
    assert 0.05 < time.monotonic() - begun_s < 2.5
