"""Ctrl-C, and what else asks a program to end (SIGTERM, a terminal that is closed): at any moment, any number of times.

While modules are loaded nothing has been made that could be lost, and the process ends at once. While a command runs,
all of them are KeyboardInterrupt. What must not be left half done waits for them to be over.
"""

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

EXIT_INTERRUPTED = 130
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Functions of `threading` that may wait long; others hold a lock for microseconds.
_WAITING = {"wait", "join", "_wait_for_tstate_lock"}
_AGAIN_S, _MOST_PUT_OFF = 0.002, 100
_put_off: list[tuple[str, int]] = []  # places where the delayed interruption has found the main thread so far

Handler = Callable[[int, FrameType | None], object]


def end_at_once(_number: int, _frame: FrameType | None) -> None:
    """A handler for as long as there is nothing to tidy up."""
    os.write(2, b"scan: interrupted\n")
    os._exit(EXIT_INTERRUPTED)


def interrupt(number: int, frame: FrameType | None) -> None:
    """A handler that raises KeyboardInterrupt for any signal.

    It is delayed while `threading` acquires a lock for the `with` of a condition, a semaphore, an event or a thread
    pool: otherwise the lock would never be released, and its next user would wait forever.
    """
    if _among_locks(frame):
        _thread.start_new_thread(_signal_again, (number,))  # takes no lock of `threading`
        return
    _put_off.clear()
    raise KeyboardInterrupt


def _among_locks(frame: FrameType | None) -> bool:
    """Whether the main thread, which executes `frame`, is within `threading` and does not just wait there."""
    if frame is None or frame.f_globals is not vars(threading):
        return False
    place = frame.f_code.co_name, frame.f_lasti
    waits = frame.f_code.co_name in _WAITING and place in _put_off[-1:]  # it was already there at the last attempt
    _put_off.append(place)
    return not waits and len(_put_off) < _MOST_PUT_OFF


def _signal_again(number: int) -> None:
    time.sleep(_AGAIN_S)
    thread = main_thread().ident
    if thread is not None and callable(signal.getsignal(number)):
        signal.pthread_kill(thread, number)


def _swallowed(what: "sys.UnraisableHookArgs") -> None:
    """Repeat an interruption a moment later if it came where nothing can be raised: in a destructor, or in a callback
    from C.
    """
    if issubclass(what.exc_type, KeyboardInterrupt):
        _thread.start_new_thread(_signal_again, (signal.SIGINT,))
    else:
        sys.__unraisablehook__(what)


def on_ending(handler: Handler | signal.Handlers) -> None:
    """Call this from now on; nothing changes outside of the main thread, or where signals are ignored, as by nohup."""
    if current_thread() is main_thread():
        for number in _ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler)


@contextmanager
def handlers_restored() -> Iterator[None]:
    """Restore on exit the handlers that the block sets by `on_ending`."""
    before = {number: signal.getsignal(number) for number in _ENDING}
    hook, sys.unraisablehook = sys.unraisablehook, _swallowed
    try:
        yield
    finally:
        sys.unraisablehook = hook
        if current_thread() is main_thread():
            for number, usual in before.items():
                signal.signal(number, usual)


@contextmanager
def finishing(*, ending: bool = False) -> Iterator[None]:
    """Defer interruptions until the block ends; one that arrived meanwhile is delivered if the block succeeds.

    `ending`: the program is ending anyway, so that no interruption is delivered.
    """
    came: list[int] = []
    with handlers_restored():
        on_ending(lambda number, _: came.append(number))
        yield
    if came and not ending:
        signal.raise_signal(came[0])
