"""The application: patterns, capture, decoding, reconstruction, report and the command line.

The names below are what other programs use; each is imported when it is first asked for. docs/api.md shows them.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scanner.configuration import Config as Config
    from scanner.configuration import load_config as load_config
    from scanner.errors import InputError as InputError
    from scanner.errors import StorageError as StorageError
    from scanner.jobs import calibrate as calibrate
    from scanner.jobs import replay as replay
    from scanner.jobs import resume as resume
    from scanner.jobs import scan as scan
    from scanner.results import FinishedScan as FinishedScan
    from scanner.results import Scan as Scan
    from scanner.results import read_finished_scan as read_finished_scan

# The most pixels of an image, also for OpenCV, which reads this when it is loaded (see scanner/io/given_file.py).
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "225000000")

_HOMES = {
    "configuration": "Config load_config",
    "errors": "InputError StorageError",
    "jobs": "calibrate replay resume scan",
    "results": "FinishedScan Scan read_finished_scan",
}
_HOME = {name: home for home, names in _HOMES.items() for name in names.split()}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'scanner' has no attribute '{name}'")
    return getattr(import_module(f"scanner.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
