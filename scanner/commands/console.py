"""Check, scan and look at results on a page in the browser."""

from scanner.commands.options_of_rigs import ConsoleCommand
from scanner.ui import Terminal
from scanner.viewing import require_viser


def run(args: ConsoleCommand) -> None:
    """Serve until Ctrl-C. Raises InputError, KeyboardInterrupt."""
    require_viser()
    from scanner.console import ConsoleSettings, console  # viser is an extra

    settings = ConsoleSettings(args.settings.file, tuple(args.settings.set), calibration=args.calibration)
    console(settings, args.address.host, args.address.port, Terminal(), browser=not args.address.no_browser)
