"""Machine code of compiled functions by Numba, and its cache: in the user's cache folder, keyed by its dependencies.

What loads this module loads Numba: `jit.py` does, when a compiled function is called for the first time.

The cache is not next to the sources: a package may be installed in a read-only place, and removing a copy of it would
leave folders that contain only machine code, which Python takes for packages.

The folder's name is a digest of all dependencies of the machine code that Numba does not check itself: the source
file, those of compiled functions of other files that it calls, its module's name, the options of compilation, the
versions of Numba and NumPy, the processor. Copies of the same source share it; another version has a folder of its
own, so several on one machine do not overwrite each other's.
"""

import hashlib
import inspect
import logging
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np
import platformdirs
from numba.core import caching, config, event, sigutils
from numba.extending import typeof_impl

from calib.numerics.jit import Compiled

log = logging.getLogger(__name__)

# Allows reordered sums and fused multiply-add; infinities and NaN keep their meaning.
_ARITHMETIC = ("contract", "nsz", "reassoc")

# Machine code unused for this long is deleted; use is recorded by the day.
_KEPT_S, _DAY_S = 60 * 86400.0, 86400.0


def dispatcher_of(function: Callable[..., object], *, inline: bool) -> Any:
    """Numba's function, which compiles `function` for each combination of types that its cache does not have."""
    options = f"{_ARITHMETIC} numpy {'inlined' if inline else ''}"
    fast = numba.njit(nogil=True, fastmath=set(_ARITHMETIC), error_model="numpy", forceinline=inline)(function)
    if not config.DISABLE_JIT:
        with suppress(OSError):  # no source, or no folder to keep machine code in
            setattr(fast, "_cache", MachineCode(function, options))  # noqa: B010, the type has none
    return fast


def _type_of(function: Compiled, context: object) -> object:
    """The type that Numba gives to a compiled function that another one calls."""
    return typeof_impl(function.dispatcher, context)


typeof_impl.register(Compiled, _type_of)


def announce(announcements: list[Callable[[], None]]) -> None:
    """Call each of `announcements`, which leave the list, once: when something has to be compiled."""
    while announcements:
        event.register("numba:compile", _First(announcements.pop()))  # type: ignore[no-untyped-call]


class _First(event.Listener):
    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell: Callable[[], None] | None = tell

    def on_start(self, _event: event.Event) -> None:
        tell, self._tell = self._tell, None
        if tell is not None:
            tell()

    def on_end(self, _event: event.Event) -> None:
        """Do nothing: the call was made at the start."""


class MachineCode(caching.FunctionCache):  # type: ignore[misc]
    """Numba's cache of one function, compiled with `options`; damaged or unwritable files are ignored.

    Raises OSError if there is no source or no folder for the cache.
    """

    def __init__(self, function: Callable[..., object], options: str) -> None:
        self._impl_class = partial(_Files, locator=_Locator(function, options))
        super().__init__(function)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code compiled for these types, or None."""
        try:
            code = super().load_overload(sig, target_context)
        except Exception as error:  # unpickling damaged files may raise anything
            log.debug("%s: machine code is damaged and compiled anew: %r", self.cache_path, error)
            with suppress(OSError):
                self.flush()
            return None
        # Two processes that write at the same time may have stored one's code under the other's name.
        fits = code is not None and tuple(code.signature.args) == tuple(sigutils.normalize_signature(sig)[0])
        return code if fits else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store compiled code."""
        try:
            super().save_overload(sig, data)
        except OSError as error:  # disk full or read-only: only the next start takes longer
            log.debug("%s: machine code is not kept: %s", self.cache_path, error)
        _forget_unused(Path(self.cache_path).parent)


class _Files(caching.CompileResultCacheImpl):  # type: ignore[misc]
    def __init__(self, function: Callable[..., object], locator: "_Locator") -> None:
        self._locator_classes = (locator,)
        super().__init__(function)


class _Locator(caching._CacheLocator):  # type: ignore[misc]
    """Tells Numba the cache's location, through the interface of Numba's own locator classes."""

    def __init__(self, function: Callable[..., object], options: str) -> None:
        self._line = function.__code__.co_firstlineno
        self._py_file = inspect.getfile(function)  # Numba's warnings name it
        self._digest = _digest(_sources(function), function.__module__, options)
        self._folder = root() / self._digest
        _note_use(self._folder)

    def from_function(self, *_: object) -> "_Locator":
        return self

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._digest

    def get_disambiguator(self) -> str:
        return str(self._line)


def root() -> Path:
    """Return the folder of all machine code, below NUMBA_CACHE_DIR if set. Raises OSError for a user without home."""
    asked = config.CACHE_DIR
    folder = Path(asked, "roomscan").absolute() if asked else platformdirs.user_cache_path("roomscan", appauthor=False)
    if not folder.is_absolute():
        raise FileNotFoundError(f"{folder}: no folder for caches")
    return folder / "machine-code"


def _sources(function: Callable[..., object]) -> tuple[Path, ...]:
    """Return the file of a function and those of the compiled functions that it calls, recursively."""
    sources = {Path(inspect.getfile(function)): None}
    for name in function.__code__.co_names:
        called = getattr(function.__globals__.get(name), "py_func", None)
        if called is not None and called is not function:
            sources |= dict.fromkeys(_sources(called))
    return tuple(sources)


@cache
def _digest(sources: tuple[Path, ...], module: str, options: str) -> str:
    parts = (*(source.read_bytes() for source in sources), module.encode(), options.encode(), _machine().encode())
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()[:24]


@cache
def _machine() -> str:
    features = llvmlite.binding.get_host_cpu_features().flatten()
    return f"{numba.__version__} {np.__version__} {llvmlite.binding.get_host_cpu_name()} {features}"


@cache
def _note_use(folder: Path) -> None:
    with suppress(OSError):
        if time.time() - folder.stat().st_mtime > _DAY_S:
            os.utime(folder)


@cache
def _forget_unused(everything: Path) -> None:
    with suppress(OSError):
        for folder in everything.iterdir():
            if time.time() - folder.stat().st_mtime > _KEPT_S:
                shutil.rmtree(folder, ignore_errors=True)
