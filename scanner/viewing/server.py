"""The page's server: viser, as quiet and as private as it can be, and readable."""

import logging
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from threading import Event

import viser

from scanner.rendering import script
from scanner.ui import Terminal
from scanner.viewing.opening import address, free_port, warning
from scanner.viewing.origin_check import OriginCheck
from scanner.viewing.served_files import ServedFiles

_STYLE = "page.css"
_BRAND = (0, 90, 150)


@dataclass(frozen=True)
class Serving:
    """A running server, its `address` with the token that opens it, and the `served_files` that it answers with."""

    server: viser.ViserServer
    address: str
    served_files: ServedFiles


@contextmanager
def serving(title: str, host: str, wanted_port: int | None) -> Iterator[Serving]:
    """A server for as long as the context lasts.

    Raises InputError if it cannot be had at that address.
    """
    port = free_port(host, wanted_port)
    # Malformed messages of clients are not shown in the terminal.
    logging.getLogger("websockets").addHandler(logging.NullHandler())
    served_files = ServedFiles()
    origin_check = OriginCheck(host, served_files.answer)
    with origin_check.watching(), redirect_stdout(StringIO()):  # viser prints a banner; the address is printed by us
        server = viser.ViserServer(host, port, label=title, verbose=False)
    try:
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large", brand_color=_BRAND)
        where = f"{address(host, server.get_port())}/?token={origin_check.token}"
        yield Serving(server, where, served_files)
    finally:
        server.stop()


def add_style(gui: viser.GuiApi, *, panel_left: bool = False) -> None:
    """Add the page's style to viser's; requires an open GUI container. What lies over the view is away from the panel,
    which is at the right or at the left.
    """
    gui.add_html(f'<style>{script(_STYLE)}</style><div class="scan-panel-{"left" if panel_left else "right"}"></div>')


def announce_page(where: str, host: str, terminal: Terminal, *, browser: bool) -> None:
    """Say where the page is, and open it if asked to."""
    if text := warning(host):
        terminal.show(text)
    terminal.show(f"Open {where} in a browser; Ctrl-C ends it.")
    if browser:
        webbrowser.open(where)


def wait() -> None:
    """Until Ctrl-C, which raises KeyboardInterrupt."""
    Event().wait()
