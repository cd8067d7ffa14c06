"""The page's server: viser, as quiet and as private as it can be, and readable."""

import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from threading import Event

import viser

from scanner.ui import Terminal
from scanner.viewing.opening import address, free_port, warning

# Some of the client's own texts are smaller than 12 px or too pale; its units follow the root's font.
_READABLE = """<style>
:root { font-size: 16px !important; }
label { color: #333 !important; letter-spacing: normal !important; }
.mantine-Slider-markLabel, .mantine-Slider-label { font-size: 12px !important; }
</style>"""
_BRAND = (0, 90, 150)


@contextmanager
def serving(title: str, host: str, wanted_port: int | None) -> Iterator[viser.ViserServer]:
    """A server for as long as the context lasts. Raises InputError if it cannot be had at that address."""
    port = free_port(host, wanted_port)
    with redirect_stdout(StringIO()):  # viser prints a banner; the address is ours to say
        server = viser.ViserServer(host, port, label=title, verbose=False)
    try:
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large", brand_color=_BRAND)
        yield server
    finally:
        server.stop()


def add_readable_fonts(gui: viser.GuiApi) -> None:
    """Keep every text of the page at 12 px or more; called where there is a container for it."""
    gui.add_html(_READABLE)


def invite(server: viser.ViserServer, host: str, terminal: Terminal, *, browser: bool) -> None:
    """Say where the page is, and open it if asked to."""
    where = address(host, server.get_port())
    if text := warning(host):
        terminal.show(text)
    terminal.show(f"Open {where} in a browser; Ctrl-C ends it.")
    if browser:
        webbrowser.open(where)


def wait() -> None:
    """Until Ctrl-C, which raises KeyboardInterrupt."""
    Event().wait()
