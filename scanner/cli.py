"""Arguments in, exit codes out."""

import sys
import tempfile
import traceback
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from importlib.metadata import version
from io import TextIOWrapper
from typing import NoReturn

import cv2

from calib.refusal import RefusalError
from hw.errors import DeviceError
from scanner.commands import MAIN, NAMED, Command
from scanner.errors import InputError

EXIT_INPUT = 2
EXIT_DEVICE = 3
EXIT_REFUSED = 4
EXIT_BUG = 70  # EX_SOFTWARE of sysexits.h
EXIT_INTERRUPTED = 130


class _Parser(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see '{self.prog} --help')")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line (default: the process's own) and return its exit code; errors are one message on stderr."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # our own messages say what matters
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that has no × or ± is no reason to fail
    try:
        command, rest = _choose(sys.argv[1:] if arguments is None else list(arguments))
        command.run(_parser(command).parse_args(rest))
    except InputError as error:
        return _fail(EXIT_INPUT, error)
    except DeviceError as error:
        return _fail(EXIT_DEVICE, error)
    except RefusalError as error:
        return _fail(EXIT_REFUSED, error, f"no trustworthy {error.refused}: ")
    except OSError as error:
        return _fail(EXIT_INPUT, error)
    except KeyboardInterrupt as error:
        return _fail(EXIT_INTERRUPTED, error, "interrupted")
    except Exception as error:
        return _fail(EXIT_BUG, error, f"a bug in this program: {type(error).__name__}: ", _written_traceback())
    return 0


def _choose(arguments: list[str]) -> tuple[Command, list[str]]:
    if not arguments:
        raise InputError(f"nothing to do\n\n{_parser(MAIN).format_help().rstrip()}")
    first, *rest = arguments
    if first in NAMED:
        return NAMED[first], rest
    if not first.startswith("-"):
        raise InputError(f"unknown command '{first}'; expected --config FILE, or one of: {', '.join(NAMED)}")
    return MAIN, arguments


def _parser(command: Command) -> ArgumentParser:
    name = next((f" {name}" for name, other in NAMED.items() if other is command), "")
    parser = _Parser(
        prog=f"scan{name}",
        description=command.__doc__,
        epilog=_OTHER_COMMANDS if command is MAIN else None,
        formatter_class=RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"scan {version('roomscan')}")
    command.add_arguments(parser)
    return parser


_OTHER_COMMANDS = "other commands:\n" + "\n".join(
    f"  scan {name:<10} {(command.__doc__ or '').splitlines()[0]}" for name, command in NAMED.items()
)


def _fail(code: int, error: BaseException, introduction: str = "", *more: str) -> int:
    notes = getattr(error, "__notes__", [])
    message = "\n".join([f"scan: {introduction}{error}", *notes, *more])
    print(message, file=sys.stderr)
    return code


def _written_traceback() -> str:
    with tempfile.NamedTemporaryFile("w", prefix="scan-", suffix=".log", delete=False, encoding="utf-8") as file:
        traceback.print_exc(file=file)
    return f"Please report it with the file {file.name}."
