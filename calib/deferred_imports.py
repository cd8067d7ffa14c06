"""Imports at the time of first use: packages whose names are imported when asked for (PEP 562), and Open3D.

Open3D takes seconds and needs system libraries.
"""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def defer_imports(
    package: str, homes: Mapping[str, str]
) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """`__all__`, `__getattr__` and `__dir__` of `package`, which offers what its modules hold without loading them.

    `homes` has the names that each module offers, between spaces: {"geometry": "Corner Matches"}. None may be the name
    of a module of the package, which would take its place. A type checker does not see them: the package imports them
    under `TYPE_CHECKING` as well.
    """
    home_of = {name: home for home, names in homes.items() for name in names.split()}

    def get(name: str) -> object:
        if name not in home_of:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(f"{package}.{home_of[name]}"), name)

    return sorted(home_of), get, lambda: sorted({*vars(sys.modules[package]), *home_of})


# What its wheels are linked against (Debian, Ubuntu).
DEBIAN_PACKAGES = ("libgl1", "libegl1", "libx11-6", "libusb-1.0-0", "libudev1", "libidn2-0", "libgomp1")


def open3d() -> Any:
    """Return the (untyped) module. Raises ImportError that says what to install if it cannot be loaded."""
    try:
        module = import_module("open3d")
    except (ImportError, OSError) as error:
        raise ImportError(
            f"Open3D cannot be loaded ({error}). It needs libraries of the system: apt-get install "
            f"{' '.join(DEBIAN_PACKAGES)}, or their like"
        ) from error
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return module
