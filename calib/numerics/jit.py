"""Loops over pixels and matches, compiled to machine code by Numba.

NumPy passes over memory once for every operation. If a result needs dozens of operations per pixel or match, a compiled
loop does all of them in one pass and is many times as fast.

Numba is loaded by the first call of any of them, not with the program, whose start it would double.

The machine code is stored in the user's cache folder (`machine_code.py`): only the first run after a change waits for
the compiler. Code is recompiled only when the function's file changes, or that of a compiled function that it calls.
Everything else that a compiled function uses must be in its own file or an argument (a test checks this).
"""

from collections.abc import Callable
from functools import update_wrapper
from threading import Lock
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])

_LOCK = Lock()
_announcements: list[Callable[[], None]] = []


class Compiled:
    """A function that its first call compiles, or reads from the cache."""

    def __init__(self, function: Callable[..., object], *, inline: bool) -> None:
        self.py_func = function
        """As it was written."""
        self.inline = inline
        """Whether it becomes part of the compiled functions that call it."""
        self._dispatcher: Any = None
        update_wrapper(self, function)

    def __call__(self, *arguments: object) -> object:
        """Return what the machine code returns."""
        return (self._dispatcher or self.dispatcher)(*arguments)

    @property
    def dispatcher(self) -> Any:
        """Numba's function, which compiles for each new combination of types."""
        with _LOCK:
            if self._dispatcher is None:
                from calib.numerics import machine_code

                machine_code.announce(_announcements)
                self._dispatcher = machine_code.dispatcher_of(self.py_func, inline=self.inline)
        return self._dispatcher


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays, at its first call, for the types of its arguments.

    Threads run it side by side (`calib.numerics.tiling.in_pieces`); a division by zero gives infinity, as in NumPy.
    """
    return cast(Function, Compiled(function, inline=False))


def inlined(function: Function) -> Function:
    """Like `compiled`, for a function of numbers that others call in their loops: these are vectorised only if it
    becomes part of them.
    """
    return cast(Function, Compiled(function, inline=True))


def when_compiling(tell: Callable[[], None]) -> None:
    """Call `tell` once, when something has to be compiled because its machine code is not cached."""
    _announcements.append(tell)
