"""Every command: its purpose and its arguments. Nothing that does the work is imported: help appears at once."""

from argparse import Action, ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable
from pathlib import Path

from scanner.commands.command import AddArguments, Command
from scanner.commands.rigs import RIGS
from scanner.commands.shared_arguments import (
    add_calibration,
    add_capture,
    add_config,
    add_flag,
    add_masks,
    add_new_result,
    add_number,
    add_out,
    add_overwrite,
    add_paths,
    add_quiet,
    add_require,
    add_result,
    add_text,
)
from scanner.exporting import DEFAULT_GAMMA, DEFAULT_POINTS, FORMATS
from scanner.viewing import add_address

NAMED: dict[str, Command] = {}

_USUAL_DEVIATIONS = 3.0  # of scan clean --outliers
_LONGEST_WATCH_S = 3600.0
_INSTEAD = "known calibration of the rig, used instead of calibrating"


def _command(about: str, more: str = "") -> Callable[[AddArguments], AddArguments]:
    """Enter a command of that purpose; it has the arguments that the function declares."""

    def enter(add_arguments: AddArguments) -> AddArguments:
        entered = Command(about, more, add_arguments)
        NAMED[entered.name] = entered
        return add_arguments

    return enter


class _InPlaceOfConfig(Action):
    """Of an argument with which the configuration is known."""

    def __call__(self, parser: ArgumentParser, namespace: Namespace, values: object, _: object = None) -> None:
        setattr(namespace, self.dest, values)
        for action in parser._actions:
            action.required &= action.dest != "config"


def of_scan(parser: ArgumentParser) -> None:
    add_config(parser, required=True)
    parser.add_argument(
        "--resume",
        type=Path,
        action=_InPlaceOfConfig,
        metavar="DIR",
        help="complete an interrupted capture, as in NAME-incomplete, with the rig unchanged",
    )
    what = "capture the corner N times, moving the rig as a whole in between, and calibrate from all"
    add_number(parser, "--captures", what, default=1)
    what = "scan a whole room from N places, moving the rig as a whole in between, and put them together"
    add_number(parser, "--stations", what)
    add_flag(parser, "--object", "with --stations: scan a thing that you turn in between")
    add_calibration(parser, "with --object: calibration of the rig (default: by what the stations share)")
    _add_fill(parser)
    add_masks(parser)
    add_new_result(parser, default="scans/<name of the configuration>")


MAIN = Command("Scan with the configured rig: capture, calibrate, reconstruct.", "", of_scan)


@_command("Reconstruct from a recorded capture, also of another program.")
def of_replay(parser: ArgumentParser) -> None:
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="folder with a capture.yaml and its frames")
    add_config(parser, required=False)
    add_calibration(parser, _INSTEAD)
    add_masks(parser)
    add_new_result(parser, default="scans/<name of the capture>")


@_command(
    "Calibrate from captures, results or matches of another decoder: one of a corner, or several of one rig at once."
)
def of_calibrate(parser: ArgumentParser) -> None:
    add_paths(
        parser,
        "matches",
        "MATCHES",
        "matches.npz, a result or a recorded capture; several of one unchanged rig are calibrated together, the newest "
        "last, by the corner that they show or, without any, by what three or more share; one may be a result of scan "
        "board",
    )
    add_config(parser, required=True)
    add_new_result(parser)


@_command(
    "Reconstruct many captures, on one machine or many, into one table.",
    """
A refusal or a crash is noted in the capture's row; the others go on. After an interruption, repeat the command: only
what is left is done. Sources and --out may be remote, as in s3://bucket/folder.
""",
)
def of_batch(parser: ArgumentParser) -> None:
    parser.add_argument(
        "sources",
        nargs="+",
        metavar="FOLDER",
        help="folder that contains captures; or a pattern with *; or a list (.csv) with a column 'capture'",
    )
    add_config(parser, required=False)
    add_calibration(parser, _INSTEAD, kind=str)  # may be remote, as the captures
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of the results and of their table")
    add_number(parser, "--workers", "processes (default: one for each processor)")
    add_text(parser, "--memory", "SIZE", "memory of each process, as in 4GB (default: an equal share)")
    add_text(parser, "--scheduler", "ADDRESS", "a running Dask scheduler, as in tcp://10.0.0.1:8786")
    add_flag(parser, "--retry", "retry captures that crashed in an earlier run")
    add_require(parser, "a capture, whose result is kept, has a lower grade or none")
    add_quiet(parser)


