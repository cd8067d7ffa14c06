"""Compile what the commands will need, so that the first of them does not wait for it: part of `make setup`.

Numba compiles a function for the types that it is called with, so each way through the program is gone once, with a
small picture of a simulated room. What is compiled already, and has not changed since, is not compiled again.
"""

import re
import sys
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

from numba.core import event

from scanner.capture import CAPTURE_FILE
from scanner.commands.main import main

_CONFIG = """
rig: {backend: simulated, seed: 0}
camera: {width: 306, height: 256, principal_point: {known: [157.0375, 131.7875]}}
projector: {width: 427, height: 240}
sequence: {preset: standard}
corner: {squareness_deg: 0, same: true}
"""


class _Count(event.Listener):
    """Counts compilations, and keeps a line about them up to date on a terminal."""

    def __init__(self) -> None:
        self.compiled = 0
        self._begun_s = time.monotonic()

    def on_start(self, _event: event.Event) -> None:
        self.compiled += 1
        if sys.stderr.isatty():
            print(f"\rCompiling for this machine: {self}", end="", file=sys.stderr, flush=True)

    def on_end(self, _event: event.Event) -> None:
        """Nothing: the next one tells."""

    def __str__(self) -> str:
        return f"{self.compiled} functions, {time.monotonic() - self._begun_s:.0f} s"


def _ways(folder: Path) -> Iterator[list[str]]:
    """Arguments of commands, one after the other, that go through everything that is compiled."""
    config = folder / "room.yaml"
    config.write_text(_CONFIG, encoding="utf-8")

    def scan(name: str, *more: str) -> list[str]:
        return ["--config", str(config), "--out", str(folder / name), *more, "--quiet"]

    def replay(capture: Path, name: str, *more: str) -> list[str]:
        return ["replay", str(capture), "--out", str(folder / name), *more, "--quiet"]

    yield scan("concave", "--set", "sequence={preset: concave}")
    yield scan("quick", "--set", "sequence={preset: quick}")
    yield scan("standard", "--captures", "2")
    first = folder / "standard"
    known = "--calibration", str(first / "calibration.yaml")
    yield replay(first / "capture", "calibrated", *known)
    yield ["export", str(first), "--to", "mesh", "--quiet"]
    _drop_fringes(first / "capture" / CAPTURE_FILE)
    yield replay(first / "capture", "gray", *known)


def _drop_fringes(listing: Path) -> None:
    kept = []
    for line in listing.read_text(encoding="utf-8").splitlines(keepends=True):
        if "kind: phase" not in line:
            kept.append(line)
        elif image := re.search(r"frames/\d+\.png", line):
            (listing.parent / image[0]).unlink()
    listing.write_text("".join(kept), encoding="utf-8")


def run() -> int:
    """Do it; the exit code of the command that failed, or 0."""
    listener = _Count()
    event.register("numba:compile", listener)  # type: ignore[no-untyped-call]
    with TemporaryDirectory(prefix="roomscan-") as scratch:
        for arguments in _ways(Path(scratch)):
            with redirect_stdout(StringIO()):
                code = main(arguments)
            if code:
                return code
    print(f"\rCompiled for this machine: {listener}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(run())
