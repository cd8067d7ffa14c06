"""The commands: each parses its arguments, calls the pipeline, and says what came of it.

`scan` alone is the main job; the others are named by the first argument. A module here has `add_arguments(parser)`,
`run(args)` and a docstring that `--help` shows.
"""

from argparse import ArgumentParser, Namespace
from typing import Protocol

from scanner.commands import (
    accept,
    calibrate,
    check,
    console,
    devices,
    export,
    measure,
    patterns,
    photos,
    replay,
    scan,
    view,
)


class Command(Protocol):
    """What a module of this package has."""

    __doc__: str | None

    def add_arguments(self, parser: ArgumentParser) -> None:
        """Declare the arguments."""

    def run(self, args: Namespace) -> None:
        """Do the work. Raises InputError, DeviceError, RefusalError."""


MAIN: Command = scan
NAMED: dict[str, Command] = {
    "replay": replay,
    "calibrate": calibrate,
    "patterns": patterns,
    "devices": devices,
    "check": check,
    "export": export,
    "measure": measure,
    "accept": accept,
    "view": view,
    "console": console,
    "photos": photos,
}
