"""Lazy import of Open3D, which takes seconds and needs system libraries."""

from importlib import import_module
from typing import Any

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