@_command("Write the patterns as images, with a sequence.yaml that describes them, to be projected by any other means.")
def of_patterns(parser: ArgumentParser) -> None:
    add_config(parser, required=True)
    add_text(parser, "--video", "NAME", "also write a video for any player, as in sequence.mp4")
    add_text(parser, "--hold", "TIME", "with --video: how long each picture is shown (default: 0.2s)")
    what = "with --video: how many times the pictures are shown, forwards and backwards (default: 1)"
    add_number(parser, "--loops", what)
    add_out(parser)
    add_quiet(parser)


@_command("Write a commented configuration, with the devices that are found filled in.")
def of_new(parser: ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="configuration to write, as in my-rig.yaml")
    rigs = "; ".join(f"{name}: {rig.about}" for name, rig in RIGS.items())
    parser.add_argument(
        "--rig", choices=list(RIGS), default="simulated", metavar="NAME", help=f"{rigs} (default: simulated)"
    )
    add_overwrite(parser, "file of that name")
    add_quiet(parser)


@_command("List cameras and screens, with the lines to paste into a configuration.")
def of_devices(parser: ArgumentParser) -> None:
    add_quiet(parser)


def _seconds(text: str) -> float:
    seconds = float(text)  # argparse reports text that is no number
    if not 0 <= seconds <= _LONGEST_WATCH_S:
        raise ArgumentTypeError(f"expected 0 to {_LONGEST_WATCH_S:.0f} seconds, found {text}")
    return seconds


@_command(
    "Check the rig before a scan, or a calibration by captures.",
    """
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
""",
)
def of_check(parser: ArgumentParser) -> None:
    captures = "with --calibration: recorded capture, result or matches.npz of the rig (default: one is taken)"
    add_paths(parser, "captures", "CAPTURE", captures, nargs="*")
    add_config(parser, required=False)
    add_calibration(parser, "the calibration to check")
    add_flag(parser, "--update", "with --calibration: estimate it anew from the captures and itself, and keep both")
    add_flag(parser, "--write", "put the exposure and the projector's response into the configuration file")
    parser.add_argument(
        "--watch",
        type=_seconds,
        default=0.0,
        metavar="SECONDS",
        help="seconds to look for drift, as in 60 (default: the duration of the other checks)",
    )
    add_out(parser, "folder to make, for check.yaml and pictures", default="nothing is kept")
    add_require(parser, "anything could be better (good)")
    add_quiet(parser)


class _Step(Action):
    """Of an option that is a step: the steps are in the order of the command line."""

    def __call__(self, _: ArgumentParser, namespace: Namespace, values: object, __: object = None) -> None:
        name = str(self.option_strings[0]).removeprefix("--")
        namespace.steps = [*(namespace.steps or ()), (name, True if values == [] else values)]


@_command(
    "Do named steps to a result's cloud: a region of interest, cleaning, fewer triangles, other axes.",
    """
The steps are done in the order given, after those that the result has, and are written into it as steps.yaml. Exports
and views show what they leave; the cloud in the result stays as it was measured, and --undo takes the last one back.
Without a step, those of the result are listed. Lengths may have a unit, as in 5cm; without one, they are in the
result's. A value that begins with a minus sign is given as --box=-0.5m,…
""",
)
def of_clean(parser: ArgumentParser) -> None:
    add_result(parser)
    steps = {"action": _Step, "dest": "steps"}
    what = "keep what is between two corners, along the cloud's axes"
    parser.add_argument("--box", metavar="X0,Y0,Z0,X1,Y1,Z1", help=what, **steps)  # type: ignore[arg-type]
    what = "drop points whose distance from their neighbours is N standard deviations above the mean (default: 3)"
    parser.add_argument("--outliers", nargs="?", type=float, const=_USUAL_DEVIATIONS, metavar="N", help=what, **steps)  # type: ignore[arg-type]
    what = "drop pieces of the cloud that are smaller, as in 5cm"
    parser.add_argument("--pieces", metavar="SIZE", help=what, **steps)  # type: ignore[arg-type]
    what = "move each point along its normal, as far as its standard deviation allows: of one capture"
    parser.add_argument("--smooth", nargs=0, help=what, **steps)  # type: ignore[arg-type]
    what = "close holes of the mesh up to a size, as in 2cm"
    parser.add_argument("--fill", metavar="SIZE", help=what, **steps)  # type: ignore[arg-type]
    what = "reduce the mesh to N triangles"
    parser.add_argument("--triangles", type=int, metavar="N", help=what, **steps)  # type: ignore[arg-type]
    what = "origin on the floor below the newest camera, z up, x to the camera's right"
    parser.add_argument("--floor", nargs=0, help=what, **steps)  # type: ignore[arg-type]
    what = "origin, a point on the x axis, and one beside it on the side of y: nine lengths"
    parser.add_argument("--axes", metavar="X,Y,Z,…", help=what, **steps)  # type: ignore[arg-type]
    add_flag(parser, "--undo", "take the last step back")
    add_quiet(parser)


