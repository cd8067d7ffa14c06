"""Arguments in, exit codes out."""

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from importlib.metadata import version
from io import TextIOWrapper
from typing import NoReturn

import cv2

from scanner.commands import MAIN, NAMED, Command
from scanner.errors import InputError
from scanner.ui import failure_of


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
    except (Exception, KeyboardInterrupt) as error:
        failure = failure_of(error)
        print(f"scan: {failure.message}", file=sys.stderr)
        return failure.exit_code
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
