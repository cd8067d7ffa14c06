"""The program's log: one file in each result."""

import logging
from pathlib import Path

_LOGGERS = ("scanner", "hw", "calib", "py.warnings")


def keep_off_the_terminal() -> None:
    """Where no file takes the log, what is logged as a warning is not printed either: commands say what matters."""
    for name in _LOGGERS:
        logging.getLogger(name).addHandler(logging.NullHandler())


class LogFile:
    """What the program logs while the `with` block runs, Python's warnings, and the error that ends it, in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        self._handler = logging.FileHandler(self._path, encoding="utf-8")
        self._handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        logging.captureWarnings(True)
        for name in _LOGGERS:
            logger = logging.getLogger(name)
            logger.setLevel(logging.INFO)
            logger.addHandler(self._handler)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if error is not None:
            logging.getLogger("scanner").error("ended by %s", type(error).__name__, exc_info=error)
        for name in _LOGGERS:
            logging.getLogger(name).removeHandler(self._handler)
        logging.captureWarnings(False)
        self._handler.close()