@_command("Write a result in another program's format and conventions.")
def of_export(parser: ArgumentParser) -> None:
    add_result(parser)
    formats = "; ".join(f"{name}: {target.about}" for name, target in FORMATS.items())
    parser.add_argument("--to", required=True, choices=list(FORMATS), metavar="FORMAT", help=formats)
    what = "file to write, a folder for colmap and mapping"
    add_out(parser, what, default="beside the result", metavar="PATH")
    add_capture(parser)
    add_number(parser, "--points", f"colmap: at most this many points (default: {DEFAULT_POINTS:,})")
    what = "mapping: the viewer's eye, in metres in the axes of mapping.glb, as in --eye=0.5,0.2,-1"
    add_text(parser, "--eye", "X,Y,Z", f"{what} (default: straight on to the largest wall)")
    parser.add_argument(
        "--gamma",
        type=float,
        metavar="G",
        help=f"mapping: blend maps are stored as weight^(1/G) (default: {DEFAULT_GAMMA})",
    )
    add_overwrite(parser, "file of that name")
    add_quiet(parser)


@_command(
    "Measure in a result: the form of a ball, the flatness of the faces, and distances between points.",
    """
The faces are always measured. --sphere finds a ball of known diameter anywhere in the cloud; given twice, it finds two,
and measures the distance of their centres, too.
""",
)
def of_measure(parser: ArgumentParser) -> None:
    add_result(parser)
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
        action="append",
        default=[],
        metavar=("X1", "Y1", "X2", "Y2"),
        help="distance between the points at two camera pixels; 2:X1 is a pixel of the second capture or station",
    )
    add_capture(parser)
    add_out(parser, "folder for measure.json and measure.png", default="beside the result")
    add_flag(parser, "--shares", "show where each sigma comes from")
    add_overwrite(parser, "measurement there")
    add_quiet(parser)


@_command(
    "Cut the surface of a result by planes: contours with their lengths.",
    """
A plane is across an axis of the cloud, as in z=1.2m, or a normal and an offset, as in 0,0.6,0.8,1.2m. --every repeats
it through the whole surface. A contour is drawn through the points within two of their sigmas.
""",
)
def of_section(parser: ArgumentParser) -> None:
    add_result(parser)
    what = "plane to cut at, as in z=1.2m; may be given again"
    parser.add_argument("--plane", action="append", default=[], metavar="PLANE", help=what)
    add_text(parser, "--every", "INTERVAL", "repeat each plane at this interval, as in 10cm")
    add_capture(parser)
    add_out(parser, "folder for section.csv, section.svg and section.dxf", default="beside the result")
    add_overwrite(parser, "section there")
    add_quiet(parser)


@_command(
    "Test the scanner with a calibrated ball bar, after VDI/VDE 2634 part 2.",
    """
Probing, sphere-spacing and flatness errors. Scan the ball bar in several places, with the rig unchanged, and give all
the results: the largest errors count.
""",
)
def of_accept(parser: ArgumentParser) -> None:
    add_paths(parser, "results", "RESULT", "folders of scans' results")
    parser.add_argument(
        "--ball-bar",
        required=True,
        metavar="D1,D2,LENGTH",
        help="calibrated diameters and distance of the centres, as in 50.02mm,50.01mm,200.13mm",
    )
    add_out(parser, "folder for acceptance.html and acceptance.json", default="beside the first result")
    add_overwrite(parser, "acceptance there")
    add_quiet(parser)


