"""Commands in README.md and docs/*.md: their places, and how they are run or checked."""

import re
import runpy
import shlex
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from scanner.commands import choose_command, parser_of
from scanner.configuration import load_config
from tests.support.places import ROOT

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))

# Commands whose arguments are only parsed, and why they are not run.
NEED_DEVICES = "needs a camera and a projector"
NOT_RUN = {
    "scan devices": NEED_DEVICES,
    "scan --resume": "needs a scan that was broken off",
    "scan --config configs/room.yaml": NEED_DEVICES,
    "scan --config my-room.yaml": NEED_DEVICES,
    "scan check --config my-room.yaml": NEED_DEVICES,
    "scan new my-room.yaml --rig aravis": "asks devices; its own tests do",
    "scan console": "serves until it is stopped",
    "scan view": "serves until it is stopped",
    "scan import recording.mp4": "needs a film; its own tests have them",
    "scan replay my-film": "needs a film; its own tests have them",
    "scan photos": "needs two photographs",
    "scan accept": "needs scans of a ball bar",
    "scan board my-captures": "needs captures of a board",
    "scan calibrate scans/room scans/board": "needs boards and a corner before one rig; its own tests do",
    "scan compare scans/board scans/together": "needs two calibrations of one rig; its own tests do",
    "scan compare scans/part": "needs a scan and its CAD model; its own tests do",
    "scan register": "needs several clouds; its own tests have them",
    "scan board --config configs/room.yaml": NEED_DEVICES,
    "scan calibrate one": "needs captures of a thing; its own tests have them",
    "scan check corner": "needs captures of a calibrated rig; its own tests have them",
    "scan check --config my-rig.yaml": NEED_DEVICES,
    "scan check one": "needs captures of a calibrated rig; its own tests have them",
    "scan room": "needs a room's stations; its own tests have them",
    "scan network": "needs captures of a network's pairs; its own tests have them",
    "scan --config configs/room-whole-sim.yaml": "runs for minutes",
    "scan live": "needs a calibration of its rig; its own tests have one",
    "scan object": "needs a thing's stations; its own tests have them",
    "scan --config my-rig.yaml --object": "needs a rig",
    "scan export thing": "needs a thing's result; its own tests have one",
    "scan export hall-network": "needs a network's result; its own tests have one",
    "scan batch": "starts workers; its own tests do",
    "make": "installs packages, or runs for minutes",
    "python": "runs for minutes, or changes files of this repository",
    "pytest": "is what runs this test",
}
# These are for other programs: nothing of ours is in them.
FOREIGN = ("git clone", "cd", "source", "xdg-open", "apt-get", "sudo apt-get", "pip install", "python -m pip", "dask")


@dataclass(frozen=True)
class Documented:
    """A command without comment, variables and folder of the program, and its place."""

    page: str
    line: int
    text: str

    @property
    def words(self) -> list[str]:
        """Split a command like a shell."""
        return shlex.split(self.text)

    @property
    def why_not_run(self) -> str:
        """The reason why a command is only parsed; empty if it is run."""
        return next((why for start, why in NOT_RUN.items() if _starts(self.text, start)), "")

    @property
    def foreign(self) -> bool:
        """Whether the command is of another program."""
        return any(_starts(self.text, start) for start in FOREIGN)


def _starts(text: str, start: str) -> bool:
    return text == start or text.startswith(start + " ")


def commands() -> list[Documented]:
    """Every line of every block of shell commands."""
    return [command for page in PAGES for command in commands_in(page)]


def commands_in(page: Path) -> Iterator[Documented]:
    """The commands of one page; a backslash continues a line."""
    inside, started, text = False, 0, ""
    for number, line in enumerate(map(str.strip, page.read_text(encoding="utf-8").splitlines()), start=1):
        if line.startswith("```"):
            inside = line in ("```sh", "```bash", "```console") and not inside
            continue
        if not inside:
            continue
        started = started if text else number
        text += line.removesuffix("\\")
        if line.endswith("\\"):
            continue
        words, text = shlex.split(text.removeprefix("$ "), comments=True), ""
        while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
            del words[0]
        if words:
            words[0] = words[0].removeprefix(".venv/bin/")
            yield Documented(page.relative_to(ROOT).as_posix(), started, shlex.join(words))


def parse(command: Documented) -> None:
    """Check the arguments of a command without running it. Raises AssertionError, InputError or SystemExit."""
    program, *rest = command.words
    if program == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        assert set(rest) <= set(targets), f"the Makefile has no {rest}"
    elif program == "pytest":
        assert all((ROOT / word).exists() for word in rest if word.startswith("tests/"))
    elif program == "python":
        _parse_script(rest)
    else:
        chosen, arguments = choose_command(rest)
        options = parser_of(chosen).parse_args(arguments)
        configuration = getattr(options, "config", None)
        if configuration is not None and (ROOT / configuration).exists():
            load_config(ROOT / configuration, getattr(options, "set", None) or ())


class _Parsed(Exception):  # noqa: N818
    """The script has parsed its arguments, and can stop."""


def _parse_script(words: list[str]) -> None:
    script = ROOT / words[0]
    assert script.is_file(), f"there is no {words[0]}"
    if "parse_args" not in script.read_text(encoding="utf-8"):
        assert len(words) == 1, f"{words[0]} takes no arguments"
        return
    parse_args = ArgumentParser.parse_args

    def stop_after(parser: ArgumentParser, *arguments: Any) -> Namespace:
        parse_args(parser, *arguments)
        raise _Parsed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ArgumentParser, "parse_args", stop_after)
        patch.setattr(sys, "argv", words)
        with pytest.raises(_Parsed):
            runpy.run_path(str(script), run_name="__main__")
