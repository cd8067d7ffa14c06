"""Ctrl-C, and what else asks a program to end (SIGTERM, a terminal that is closed): at any moment, any number of times.

While modules are loaded nothing has been made that could be lost, and the process ends at once. While a command runs,
all of them are KeyboardInterrupt. What must not be left half done waits for them to be over.
"""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

EXIT_INTERRUPTED = 130
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Handler = Callable[[int, FrameType | None], object]


def end_at_once(_number: int, _frame: FrameType | None) -> None:
    """A handler for as long as there is nothing to tidy up."""
    os.write(2, b"scan: interrupted\n")
    os._exit(EXIT_INTERRUPTED)


def interrupt(_number: int, _frame: FrameType | None) -> None:
    """A handler that raises KeyboardInterrupt, whichever signal it was."""
    raise KeyboardInterrupt


def ignore(_number: int, _frame: FrameType | None) -> None:
    """A handler for when everything has been said."""


def on_ending(handler: Handler) -> None:
    """Call this from now on; nothing changes outside of the main thread, or where signals are ignored, as by nohup."""
    if current_thread() is main_thread():
        for number in _ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler)


@contextmanager
def handlers_restored() -> Iterator[None]:
    """What the block sets by `on_ending` is as it was when it is over."""
    before = {number: signal.getsignal(number) for number in _ENDING}
    try:
        yield
    finally:
        if current_thread() is main_thread():
            for number, usual in before.items():
                signal.signal(number, usual)


@contextmanager
def finishing(*, ending: bool = False) -> Iterator[None]:
    """The block is not interrupted: what came meanwhile comes after it, if it ends well.

    `ending`: the program is on its way out already, so that nothing need come any more.
    """
    came: list[int] = []
    with handlers_restored():
        on_ending(lambda number, _: came.append(number))
        yield
    if came and not ending:
        signal.raise_signal(came[0])