@_command("Look at a result in 3-D, in the browser.")
def of_view(parser: ArgumentParser) -> None:
    add_result(parser)
    add_address(parser)


@_command("Check, scan and look at results on a page in the browser.")
def of_console(parser: ArgumentParser) -> None:
    add_config(parser, required=True)
    add_calibration(parser, "for live clouds: of the rig (default: the newest result's)")
    add_address(parser)


@_command(
    "Calibrate an ordinary camera from two or more photos of a corner, and reconstruct what they share.",
    """
The photos may be cropped if all are cropped alike, because the principal point is estimated, too. The zoom must not
change between them. The result is that of the first two photos.
""",
)
def of_photos(parser: ArgumentParser) -> None:
    add_paths(parser, "photos", "PHOTO", "photos of one corner by one camera at one zoom")
    parser.add_argument(
        "--matches",
        type=Path,
        metavar="FILE",
        help="matches.npz of two photos: camera_px in the first, projector_px in the second",
    )
    add_masks(parser)
    add_flag(parser, "--exif-prior", "use the EXIF focal length (± 5 %%), which is otherwise only shown")
    add_flag(parser, "--dense", "match every pixel of the first two photos: dense.ply")
    add_config(parser, required=False)
    add_new_result(parser)


@_command(
    "Calibrate from captures of a printed board in different poses, and say how accurate that is.",
    """
Take six to ten captures, at least three. Tilt the board by 20 to 45 degrees to either side and up and down, at
different distances, so that together the captures fill both pictures. Move nothing but the board.

Exit codes: 2 if the board is not found; 4 if these boards do not determine a calibration, with the reason.
""",
)
def of_board(parser: ArgumentParser) -> None:
    add_paths(parser, "captures", "CAPTURE", "folder with a capture.yaml, or with several of those", nargs="*")
    what = "chessboard:9x7 (inner corners), charuco:6x9 (squares), aprilgrid:6x6 (tags), "
    add_text(parser, "--board", "KIND:WxH", f"{what}circles:7x5 or acircles:4x11 (dots)")
    what = "side of a square or tag, or distance between dots, as in 30mm (default unit: mm)"
    add_text(parser, "--square", "LENGTH", what)
    parser.add_argument(
        "--print",
        dest="sheet",
        metavar="KIND:SHEET",
        help="write a PDF to print at true size instead: charuco:A4, or as chessboard:9x7@A3 with --square",
    )
    add_config(parser, required=False)
    parser.add_argument(
        "--captures",
        dest="number",
        type=int,
        default=8,
        metavar="N",
        help="with --config: capture the board N times, moving it in between (default: 8)",
    )
    add_new_result(parser, default="scans/board, or a PDF's name")


@_command(
    "Join stations of one unchanged rig into a room: their poses, the walls, one cloud, a floor plan.",
    """
Each station should see about a third of what another one saw. A corner of the room that one of them shows calibrates
the rig; without any, the points that their pictures share do. Stations of another room, or of a rig that was changed,
are named and left out. To take stations: scan --config FILE --stations N.

Exit codes: 4 if no two stations belong together, or if they fit together in more than one way, with both answers.
""",
)
def of_room(parser: ArgumentParser) -> None:
    add_paths(parser, "stations", "STATION", "captures, results or matches.npz, in any order")
    add_config(parser, required=True)
    add_calibration(parser, "known calibration of the rig: no station needs a corner")
    add_new_result(parser)


@_command(
    "Calibrate several cameras and projectors of one room together: every device, one cloud from all cameras.",
    """
Each capture is of one camera in one projector's light, in a folder named <camera>-<projector>. One pair sees a corner
of the room; the others follow where a camera sees two projectors' light, or a projector's light is seen by two cameras.

Exit codes: 4 if no corner calibrates a pair, a device does not connect, or the cameras contradict each other.
""",
)
def of_network(parser: ArgumentParser) -> None:
    what = "folders named <camera>-<projector>, in any order; none to capture with the devices in rigs of --config"
    add_paths(parser, "captures", "CAPTURE", what, nargs="*")
    add_config(parser, required=False)
    add_text(parser, "--distance", "A,B,LENGTH", "known distance between two devices, as in left,stage,2.35m")
    add_new_result(parser, default="scans/network")


