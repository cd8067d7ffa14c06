"""The message and the exit code of an error, the same in the terminal and in the console."""

import tempfile
import traceback
from dataclasses import dataclass

from calib.refusal import RefusalError
from hw.errors import DeviceError
from scanner.errors import GradeError, InputError, is_of_memory, is_of_the_disk, is_of_threads
from scanner.interruption import EXIT_INTERRUPTED
from scanner.shown_text import harmless, shortened

_MOST_LINES, _LONGEST_LINE = 100, 1000

_NO_THREAD = (
    "the system allows no further thread: raise the limit of memory (ulimit -v) or of processes (ulimit -u, or the "
    "container's), or close other programs"
)

EXIT_DIFFERENT = 1  # as of diff: two calibrations that were compared
EXIT_INPUT = 2
EXIT_DEVICE = 3
EXIT_REFUSED = 4
EXIT_BUG = 70  # EX_SOFTWARE of sysexits.h


@dataclass(frozen=True)
class Failure:
    """`message` is for a person, of one or more lines."""

    exit_code: int
    message: str


def failure_of(error: BaseException) -> Failure:
    """Return the message and exit code of an error that ended a command.

    A bug's traceback goes to a file, which the message names.
    """
    match error:
        case _ if is_of_the_disk(error):
            return _failure(EXIT_DEVICE, error)
        case InputError() | OSError():
            return _failure(EXIT_INPUT, error)
        case _ if is_of_memory(error):
            return _failure(EXIT_INPUT, error, "there is not enough memory for an input of this size: ")
        case _ if is_of_threads(error):
            return Failure(EXIT_INPUT, _shortened("\n".join([_NO_THREAD, *getattr(error, "__notes__", [])])))
        case GradeError():
            return _failure(EXIT_REFUSED, error)
        case DeviceError():
            return _failure(EXIT_DEVICE, error)
        case RefusalError():
            return _failure(EXIT_REFUSED, error, f"no trustworthy {error.refused}: ")
        case KeyboardInterrupt():
            return _failure(EXIT_INTERRUPTED, error, "interrupted")
    return _failure(EXIT_BUG, error, f"a bug in this program: {type(error).__name__}: ", _written_traceback(error))


def _failure(code: int, error: BaseException, introduction: str = "", *more: str) -> Failure:
    notes = getattr(error, "__notes__", [])
    return Failure(code, _shortened(harmless("\n".join([f"{introduction}{error}", *notes])), *more))


def _shortened(message: str, *more: str) -> str:
    """The message, shortened to a screen: quotations may be of any length."""
    lines = [shortened(line, _LONGEST_LINE) for line in message.splitlines()]
    if len(lines) > _MOST_LINES:
        lines[_MOST_LINES - 1 :] = [f"(and {len(lines) - _MOST_LINES + 1} lines more)"]
    return "\n".join([*lines, *more])


def _written_traceback(error: BaseException) -> str:
    with tempfile.NamedTemporaryFile("w", prefix="scan-", suffix=".log", delete=False, encoding="utf-8") as file:
        traceback.print_exception(error, file=file)
    return f"Please report it with the file {file.name}."
