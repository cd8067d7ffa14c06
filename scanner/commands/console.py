"""Check, scan and look at results on a page in the browser."""

from argparse import Namespace

from scanner.ui import Terminal
from scanner.viewing import require_viser


def run(args: Namespace) -> None:
    """Serve until Ctrl-C. Raises InputError, KeyboardInterrupt."""
    require_viser()
    from scanner.console import ConsoleSettings, console  # viser is an extra

    settings = ConsoleSettings(args.config, tuple(args.set), calibration=args.calibration)
    console(settings, args.host, args.port, Terminal(), browser=not args.no_browser)
