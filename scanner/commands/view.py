"""Look at a result in 3-D, in the browser."""

from argparse import Namespace

from scanner.ui import Terminal
from scanner.viewing import require_viser


def run(args: Namespace) -> None:
    """Serve until Ctrl-C. Raises InputError, KeyboardInterrupt."""
    require_viser()
    from scanner.viewing import view_result  # viser is an extra

    view_result(args.result, args.host, args.port, Terminal(), browser=not args.no_browser)
