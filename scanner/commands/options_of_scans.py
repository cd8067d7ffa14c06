"""Commands that make results of captures: their options."""

from argparse import Action, ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from scanner.commands.command import (
    NO_FILE,
    Command,
    ConfigOptions,
    Output,
    argument,
    count,
    option,
    required_grade,
    switch,
    with_output,
    with_settings,
)

_INSTEAD = "known calibration of the rig, used instead of calibrating"
_MASKS = "three PNG of the camera's size, nonzero on a face"
_NO_MASKS = "no such folder of masks"
_NO_CAPTURE, _NO_MATCHES = "no such capture folder", "no such matches file, result or capture"
_NO_STATION = "no such file or folder; a station is a recorded capture, a result or a matches.npz"
_FILL = "close the thing's surface where no station saw it"


class _InPlaceOfConfig(Action):
    """Of an option with which the configuration is known."""

    def __call__(self, parser: ArgumentParser, namespace: Namespace, values: object, _: object = None) -> None:
        setattr(namespace, self.dest, values)
        for action in parser._actions:
            action.required &= action.dest != "config"


@dataclass(frozen=True, kw_only=True)
class ScanCommand(Command):
    """Scan with the configured rig: capture, calibrate, reconstruct."""

    settings: ConfigOptions = with_settings(required=True)
    resume: Path | None = option(
        "complete an interrupted capture, as in NAME-incomplete, with the rig unchanged",
        "DIR",
        action=_InPlaceOfConfig,
    )  # what a killed capture left is given this name when the command begins
    captures: int = count(
        "capture the corner N times, moving the rig as a whole in between, and calibrate from all", default=1
    )
    stations: int | None = count(
        "scan a whole room from N places, moving the rig as a whole in between, and put them together"
    )
    object: bool = switch("with --stations: scan a thing that you turn in between")
    calibration: Path | None = option(
        "with --object: calibration of the rig (default: by what the stations share)", "FILE", existing=NO_FILE
    )
    fill: bool = switch(_FILL)
    masks: Path | None = option(_MASKS, "DIR", existing=_NO_MASKS)
    output: Output = with_output("scans/<name of the configuration>")


@dataclass(frozen=True, kw_only=True)
class ReplayCommand(Command):
    """Reconstruct from a recorded capture, also of another program."""

    capture: Path = argument("CAPTURE", "folder with a capture.yaml and its frames", existing=_NO_CAPTURE)
    settings: ConfigOptions = with_settings()
    calibration: Path | None = option(_INSTEAD, "FILE", existing=NO_FILE)
    masks: Path | None = option(_MASKS, "DIR", existing=_NO_MASKS)
    output: Output = with_output("scans/<name of the capture>")


@dataclass(frozen=True, kw_only=True)
class CalibrateCommand(Command):
    """Calibrate from captures, results or matches of another decoder: one of a corner, or several of one rig at
    once.
    """

    matches: list[Path] = argument(
        "MATCHES",
        "matches.npz, a result or a recorded capture; several of one unchanged rig are calibrated together, the newest "
        "last, by the corner that they show or, without any, by what three or more share; one may be a result of scan "
        "board",
        nargs="+",
        existing=_NO_MATCHES,
    )
    settings: ConfigOptions = with_settings(required=True)
    output: Output = with_output()


@dataclass(frozen=True, kw_only=True)
class BatchCommand(Command):
    """Reconstruct many captures, on one machine or many, into one table."""

    more: ClassVar[str] = """
A refusal or a crash is noted in the capture's row; the others go on. After an interruption, repeat the command: only
what is left is done. Sources and --out may be remote, as in s3://bucket/folder.
"""

    sources: list[str] = argument(
        "FOLDER",
        "folder that contains captures; or a pattern with *; or a list (.csv) with a column 'capture'",
        nargs="+",
    )
    settings: ConfigOptions = with_settings()
    calibration: str | None = option(_INSTEAD, "FILE", existing=NO_FILE)  # may be remote, as the captures
    out: str = option("folder of the results and of their table", "DIR", required=True)
    workers: int | None = count("processes (default: one for each processor)")
    memory: str | None = option("memory of each process, as in 4GB (default: an equal share)", "SIZE")
    scheduler: str | None = option("a running Dask scheduler, as in tcp://10.0.0.1:8786", "ADDRESS")
    retry: bool = switch("retry captures that crashed in an earlier run")
    require: str | None = required_grade("a capture, whose result is kept, has a lower grade or none")
    quiet: bool = switch("print nothing but errors")


@dataclass(frozen=True, kw_only=True)
class PhotosCommand(Command):
    """Calibrate an ordinary camera from two or more photos of a corner, and reconstruct what they share."""

    more: ClassVar[str] = """
The photos may be cropped if all are cropped alike, because the principal point is estimated, too. The zoom must not
change between them. The result is that of the first two photos.
"""

    photos: list[Path] = argument(
        "PHOTO", "photos of one corner by one camera at one zoom", nargs="+", existing=NO_FILE
    )
    matches: Path | None = option(
        "matches.npz of two photos: camera_px in the first, projector_px in the second", "FILE"
    )
    masks: Path | None = option(_MASKS, "DIR", existing=_NO_MASKS)
    exif_prior: bool = switch("use the EXIF focal length (± 5 %%), which is otherwise only shown")
    dense: bool = switch("match every pixel of the first two photos: dense.ply")
    settings: ConfigOptions = with_settings()
    output: Output = with_output()


