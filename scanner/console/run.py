"""`scan console`: the page from the first look to Ctrl-C."""

import logging

from scanner.console.page import ConsolePage
from scanner.console.settings import Settings
from scanner.interruption import finishing
from scanner.ui import Terminal
from scanner.viewing.server import announce_page, serving, wait

log = logging.getLogger(__name__)


def console(settings: Settings, host: str, port: int | None, terminal: Terminal, *, browser: bool) -> None:
    """Serve the page until Ctrl-C, which raises KeyboardInterrupt. Raises InputError.

    A scan that is running then is cancelled: what it has captured is kept, and the terminal says where.
    """
    config = settings.in_turn()[0].load()
    required = (config.required_rig, config.camera_size, config.projector_size)  # said in the terminal if missing
    log.info("console for %s", required)
    with serving(f"Console: {settings.config.stem}", host, port) as served:
        page = ConsolePage(served, settings)
        try:
            page.start()
            announce_page(served.address, host, terminal, browser=browser)
            wait()
        finally:
            with finishing(ending=True):
                ended = page.close()
                if ended.message:
                    terminal.show(ended.message)
