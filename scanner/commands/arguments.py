"""What can be typed: every command with its arguments. Knows nothing of what they do, so that help comes at once."""

from argparse import Action, ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from scanner.exporting import DEFAULT_POINTS, FORMATS
from scanner.viewing.opening import add_address

_LONGEST_WATCH_S = 3600.0


@dataclass(frozen=True)
class Command:
    """What it is for, in one line and in more; `add_arguments` declares them; `module` has `run(args)`, which obeys."""

    about: str
    add_arguments: Callable[[ArgumentParser], None]
    module: str
    more: str = ""

    def load(self) -> Callable[[Namespace], None]:
        """What does the work; it raises InputError, StorageError, DeviceError, RefusalError."""
        run: Callable[[Namespace], None] = import_module(f"scanner.commands.{self.module}").run
        return run


class _InPlaceOfConfig(Action):
    """Of an argument with which the configuration is known."""

    def __call__(self, parser: ArgumentParser, namespace: Namespace, values: object, _: object = None) -> None:
        setattr(namespace, self.dest, values)
        for action in parser._actions:
            action.required &= action.dest != "config"


def _scan(parser: ArgumentParser) -> None:
    _config(parser, required=True)
    parser.add_argument(
        "--resume",
        type=Path,
        action=_InPlaceOfConfig,
        metavar="DIR",
        help="take what is missing of a capture that was broken off, as in NAME-incomplete, with the rig as it was",
    )
    parser.add_argument(
        "--captures",
        type=int,
        default=1,
        metavar="N",
        help="capture the corner N times, moving the rig as a whole in between, and calibrate from all (default: 1)",
    )
    parser.add_argument(
        "--stations",
        type=int,
        metavar="N",
        help="scan a whole room from N places, moving the rig as a whole in between, and put them together",
    )
    _out(parser, default="scans/<name of the configuration>")
    _overwrite(parser)
    _masks(parser)
    _quiet(parser)


def _replay(parser: ArgumentParser) -> None:
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="folder with a capture.yaml and its frames")
    _config(parser, required=False)
    _calibration(parser)
    _masks(parser)
    _out(parser, default="scans/<name of the capture>")
    _overwrite(parser)
    _quiet(parser)


def _batch(parser: ArgumentParser) -> None:
    parser.add_argument(
        "sources",
        nargs="+",
        metavar="FOLDER",
        help="every capture below it; or a name with * in it; or a list (.csv) with a column 'capture'",
    )
    _config(parser, required=False)
    _calibration(parser, kind=str)  # may be far away, as the captures
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of the results and of their table")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one for each processor)")
    parser.add_argument("--memory", metavar="SIZE", help="of each process, as in 4GB (default: an equal share of all)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a running Dask scheduler, as in tcp://10.0.0.1:8786")
    parser.add_argument("--retry", action="store_true", help="try captures again that crashed in an earlier run")
    _quiet(parser)


