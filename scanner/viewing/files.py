"""A result's files on the page: its report to be opened, the others and exports of it to be downloaded."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

from scanner.comparing import CLOUD_FILE, COMPARE_PAGE, MESH_FILE, REFERENCE_CLOUD_FILE, REFERENCE_MESH_FILE
from scanner.exporting import FORMATS, ExportRequest
from scanner.io import read_whole
from scanner.results import (
    CALIBRATION_FILE,
    KINDS,
    MERGED_FILE,
    NETWORK_FILE,
    REFUSAL_FILE,
    REPORT_FILE,
)
from scanner.viewing.buttons import PLAIN
from scanner.viewing.texts import link_html
from scanner.viewing.view_controls import failures_shown

_SURFACES = tuple(name for kind in KINDS for name in (kind.cloud, kind.mesh) if name)
_COMPARED = (COMPARE_PAGE, CLOUD_FILE, MESH_FILE, REFERENCE_CLOUD_FILE, REFERENCE_MESH_FILE)
_FILES = (REPORT_FILE, CALIBRATION_FILE, MERGED_FILE, NETWORK_FILE, *_SURFACES, REFUSAL_FILE, *_COMPARED)


def add_files(gui: viser.GuiApi, folder: Path, link: Callable[[Path], str]) -> None:
    """Into the container that is open."""
    names = [name for name in _FILES if (folder / name).is_file()]
    if REPORT_FILE in names:
        gui.add_html(link_html(link(folder / REPORT_FILE), "Open the report"))
    with gui.add_folder("Files", expand_by_default=False):
        message = gui.add_markdown("")
        for name in names:
            button = gui.add_button(f"Download {name}", color=PLAIN)
            button.on_click(_sending(f"{folder.name}-{name}", folder / name, message))
        if (folder / CALIBRATION_FILE).is_file():
            _add_exports(gui, folder)


def _add_exports(gui: viser.GuiApi, folder: Path) -> None:
    """Formats of one file each; the others are folders, which the command makes."""
    formats = {name: export for name, export in FORMATS.items() if export.suffixes}
    chosen = gui.add_dropdown("Export as", [f"{name}: {export.about}" for name, export in formats.items()])
    button = gui.add_button("Export", color=PLAIN)
    message = gui.add_markdown("")

    def export(event: viser.GuiEvent[Any]) -> None:
        form = formats[chosen.value.partition(":")[0]]
        message.content = "Exporting …"
        with failures_shown(message), tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch, f"{folder.name}{form.ending}")
            sentences = form.write(ExportRequest(folder, out))
            if event.client is not None:
                event.client.send_file_download(out.name, out.read_bytes(), save_immediately=True)
            message.content = f"{out.name}: {'; '.join(sentences)}"

    button.on_click(export)


def _sending(name: str, path: Path, message: viser.GuiMarkdownHandle) -> Callable[[viser.GuiEvent[Any]], None]:
    def send(event: viser.GuiEvent[Any]) -> None:
        if event.client is None:
            return
        message.content = ""
        with failures_shown(message):
            event.client.send_file_download(name, read_whole(path), save_immediately=True)

    return send
