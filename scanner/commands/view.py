"""Look at a result in 3-D, in the browser."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from scanner.ui import Terminal
from scanner.viewing.opening import add_address, require_viser


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder that a scan left")
    add_address(parser)


def run(args: Namespace) -> None:
    """Serve until Ctrl-C. Raises InputError, KeyboardInterrupt."""
    require_viser()
    from scanner.viewing.view import view  # viser is an extra

    view(args.result, args.host, args.port, Terminal(), browser=not args.no_browser)
