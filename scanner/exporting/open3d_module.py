"""Open3D, or what to do where it cannot be loaded."""

from typing import Any

from calib import open3d_module
from scanner.errors import InputError


def open3d() -> Any:
    """The module, which has no types. Raises InputError that says what to install if it cannot be loaded."""
    try:
        return open3d_module.open3d()
    except ImportError as error:
        raise InputError(str(error)) from error