def _import(parser: ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder with the frames")
    parser.add_argument("--from", dest="layout", metavar="FORMAT", help="whose order of frames it is (default: any)")
    parser.add_argument("--projector", metavar="WxH", help="the projector's size, as in 1024x768")
    parser.add_argument("--cell", metavar="PX", help="projector pixels to a cell of the Gray code (default: 1)")
    parser.add_argument("--frames", metavar="GLOB", help="take only files of such a name, as in 'cam1_*.png'")
    parser.add_argument("--out", type=Path, metavar="CAPTURE", help="folder to make (default: only say what it is)")
    _quiet(parser)


def _calibrate(parser: ArgumentParser) -> None:
    parser.add_argument(
        "matches",
        type=Path,
        nargs="+",
        metavar="MATCHES",
        help="matches.npz, or a result folder; several of one unchanged rig are calibrated together, the newest last; "
        "one may be a result of scan board",
    )
    _config(parser, required=True)
    _out(parser)
    _overwrite(parser)
    _quiet(parser)


def _patterns(parser: ArgumentParser) -> None:
    _config(parser, required=True)
    _out(parser)
    _quiet(parser)


def _seconds(text: str) -> float:
    seconds = float(text)  # argparse tells of what is no number
    if not 0 <= seconds <= _LONGEST_WATCH_S:
        raise ArgumentTypeError(f"expected 0 to {_LONGEST_WATCH_S:.0f} seconds, found {text}")
    return seconds


def _check(parser: ArgumentParser) -> None:
    _config(parser, required=True)
    parser.add_argument(
        "--write", action="store_true", help="put the exposure and the projector's response into the configuration file"
    )
    parser.add_argument(
        "--watch",
        type=_seconds,
        default=0.0,
        metavar="SECONDS",
        help="look for drift over so long, 60 say (default: as long as the rest takes)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder to make, for check.yaml and pictures (default: nothing is kept)"
    )
    _quiet(parser)


def _export(parser: ArgumentParser) -> None:
    _result(parser)
    formats = "; ".join(f"{name}: {target.about}" for name, target in FORMATS.items())
    parser.add_argument("--to", required=True, choices=list(FORMATS), metavar="FORMAT", help=formats)
    parser.add_argument(
        "--out", type=Path, metavar="PATH", help="file to write, a folder for colmap (default: beside the result)"
    )
    parser.add_argument(
        "--points", type=int, metavar="N", help=f"colmap: at most so many points (default: {DEFAULT_POINTS:,})"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier file of that name")
    _quiet(parser)


def _measure(parser: ArgumentParser) -> None:
    _result(parser)
    parser.add_argument(
        "--sphere",
        action="append",
        default=[],
        metavar="DIAMETER",
        help="find and fit a ball, as in 50.8mm; without a unit, in the result's",
    )
    parser.add_argument(
        "--distance",
        nargs=4,
        type=float,
        action="append",
        default=[],
        metavar=("X1", "Y1", "X2", "Y2"),
        help="between the points at two camera pixels",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for measure.json and measure.png (default: beside the result)"
    )
    parser.add_argument("--shares", action="store_true", help="tell where each sigma comes from")
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier measurement there")
    _quiet(parser)


def _accept(parser: ArgumentParser) -> None:
    parser.add_argument("results", type=Path, nargs="+", metavar="RESULT", help="folders that scans left")
    parser.add_argument(
        "--ball-bar",
        required=True,
        metavar="D1,D2,LENGTH",
        help="calibrated diameters and distance of the centres, as in 50.02mm,50.01mm,200.13mm",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for acceptance.html and acceptance.json (default: beside the first result)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier acceptance there")
    _quiet(parser)


def _view(parser: ArgumentParser) -> None:
    _result(parser)
    add_address(parser)


def _console(parser: ArgumentParser) -> None:
    _config(parser, required=True)
    add_address(parser)


def _photos(parser: ArgumentParser) -> None:
    parser.add_argument(
        "photos", type=Path, nargs="+", metavar="PHOTO", help="photos of one corner by one camera at one zoom"
    )
    parser.add_argument(
        "--matches",
        type=Path,
        metavar="FILE",
        help="matches.npz of the two photos: camera_px in the first, projector_px in the second",
    )
    _masks(parser)
    parser.add_argument(
        "--exif-prior", action="store_true", help="use the EXIF focal length (± 5 %%), which is otherwise only shown"
    )
    parser.add_argument("--dense", action="store_true", help="match every pixel of the first two photos: dense.ply")
    _config(parser, required=False)
    _out(parser)
    _overwrite(parser)
    _quiet(parser)


def _board(parser: ArgumentParser) -> None:
    parser.add_argument(
        "captures", type=Path, nargs="*", metavar="CAPTURE", help="folder with a capture.yaml, or with several of those"
    )
    parser.add_argument(
        "--board",
        metavar="KIND:WxH",
        help="chessboard:9x7 (inner corners), charuco:6x9 (squares), "
        "aprilgrid:6x6 (tags), circles:7x5 or acircles:4x11 (dots)",
    )
    parser.add_argument(
        "--square",
        metavar="LENGTH",
        help="side of a square or tag, or distance between dots, as in 30mm (default unit: mm)",
    )
    parser.add_argument(
        "--print",
        dest="sheet",
        metavar="KIND:SHEET",
        help="write a PDF to print at true size instead: charuco:A4, or as chessboard:9x7@A3 with --square",
    )
    _config(parser, required=False)
    parser.add_argument(
        "--captures",
        dest="number",
        type=int,
        default=8,
        metavar="N",
        help="with --config: capture the board N times, moving it in between (default: 8)",
    )
    _out(parser, default="scans/board, or a PDF's name")
    _overwrite(parser)
    _quiet(parser)


def _room(parser: ArgumentParser) -> None:
    parser.add_argument(
        "stations", type=Path, nargs="+", metavar="STATION", help="captures, results or matches.npz, in any order"
    )
    _config(parser, required=True)
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="known calibration of the rig: no station needs a corner"
    )
    _out(parser)
    _overwrite(parser)
    _quiet(parser)


def _compare(parser: ArgumentParser) -> None:
    for name, which in (("first", "CAL_A"), ("second", "CAL_B")):
        parser.add_argument(name, type=Path, metavar=which, help="calibration.yaml, or the folder of a result")
    parser.add_argument(
        "--depths",
        metavar="D1,D2,…",
        help="where to compare, as in 1m,2m,3m (default: the depths of CAL_A's scene, or around where both look)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for compare.html and compare.json")
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier comparison there")
    _quiet(parser)


def _result(parser: ArgumentParser) -> None:
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder that a scan left")


def _config(parser: ArgumentParser, *, required: bool) -> None:
    parser.add_argument("--config", type=Path, metavar="FILE", required=required, help="configuration (YAML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key, as in camera.width=640"
    )


def _calibration(parser: ArgumentParser, kind: type[Path] | type[str] = Path) -> None:
    parser.add_argument(
        "--calibration", type=kind, metavar="FILE", help="known calibration of the rig: nothing is calibrated"
    )


def _out(parser: ArgumentParser, *, default: str | None = None) -> None:
    text = "folder to make" if default is None else f"folder to make (default: {default})"
    parser.add_argument("--out", type=Path, metavar="DIR", required=default is None, help=text)


def _overwrite(parser: ArgumentParser) -> None:
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier result of that name")


def _masks(parser: ArgumentParser) -> None:
    parser.add_argument("--masks", type=Path, metavar="DIR", help="three PNG of the camera's size, nonzero on a face")


def _quiet(parser: ArgumentParser) -> None:
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


MAIN = Command("Scan with the configured rig: capture, calibrate, reconstruct.", _scan, "scan")
NAMED = {
    "replay": Command("Reconstruct from a recorded capture, whoever made it.", _replay, "replay"),
    "calibrate": Command(
        "Calibrate from matches of another decoder or of earlier results: one capture, or several of one rig at once.",
        _calibrate,
        "calibrate",
    ),
    "batch": Command(
        "Reconstruct many captures, on all processors of this machine or of many, with one table of all.",
        _batch,
        "batch",
        """
What a capture does, a refusal or a crash, is in its row; the others go on. Interrupted or repeated with the same
arguments, a batch does what is left. Sources and --out may be far away, as in s3://bucket/folder.
""",
    ),
    "patterns": Command(
        "Write the patterns as images, with a sequence.yaml that describes them, to be projected by any other means.",
        _patterns,
        "patterns",
    ),
    "devices": Command("List cameras and screens, with the lines to paste into a configuration.", _quiet, "devices"),
    "check": Command(
        "Look at the rig before a scan: devices, exposure, light, focus, and how well this view will calibrate.",
        _check,
        "check",
        """
Each line says what was found and, after an arrow, what to do. --write puts the exposure (a whole number of the
projector's refresh periods in which nothing saturates) and the projector's response into the configuration file; only
these lines change, and the file as it was before the first time is kept beside it as FILE.bak.

Exit codes: 0 if a scan would work, be it poorly; 3 if a device fails; 4 if a scan of this view would be refused. What
is known is shown in any case.
""",
    ),
    "export": Command("Write a result in another program's format and conventions.", _export, "export"),
    "measure": Command(
        "Measure in a result: how round a ball and how flat the faces came out, and how far two points are apart.",
        _measure,
        "measure",
        """
The faces are always measured. --sphere finds a ball of known diameter anywhere in the cloud; given twice, it finds two,
and the distance of their centres is told, too.
""",
    ),
    "accept": Command(
        "Test the scanner with a calibrated ball bar, after VDI/VDE 2634 part 2.",
        _accept,
        "accept",
        """
Probing, sphere-spacing and flatness errors. Scan the ball bar in several places, with the rig unchanged, and give all
the results: the largest errors count.
""",
    ),
    "view": Command("Look at a result in 3-D, in the browser.", _view, "view"),
    "console": Command("Check, scan and look at results on a page in the browser.", _console, "console"),
    "photos": Command(
        "Calibrate an ordinary camera from two or more photos of a corner, and reconstruct what they share.",
        _photos,
        "photos",
        """
The photos may be cropped, if all of them are in the same way: the principal point is found, too. The zoom must not
change between them. The second photo is the one that the result is about.
""",
    ),
    "board": Command(
        "Calibrate from captures of a printed board in different poses, and say how true that is.",
        _board,
        "board",
        """
Three captures are the least, six to ten are good: tilted by 20 to 45 degrees to either side and up and down, at
different distances, so that together they fill the pictures of both devices. Nothing but the board is moved.

Exit codes: 2 if the board is not found; 4 if these boards do not determine a calibration, with the reason.
""",
    ),
    "room": Command(
        "Put stations of one unchanged rig together to a whole room: where each stood, the walls, one cloud, a plan.",
        _room,
        "room",
        """
Each station should see about a third of what another one saw, and one at least a corner of the room. Stations of
another room, or of a rig that was changed, are named and left out. To take them: scan --config FILE --stations N.

Exit codes: 4 if no two stations belong together, or if they fit together in more than one way, with both answers.
""",
    ),
    "compare": Command(
        "Compare two calibrations of one rig: where they differ, and whether their sigmas allow it.",
        _compare,
        "compare",
        """
Differences are told in projector pixels and as lengths, over the camera's picture and by depth, after the rigid motion
is taken out that brings the two closest. Exit code 0 also where they differ: the sentence at the end says so.
""",
    ),
    "import": Command("Make a capture of another program's frames, whose order is recognised.", _import, "import_"),
}
