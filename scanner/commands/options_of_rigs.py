"""Commands about a rig, before a scan or beside it, and about captures of other programs: their options, and the rigs
that `scan new` offers, each with its commented configuration.
"""

from argparse import ArgumentTypeError
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from scanner.commands.command import (
    NO_FILE,
    Address,
    Command,
    ConfigOptions,
    argument,
    count,
    option,
    required_grade,
    switch,
    with_settings,
)

_QUIET = "print nothing but errors"
_LONGEST_WATCH_S = 3600.0


@dataclass(frozen=True)
class NewRig:
    """`example`: a file of configs/. What is found of the `backend`'s cameras, and of screens, is written into it."""

    about: str
    example: str
    backend: str | None = None


RIGS = {
    "simulated": NewRig("a simulated room corner; needs nothing", "room-sim.yaml"),
    "whole-room": NewRig("a simulated room, to scan with --stations", "room-whole-sim.yaml"),
    "aravis": NewRig("a GenICam camera (GigE or USB3 Vision) and a projector", "room.yaml", "aravis"),
    "opencv": NewRig("a webcam or a network camera, and a projector", "room-webcam.yaml", "opencv"),
    "gphoto2": NewRig("a tethered photo camera, and a projector", "room-photo-camera.yaml", "gphoto2"),
}


@dataclass(frozen=True, kw_only=True)
class PatternsCommand(Command):
    """Write the patterns as images, with a sequence.yaml that describes them, to be projected by any other means."""

    settings: ConfigOptions = with_settings(required=True)
    video: str | None = option("also write a video for any player, as in sequence.mp4", "NAME")
    hold: str | None = option("with --video: how long each picture is shown (default: 0.2s)", "TIME")
    loops: int | None = count(
        "with --video: how many times the pictures are shown, forwards and backwards (default: 1)"
    )
    out: Path = option("folder to make", "DIR", required=True)
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class NewCommand(Command):
    """Write a commented configuration, with the devices that are found filled in."""

    file: Path = argument("FILE", "configuration to write, as in my-rig.yaml")
    rig: str = option(
        f"{'; '.join(f'{name}: {rig.about}' for name, rig in RIGS.items())} (default: simulated)",
        "NAME",
        default="simulated",
        choices=list(RIGS),
    )
    overwrite: bool = switch("replace an earlier file of that name")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class DevicesCommand(Command):
    """List cameras and screens, with the lines to paste into a configuration."""

    quiet: bool = switch(_QUIET)


def _seconds(text: str) -> float:
    seconds = float(text)  # argparse reports text that is no number
    if not 0 <= seconds <= _LONGEST_WATCH_S:
        raise ArgumentTypeError(f"expected 0 to {_LONGEST_WATCH_S:.0f} seconds, found {text}")
    return seconds


@dataclass(frozen=True, kw_only=True)
class CheckCommand(Command):
    """Check the rig before a scan, or a calibration by captures."""

    more: ClassVar[str] = """
With --config: devices, exposure, light, focus, and how well this view will calibrate.
Each line says what was found and, after an arrow, what to do. --write puts the exposure (a whole number of the
projector's refresh periods in which nothing saturates) and the projector's response into the configuration file; only
these lines change, and the original file is kept as FILE.bak.

Exit codes: 0 if a scan would work, even if poorly; 3 if a device fails; 4 if a scan of this view would be refused, or,
with --require good, if anything could be better. The results so far are always shown.

With --calibration: whether it holds, what has changed, and by how much, by captures or by one that is taken. One of a
corner, or three of anything from different sides, test all of it; any other tests whether rays meet. --update
re-estimates it, with the earlier one as what is known before: the new one takes its place, the earlier one is kept
beside it, and FILE.log.yaml lists both. Exit codes: 0 if it holds, or was updated; 1 if it does not hold; 4 if the
captures do not suffice for an update, which changes nothing.
"""
    captures: list[Path] = argument(
        "CAPTURE",
        "with --calibration: recorded capture, result or matches.npz of the rig (default: one is taken)",
        nargs="*",
        existing="no such matches file, result or capture",
    )
    settings: ConfigOptions = with_settings()
    calibration: Path | None = option("the calibration to check", "FILE", existing=NO_FILE)
    update: bool = switch("with --calibration: estimate it anew from the captures and itself, and keep both")
    write: bool = switch("put the exposure and the projector's response into the configuration file")
    watch: float = option(
        "seconds to look for drift, as in 60 (default: the duration of the other checks)",
        "SECONDS",
        default=0.0,
        type=_seconds,
    )
    out: Path | None = option("folder to make, for check.yaml and pictures (default: nothing is kept)", "DIR")
    require: str | None = required_grade("anything could be better (good)")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class ConsoleCommand(Command):
    """Check, scan and look at results on a page in the browser."""

    settings: ConfigOptions = with_settings(required=True)
    calibration: Path | None = option(
        "for live clouds: of the rig (default: the newest result's)", "FILE", existing=NO_FILE
    )
    address: Address = Address.part()


@dataclass(frozen=True, kw_only=True)
class LiveCommand(Command):
    """Show live clouds of a calibrated rig; kept ones become stations of a thing or a room."""

    more: ClassVar[str] = """
Six frames make a cloud: two fringes of three steps along one axis. What moves too fast is left out, and counted. Enter
keeps a cloud; scan object OUT or scan room OUT joins them. Ctrl-C ends; kept clouds stay.
"""
    settings: ConfigOptions = with_settings(required=True)
    calibration: Path = option("known calibration of the rig", "FILE", required=True, existing=NO_FILE)
    clouds: int | None = count("keep N clouds, then end")
    room: bool = switch("the rig moves in a room (default: a thing is moved)")
    every: str | None = option("keep a cloud at this interval, as in 2s", "TIME")
    depths: str | None = option("range of depths, as in 0.3m,0.6m, for finer clouds (default: any)", "NEAR,FAR")
    page: bool = switch("show the clouds on a page in the browser, too")
    address: Address = Address.part()
    out: Path | None = option("folder to make (default: scans/<name of the configuration>-live)", "DIR")
    overwrite: bool = switch("replace an earlier result of that name")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class ImportCommand(Command):
    """Make a capture from another program's frames, recognising their order."""

    folder: Path = argument(
        "DIR",
        "folder with the frames, or a recording (mp4, mov, mkv)",
        existing="expected a folder with images, found nothing",
    )
    format: str | None = option("program that took the frames (default: all)", "FORMAT", flag="--from")
    projector: str | None = option("the projector's size, as in 1024x768", "WxH")
    pixel_aspect: str | None = option(
        "height of the projector's pixels over their width, 0.5 for diamond arrays of mirrors (default: 1)", "RATIO"
    )
    cell: str | None = option("projector pixels in a cell of the Gray code (default: what fits of 1, 2 and 4)", "PX")
    periods: str | None = option(
        "numbers of fringe periods across the picture, in the order of the frames, as in 59,64,70", "N,…"
    )
    order: str | None = option("number in the list, if several orders fit", "N")
    flip: Literal["x", "y"] | None = option(
        "mirror the frames back, left to right (x) or top to bottom (y), if the camera or its driver mirrors them",
        choices=("x", "y"),
    )
    frames: str | None = option("take only files that match a pattern, as in 'cam1_*.png'", "GLOB")
    sequence: Path | None = option("for a recording: the sequence.yaml of its video", "FILE")
    out: Path | None = option("folder to make (default: only report what is recognised)", "CAPTURE")
    quiet: bool = switch(_QUIET)
