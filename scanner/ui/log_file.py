"""The program's log: one file in each result."""

import logging
import sys
from pathlib import Path

from scanner.ui.terminal import for_screen

_LOGGERS = ("scanner", "hw", "calib", "py.warnings")


def keep_off_the_terminal() -> None:
    """Keep logged warnings off the terminal even without a log file: commands print what matters."""
    for name in _LOGGERS:
        logging.getLogger(name).addHandler(logging.NullHandler())


class _Handler(logging.FileHandler):
    """Reports once that the log cannot be written: the operation may succeed, or will raise its own error."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, encoding="utf-8")
        self._failed = False

    def handleError(self, _: logging.LogRecord) -> None:  # noqa: N802
        """Called in the place of an error that ends `emit`."""
        self._tell(sys.exc_info()[1])

    def close(self) -> None:
        """What could not be written is still in the buffer, and fails again."""
        try:
            super().close()
        except OSError as error:
            self._tell(error)

    def _tell(self, error: BaseException | None) -> None:
        if not self._failed:
            message = f"scan: {self.baseFilename}: the log cannot be written: {error}"
            print(for_screen(message, sys.stderr), file=sys.stderr)
        self._failed = True


class LogFile:
    """A file that receives the program's log, Python's warnings, and the error that ends the `with` block."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        self._handler = _Handler(self._path)
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
