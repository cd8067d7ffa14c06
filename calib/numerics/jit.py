"""Loops over pixels and matches, compiled to machine code by Numba.

NumPy passes over memory once for every operation. If a result needs dozens of operations per pixel or match, a compiled
loop does all of them in one pass and is many times as fast.

The machine code is stored in the user's cache folder (`code_cache.py`), so only the first run after a change waits for
the compiler. Code is recompiled only when the function's file changes, or that of a compiled function that it calls.
Everything else that a compiled function uses must be in its own file or an argument (a test checks this).
"""

from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar, cast

from numba import njit
from numba.core import config, event

from calib.numerics.code_cache import MachineCode

Function = TypeVar("Function", bound=Callable[..., object])

# Allows reordered sums and fused multiply-add; infinities and NaN keep their meaning.
_ARITHMETIC = ("contract", "nsz", "reassoc")


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays, at its first call, for the types of its arguments.

    Threads run it side by side (`calib.numerics.tiling.in_pieces`); a division by zero gives infinity, as in NumPy.
    """
    return _compiled(function, inline=False)


def inlined(function: Function) -> Function:
    """Like `compiled`, for a function of numbers that others call in their loops: these are vectorised only if it
    becomes part of them.
    """
    return _compiled(function, inline=True)


def _compiled(function: Function, *, inline: bool) -> Function:
    options = f"{_ARITHMETIC} numpy {'inlined' if inline else ''}"
    fast = njit(nogil=True, fastmath=set(_ARITHMETIC), error_model="numpy", forceinline=inline)(function)
    if not config.DISABLE_JIT:
        with suppress(OSError):  # no source, or no folder to keep machine code in
            setattr(fast, "_cache", MachineCode(function, options))  # noqa: B010, the type has none
    return cast(Function, fast)


def when_compiling(tell: Callable[[], None]) -> None:
    """Call `tell` once, when something has to be compiled because its machine code is not cached."""
    event.register("numba:compile", _First(tell))  # type: ignore[no-untyped-call]


class _First(event.Listener):
    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell: Callable[[], None] | None = tell

    def on_start(self, _event: event.Event) -> None:
        tell, self._tell = self._tell, None
        if tell is not None:
            tell()

    def on_end(self, _event: event.Event) -> None:
        """Do nothing: the call was made at the start."""