@dataclass(frozen=True, kw_only=True)
class BoardCommand(Command):
    """Calibrate from captures of a printed board in different poses, and say how accurate that is."""

    more: ClassVar[str] = """
Take six to ten captures, at least three. Tilt the board by 20 to 45 degrees to either side and up and down, at
different distances, so that together the captures fill both pictures. Move nothing but the board.

Exit codes: 2 if the board is not found; 4 if these boards do not determine a calibration, with the reason.
"""

    captures: list[Path] = argument(
        "CAPTURE", "folder with a capture.yaml, or with several of those", nargs="*", existing=_NO_CAPTURE
    )
    board: str | None = option(
        "chessboard:9x7 (inner corners), charuco:6x9 (squares), aprilgrid:6x6 (tags), circles:7x5 or acircles:4x11 "
        "(dots)",
        "KIND:WxH",
    )
    square: str | None = option(
        "side of a square or tag, or distance between dots, as in 30mm (default unit: mm)", "LENGTH"
    )
    sheet: str | None = option(
        "write a PDF to print at true size instead: charuco:A4, or as chessboard:9x7@A3 with --square",
        "KIND:SHEET",
        flag="--print",
    )
    settings: ConfigOptions = with_settings()
    number: int = count("with --config: capture the board N times, moving it in between", default=8, flag="--captures")
    output: Output = with_output("scans/board, or a PDF's name")


@dataclass(frozen=True, kw_only=True)
class RoomCommand(Command):
    """Join stations of one unchanged rig into a room: their poses, the walls, one cloud, a floor plan."""

    more: ClassVar[str] = """
Each station should see about a third of what another one saw. A corner of the room that one of them shows calibrates
the rig; without any, the points that their pictures share do. Stations of another room, or of a rig that was changed,
are named and left out. To take stations: scan --config FILE --stations N.

Exit codes: 4 if no two stations belong together, or if they fit together in more than one way, with both answers.
"""

    stations: list[Path] | int = argument(
        "STATION", "captures, results or matches.npz, in any order", nargs="+", existing=_NO_STATION
    )
    """Those that exist, or how many are taken, as scan --stations does."""
    settings: ConfigOptions = with_settings(required=True)
    calibration: Path | None = option(
        "known calibration of the rig: no station needs a corner", "FILE", existing=NO_FILE
    )
    output: Output = with_output()


@dataclass(frozen=True, kw_only=True)
class NetworkCommand(Command):
    """Calibrate several cameras and projectors of one room together: every device, one cloud from all cameras."""

    more: ClassVar[str] = """
Each capture is of one camera in one projector's light, in a folder named <camera>-<projector>. One pair sees a corner
of the room; the others follow where a camera sees two projectors' light, or a projector's light is seen by two cameras.
Without a corner, give three stations or more: folders, each with captures of all pairs, between which something rigid
with print or pattern was turned and tipped before the devices, by 10 to 30° each time.

Exit codes: 4 if neither a corner nor what stations share calibrates a pair, a device does not connect, or the cameras
contradict each other.
"""

    captures: list[Path] = argument(
        "CAPTURE",
        "folders named <camera>-<projector>, in any order, or folders of those; none to capture with the devices in "
        "rigs of --config",
        nargs="*",
        existing="no such file or folder",
    )
    settings: ConfigOptions = with_settings()
    stations: int | None = option("capture so often, and turn what stands before the devices in between", "N")
    distance: str | None = option("known distance between two devices, as in left,stage,2.35m", "A,B,LENGTH")
    output: Output = with_output("scans/network")


@dataclass(frozen=True, kw_only=True)
class ObjectCommand(Command):
    """Join stations of a thing seen by one rig: their poses, one surface, its volume."""

    more: ClassVar[str] = """
The rig is fixed, and the thing is turned between stations, on a turntable or by hand. Successive stations should
overlap by half. The static background, such as table and wall, is recognised and left out. Without --calibration, the
points that the pictures share calibrate the rig: tip the thing once, as turns about one axis do not determine it. To
take stations: scan --config FILE --object --stations N.

Exit codes: 4 if no two stations belong together, if nothing was turned, if the calibration is of another rig, if the
stations do not determine one, or if a rotation is ambiguous, as for a ball.
"""

    stations: list[Path] | int = argument(
        "STATION",
        "captures, results or matches.npz, in any order; a thing's folder stands for its stations",
        nargs="+",
        existing=_NO_STATION,
    )
    """Those that exist, or how many are taken, as scan --stations does."""
    settings: ConfigOptions = with_settings(required=True)
    calibration: Path | None = option("known calibration of the rig", "FILE", existing=NO_FILE)
    fill: bool = switch(_FILL)
    output: Output = with_output()
