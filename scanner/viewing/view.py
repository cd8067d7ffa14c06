"""`scan view`: a page for one result."""

from pathlib import Path

from scanner.io import given_path
from scanner.ui import Terminal
from scanner.viewing.panel import ResultPanel, reading
from scanner.viewing.scene import CloudScene
from scanner.viewing.server import add_style, announce_page, serving, wait


def view_result(folder: Path, host: str, port: int | None, terminal: Terminal, *, browser: bool) -> None:
    """Serve a result until Ctrl-C, which raises KeyboardInterrupt. Raises InputError."""
    with terminal.step("Reading the result"):
        show = reading(folder)
    with serving(f"Result {given_path(folder).name}", host, port) as served:
        gui = served.server.gui
        gui.main_panel.dock_right()
        tabs = gui.add_tab_group()
        with tabs.add_tab("Result") as tab:
            add_style(gui)
        show(ResultPanel(gui, CloudScene(served.server), tab, served.served_files.link))
        announce_page(served.address, host, terminal, browser=browser)
        wait()
