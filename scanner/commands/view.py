"""Look at a result in 3-D, in the browser."""

from scanner.commands.options_of_results import ViewCommand
from scanner.ui import Terminal
from scanner.viewing import require_viser


def run(args: ViewCommand) -> None:
    """Serve until Ctrl-C. Raises InputError, KeyboardInterrupt."""
    require_viser()
    from scanner.viewing import view_result  # viser is an extra

    view_result(args.result, args.address.host, args.address.port, Terminal(), browser=not args.address.no_browser)
