"""`scan view`: a result on a page of its own."""

from pathlib import Path

from scanner.ui import Terminal
from scanner.viewing.panel import ResultPanel
from scanner.viewing.result import ViewedResult
from scanner.viewing.server import add_readable_fonts, invite, serving, wait


def view(folder: Path, host: str, port: int | None, terminal: Terminal, *, browser: bool) -> None:
    """Serve a result until Ctrl-C, which raises KeyboardInterrupt. Raises InputError."""
    with terminal.step("Reading the result"):
        result = ViewedResult(folder)
        result.cloud(result.names[0])
    with serving(f"Result {folder.resolve().name}", host, port) as server:
        server.gui.main_panel.dock_right()
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Result") as tab:
            add_readable_fonts(server.gui)
        ResultPanel(server, tab).open(result)
        invite(server, host, terminal, browser=browser)
        wait()
