"""Arguments in, exit codes out."""

import os
import resource
import sys
from argparse import Action, ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import NoReturn

from scanner.commands import options_of_results, options_of_rigs, options_of_scans
from scanner.commands.command import Command
from scanner.errors import InputError
from scanner.interruption import finishing, handlers_restored, interrupt, on_ending
from scanner.shown_text import expect_names_of

# The matrices here are small and many: a thread pool costs several times what it gains. Larger work is divided where it
# is computed. This must be set before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Likewise before OpenCV is imported: its messages would hide ours.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")

_DECLARED = (
    Command.declared_in(options_of_scans)
    | Command.declared_in(options_of_results)
    | Command.declared_in(options_of_rigs)
)
# In this order in the help.
_NAMES = (
    "replay calibrate batch patterns new devices check clean export measure section accept view console photos board "
    "room network object live compare register import"
)
NAMED = {name: _DECLARED[name] for name in _NAMES.split()}

_OTHER_COMMANDS = "other commands:\n" + "\n".join(
    f"  scan {name:<10} {command.about()}" for name, command in NAMED.items()
)

# What the smallest scan takes on two cores; memory in use is a fifth of it.
_ADDRESS_SPACE = 1_400_000_000

_FIRST_STEP = "→ scan new my-room.yaml writes a configuration to begin with."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line (default: the process's own) and return its exit code; errors are one message on stderr."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without × or ± is no error
    with handlers_restored():
        given = sys.argv[1:] if arguments is None else list(arguments)
        expect_names_of(given)
        try:
            name, rest = choose_command(given)
            args = parser_of(name).parse_args(rest)
            options = _command(name).of(args)
            options.refuse_missing()
            _require_address_space()
            options.refuse_wrong_settings()
            options.module()
            on_ending(interrupt)
            _announce_compiling(quiet=getattr(args, "quiet", False))
            exit_code = options.run()
        except (Exception, KeyboardInterrupt) as error:
            with finishing(ending=True):
                return _reported(error)
    return exit_code or 0


def _require_address_space() -> None:
    """Raise InputError if libraries could not be loaded: some end the process then, without a word of ours."""
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < _ADDRESS_SPACE:
        raise InputError(
            f"this process may use {allowed / 1e9:.2f} GB of address space, and the libraries and threads of "
            f"this program take {_ADDRESS_SPACE / 1e9:.1f} GB: raise the limit (ulimit -v)"
        )


def _announce_compiling(*, quiet: bool) -> None:
    """The first command after an installation takes longer: say so where progress is shown, too."""
    jit = sys.modules.get("calib.numerics.jit")  # not loaded by commands that compute nothing
    if jit is not None and sys.stderr.isatty() and not quiet:
        jit.when_compiling(lambda: print("Compiling for this machine, once: up to a minute …", file=sys.stderr))


def _reported(error: BaseException) -> int:
    """Report an error; returns its exit code."""
    from scanner.ui import failure_of, for_screen  # this imports the display of progress, which help does not need

    failure = failure_of(error)
    print(for_screen(f"scan: {failure.message}", sys.stderr), file=sys.stderr)
    return failure.exit_code


def parser_of(name: str) -> ArgumentParser:
    """The parser of a command's arguments; '' for the main job."""
    command = _command(name)
    parser = _Parser(
        prog=f"scan {name}".rstrip(),
        description=f"{command.about()}\n{command.more}",
        epilog=None if name else _OTHER_COMMANDS,
        formatter_class=RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show program's version number and exit")
    command.declare(parser)
    return parser


class _Parser(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see '{self.prog} --help')")


class _Version(Action):
    def __call__(self, parser: ArgumentParser, *_: object, **__: object) -> NoReturn:
        from importlib.metadata import version  # slow to import and rarely needed

        print(f"scan {version('roomscan')}")
        parser.exit()


def _command(name: str) -> type[Command]:
    return NAMED[name] if name else options_of_scans.ScanCommand


def _on_unknown(first: str) -> str:
    """What may have been meant by a first word that is no command."""
    if Path(first).exists():
        what = (f"scan {name} {first}" for name in ("view", "measure", "export", "replay"))
        return f"'{first}' is no command; expected, for a result or a capture, one of: {', '.join(what)}"
    from difflib import get_close_matches  # rarely needed

    if near := get_close_matches(first, NAMED, n=1):
        return f"unknown command '{first}'; did you mean 'scan {near[0]}'?"
    return f"unknown command '{first}'; expected --config FILE, or one of: {', '.join(NAMED)}"


def choose_command(arguments: list[str]) -> tuple[str, list[str]]:
    """The command's name, '' for the main job, and its arguments."""
    if not arguments:
        raise InputError(f"nothing to do\n\n{parser_of('').format_help().rstrip()}\n\n{_FIRST_STEP}")
    first, *rest = arguments
    if first in NAMED:
        return first, rest
    if not first.startswith("-"):
        raise InputError(_on_unknown(first))
    return "", arguments
