"""Check, scan and look at results on a page in the browser."""

from argparse import ArgumentParser, Namespace

from scanner.commands import options
from scanner.ui import Terminal
from scanner.viewing.opening import add_address, require_viser


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    options.add_config(parser, required=True)
    add_address(parser)


def run(args: Namespace) -> None:
    """Serve until Ctrl-C. Raises InputError, KeyboardInterrupt."""
    require_viser()
    from scanner.console.run import console  # viser is an extra
    from scanner.console.settings import Settings

    settings = Settings(args.config, tuple(args.set))
    console(settings, args.host, args.port, Terminal(), browser=not args.no_browser)
