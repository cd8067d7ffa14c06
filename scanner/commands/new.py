"""Write a configuration that explains itself, with the devices that are found filled in."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hw.backends import BACKENDS
from scanner.commands.devices import find_devices
from scanner.commands.options_of_rigs import RIGS, NewCommand
from scanner.configuration import check_text, example, with_key
from scanner.errors import InputError
from scanner.io import flow_yaml, new_file, parse_yaml
from scanner.results import default_out
from scanner.ui import Terminal


def run(args: NewCommand) -> None:
    """Do the work. Raises InputError."""
    rig, path, terminal = RIGS[args.rig], args.file, Terminal(quiet=args.quiet)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"{path}: expected a name that ends with .yaml")
    text = _renamed(example(rig.example), rig.example, path)
    if rig.backend:
        devices = find_devices(terminal, [backend for backend in BACKENDS if backend.name == rig.backend])
        terminal.show(*devices.paragraphs())
        if devices.lines:
            text = filled_in(text, parse_yaml("\n".join(devices.lines), "what was found"), str(path))
    check_text(text, path)
    with new_file(path, overwrite=args.overwrite) as partial:
        partial.write_text(text, encoding="utf-8")
    terminal.show(f"Written: {path}, {rig.about}. Every key in it is explained.", f"→ {_next(args.rig, path)}")


def _next(name: str, path: Path) -> str:
    if RIGS[name].backend:
        return f"scan check --config {path} tests both devices, and proposes settings."
    stations = " --stations 6" if name == "whole-room" else ""
    return f"scan --config {path}{stations} scans; the result goes to {default_out(path.stem, overwrite=True)}/"


def _renamed(text: str, example_name: str, path: Path) -> str:
    """The text, whose comments speak of the file by its own name."""
    return text.replace(f"configs/{example_name}", str(path)).replace(
        f"scans/{Path(example_name).stem}/", f"scans/{path.stem}/"
    )


def filled_in(text: str, values: dict[str, dict[str, Any]], where: str) -> str:
    """Set keys such as rig.camera in a configuration's text; a commented key is replaced in its place.

    Raises InputError if that cannot be done.
    """
    for section, name, value in _keys(values):
        commented = re.compile(rf"^  # {name}: .*$", re.MULTILINE)
        place = commented.search(text) if section == "rig" else None
        if place:
            text = f"{text[: place.start()]}  {name}: {flow_yaml(value)}{text[place.end() :]}"
        else:
            text = with_key(text, f"{section}.{name}", value, where)
    return text


def _keys(values: dict[str, dict[str, Any]]) -> Iterator[tuple[str, str, Any]]:
    for section, keys in values.items():
        for name, value in keys.items():
            if name != "backend":
                yield section, name, value
