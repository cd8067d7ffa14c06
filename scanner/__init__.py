"""The application: patterns, capture, decoding, reconstruction, report and the command line.

The names below are what other programs use; each is imported when it is first asked for. docs/api.md shows them.
"""

import os
from typing import TYPE_CHECKING

from calib.deferred_imports import defer_imports

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

__all__, __getattr__, __dir__ = defer_imports(
    __name__,
    {
        "configuration": "Config load_config",
        "errors": "InputError StorageError",
        "jobs": "calibrate replay resume scan",
        "results": "FinishedScan Scan read_finished_scan",
    },
)