@_command(
    "Join stations of a thing seen by one rig: their poses, one surface, its volume.",
    """
The rig is fixed, and the thing is turned between stations, on a turntable or by hand. Successive stations should
overlap by half. The static background, such as table and wall, is recognised and left out. Without --calibration, the
points that the pictures share calibrate the rig: tip the thing once, as turns about one axis do not determine it. To
take stations: scan --config FILE --object --stations N.

Exit codes: 4 if no two stations belong together, if nothing was turned, if the calibration is of another rig, if the
stations do not determine one, or if a rotation is ambiguous, as for a ball.
""",
)
def of_object(parser: ArgumentParser) -> None:
    what = "captures, results or matches.npz, in any order; a thing's folder stands for its stations"
    add_paths(parser, "stations", "STATION", what)
    add_config(parser, required=True)
    add_calibration(parser, "known calibration of the rig")
    _add_fill(parser)
    add_new_result(parser)


@_command(
    "Show live clouds of a calibrated rig; kept ones become stations of a thing or a room.",
    """
Six frames make a cloud: two fringes of three steps along one axis. What moves too fast is left out, and counted. Enter
keeps a cloud; scan object OUT or scan room OUT joins them. Ctrl-C ends; kept clouds stay.
""",
)
def of_live(parser: ArgumentParser) -> None:
    add_config(parser, required=True)
    add_calibration(parser, "known calibration of the rig", required=True)
    add_number(parser, "--clouds", "keep N clouds, then end")
    add_flag(parser, "--room", "the rig moves in a room (default: a thing is moved)")
    add_text(parser, "--every", "TIME", "keep a cloud at this interval, as in 2s")
    add_text(parser, "--depths", "NEAR,FAR", "range of depths, as in 0.3m,0.6m, for finer clouds (default: any)")
    add_flag(parser, "--page", "show the clouds on a page in the browser, too")
    add_address(parser)
    add_new_result(parser, default="scans/<name of the configuration>-live", graded=False)


@_command(
    "Compare two calibrations of one rig: where they differ, and whether their sigmas allow it.",
    """
Differences are in projector pixels and as lengths, over the camera's picture and by depth, after the best rigid
alignment. Exit codes: 0 if they agree, or neither states a covariance; 1 if they differ by more than their standard
deviations allow.
""",
)
def of_compare(parser: ArgumentParser) -> None:
    for name, which in (("first", "CAL_A"), ("second", "CAL_B")):
        parser.add_argument(name, type=Path, metavar=which, help="calibration.yaml, or the folder of a result")
    what = "depths to compare at, as in 1m,2m,3m (default: those of CAL_A's scene, or where both axes meet)"
    add_text(parser, "--depths", "D1,D2,…", what)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for compare.html and compare.json")
    add_flag(parser, "--allow", "exit code 0 even if they differ")
    add_overwrite(parser, "comparison there")
    add_quiet(parser)


@_command("Make a capture from another program's frames, recognising their order.")
def of_import_(parser: ArgumentParser) -> None:
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="folder with the frames, or a recording (mp4, mov, mkv)"
    )
    add_text(parser, "--from", "FORMAT", "program that took the frames (default: all)")
    add_text(parser, "--projector", "WxH", "the projector's size, as in 1024x768")
    what = "height of the projector's pixels over their width, 0.5 for diamond arrays of mirrors (default: 1)"
    add_text(parser, "--pixel-aspect", "RATIO", what)
    add_text(parser, "--cell", "PX", "projector pixels in a cell of the Gray code (default: what fits of 1, 2 and 4)")
    what = "numbers of fringe periods across the picture, in the order of the frames, as in 59,64,70"
    add_text(parser, "--periods", "N,…", what)
    add_text(parser, "--order", "N", "number in the list, if several orders fit")
    what = "mirror the frames back, left to right (x) or top to bottom (y), if the camera or its driver mirrors them"
    parser.add_argument("--flip", choices=("x", "y"), help=what)
    add_text(parser, "--frames", "GLOB", "take only files that match a pattern, as in 'cam1_*.png'")
    parser.add_argument("--sequence", type=Path, metavar="FILE", help="for a recording: the sequence.yaml of its video")
    add_out(parser, default="only report what is recognised", metavar="CAPTURE")
    add_quiet(parser)


def _add_fill(parser: ArgumentParser) -> None:
    add_flag(parser, "--fill", "close the thing's surface where no station saw it")
