"""Arguments of each command. This file imports nothing that does the work, so that help appears at once."""

from argparse import Action, ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path

from scanner.commands.rigs import RIGS
from scanner.commands.shared_arguments import (
    add_calibration,
    add_config,
    add_masks,
    add_new_result,
    add_number,
    add_out,
    add_overwrite,
    add_paths,
    add_quiet,
    add_result,
)
from scanner.exporting import DEFAULT_GAMMA, DEFAULT_POINTS, FORMATS
from scanner.viewing.opening import add_address

_LONGEST_WATCH_S = 3600.0
_INSTEAD = "known calibration of the rig, used instead of calibrating"


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
    parser.add_argument(
        "--object", action="store_true", help="with --stations and --calibration: scan a thing that you turn in between"
    )
    add_calibration(parser, "with --object: calibration of the rig")
    _add_fill(parser)
    add_out(parser, default="scans/<name of the configuration>")
    add_overwrite(parser)
    add_masks(parser)
    add_quiet(parser)


def of_replay(parser: ArgumentParser) -> None:
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="folder with a capture.yaml and its frames")
    add_config(parser, required=False)
    add_calibration(parser, _INSTEAD)
    add_masks(parser)
    add_new_result(parser, default="scans/<name of the capture>")


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
    parser.add_argument("--memory", metavar="SIZE", help="memory of each process, as in 4GB (default: an equal share)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running Dask scheduler, as in tcp://10.0.0.1:8786")
    parser.add_argument("--retry", action="store_true", help="retry captures that crashed in an earlier run")
    add_quiet(parser)


def of_import(parser: ArgumentParser) -> None:
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="folder with the frames, or a recording (mp4, mov, mkv)"
    )
    parser.add_argument("--from", metavar="FORMAT", help="program that took the frames (default: all)")
    parser.add_argument("--projector", metavar="WxH", help="the projector's size, as in 1024x768")
    parser.add_argument("--cell", metavar="PX", help="projector pixels in a cell of the Gray code (default: 1)")
    parser.add_argument(
        "--periods",
        metavar="N,…",
        help="numbers of fringe periods across the picture, in the order of the frames, as in 59,64,70",
    )
    parser.add_argument("--order", metavar="N", help="number in the list, if several orders fit")
    parser.add_argument("--frames", metavar="GLOB", help="take only files that match a pattern, as in 'cam1_*.png'")
    parser.add_argument("--sequence", type=Path, metavar="FILE", help="for a recording: the sequence.yaml of its video")
    add_out(parser, default="only report what is recognised", metavar="CAPTURE")
    add_quiet(parser)


def of_calibrate(parser: ArgumentParser) -> None:
    add_paths(
        parser,
        "matches",
        "MATCHES",
        "matches.npz, or a result folder; several of one unchanged rig are calibrated together, the newest last; "
        "one may be a result of scan board",
    )
    add_config(parser, required=True)
    add_new_result(parser)


def of_new(parser: ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="configuration to write, as in my-rig.yaml")
    rigs = "; ".join(f"{name}: {rig.about}" for name, rig in RIGS.items())
    parser.add_argument(
        "--rig", choices=list(RIGS), default="simulated", metavar="NAME", help=f"{rigs} (default: simulated)"
    )
    add_overwrite(parser, "file of that name")
    add_quiet(parser)


def of_patterns(parser: ArgumentParser) -> None:
    add_config(parser, required=True)
    parser.add_argument("--video", metavar="NAME", help="also write a video for any player, as in sequence.mp4")
    parser.add_argument("--hold", metavar="TIME", help="with --video: how long each picture is shown (default: 0.2s)")
    what = "with --video: how many times the pictures are shown, forwards and backwards (default: 1)"
    add_number(parser, "--loops", what)
    add_out(parser)
    add_quiet(parser)


def _seconds(text: str) -> float:
    seconds = float(text)  # argparse reports text that is no number
    if not 0 <= seconds <= _LONGEST_WATCH_S:
        raise ArgumentTypeError(f"expected 0 to {_LONGEST_WATCH_S:.0f} seconds, found {text}")
    return seconds


def of_check(parser: ArgumentParser) -> None:
    add_config(parser, required=True)
    parser.add_argument(
        "--write", action="store_true", help="put the exposure and the projector's response into the configuration file"
    )
    parser.add_argument(
        "--watch",
        type=_seconds,
        default=0.0,
        metavar="SECONDS",
        help="seconds to look for drift, as in 60 (default: the duration of the other checks)",
    )
    add_out(parser, "folder to make, for check.yaml and pictures", default="nothing is kept")
    add_quiet(parser)


def of_export(parser: ArgumentParser) -> None:
    add_result(parser)
    formats = "; ".join(f"{name}: {target.about}" for name, target in FORMATS.items())
    parser.add_argument("--to", required=True, choices=list(FORMATS), metavar="FORMAT", help=formats)
    what = "file to write, a folder for colmap and mapping"
    add_out(parser, what, default="beside the result", metavar="PATH")
    add_number(parser, "--points", f"colmap: at most this many points (default: {DEFAULT_POINTS:,})")
    parser.add_argument(
        "--eye",
        metavar="X,Y,Z",
        help="mapping: the viewer's eye, in metres in the axes of mapping.glb, as in --eye=0.5,0.2,-1 "
        "(default: straight on to the largest wall)",
    )
    parser.add_argument(
        "--gamma",
        type=float,
        metavar="G",
        help=f"mapping: blend maps are stored as weight^(1/G) (default: {DEFAULT_GAMMA})",
    )
    add_overwrite(parser, "file of that name")
    add_quiet(parser)


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
        type=float,
        action="append",
        default=[],
        metavar=("X1", "Y1", "X2", "Y2"),
        help="distance between the points at two camera pixels",
    )
    add_out(parser, "folder for measure.json and measure.png", default="beside the result")
    parser.add_argument("--shares", action="store_true", help="show where each sigma comes from")
    add_overwrite(parser, "measurement there")
    add_quiet(parser)


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


def of_view(parser: ArgumentParser) -> None:
    add_result(parser)
    add_address(parser)


def of_console(parser: ArgumentParser) -> None:
    add_config(parser, required=True)
    add_calibration(parser, "for live clouds: of the rig (default: the newest result's)")
    add_address(parser)


def of_photos(parser: ArgumentParser) -> None:
    add_paths(parser, "photos", "PHOTO", "photos of one corner by one camera at one zoom")
    parser.add_argument(
        "--matches",
        type=Path,
        metavar="FILE",
        help="matches.npz of two photos: camera_px in the first, projector_px in the second",
    )
    add_masks(parser)
    parser.add_argument(
        "--exif-prior", action="store_true", help="use the EXIF focal length (± 5 %%), which is otherwise only shown"
    )
    parser.add_argument("--dense", action="store_true", help="match every pixel of the first two photos: dense.ply")
    add_config(parser, required=False)
    add_new_result(parser)


def of_board(parser: ArgumentParser) -> None:
    add_paths(parser, "captures", "CAPTURE", "folder with a capture.yaml, or with several of those", nargs="*")
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


def of_room(parser: ArgumentParser) -> None:
    add_paths(parser, "stations", "STATION", "captures, results or matches.npz, in any order")
    add_config(parser, required=True)
    add_calibration(parser, "known calibration of the rig: no station needs a corner")
    add_new_result(parser)


def of_network(parser: ArgumentParser) -> None:
    what = "folders named <camera>-<projector>, in any order; none to capture with the devices in rigs of --config"
    add_paths(parser, "captures", "CAPTURE", what, nargs="*")
    add_config(parser, required=False)
    parser.add_argument(
        "--distance", metavar="A,B,LENGTH", help="known distance between two devices, as in left,stage,2.35m"
    )
    add_new_result(parser, default="scans/network")


def of_object(parser: ArgumentParser) -> None:
    what = "captures, results or matches.npz, in any order; a thing's folder stands for its stations"
    add_paths(parser, "stations", "STATION", what)
    add_config(parser, required=True)
    add_calibration(parser, "known calibration of the rig", required=True)
    _add_fill(parser)
    add_new_result(parser)


def of_live(parser: ArgumentParser) -> None:
    add_config(parser, required=True)
    add_calibration(parser, "known calibration of the rig", required=True)
    add_number(parser, "--clouds", "keep N clouds, then end")
    parser.add_argument("--room", action="store_true", help="the rig moves in a room (default: a thing is moved)")
    parser.add_argument("--every", metavar="TIME", help="keep a cloud at this interval, as in 2s")
    parser.add_argument(
        "--depths", metavar="NEAR,FAR", help="range of depths, as in 0.3m,0.6m, for finer clouds (default: any)"
    )
    parser.add_argument("--page", action="store_true", help="show the clouds on a page in the browser, too")
    add_address(parser)
    add_new_result(parser, default="scans/<name of the configuration>-live")


def _add_fill(parser: ArgumentParser) -> None:
    parser.add_argument("--fill", action="store_true", help="close the thing's surface where no station saw it")


def of_compare(parser: ArgumentParser) -> None:
    for name, which in (("first", "CAL_A"), ("second", "CAL_B")):
        parser.add_argument(name, type=Path, metavar=which, help="calibration.yaml, or the folder of a result")
    parser.add_argument(
        "--depths",
        metavar="D1,D2,…",
        help="depths to compare at, as in 1m,2m,3m (default: those of CAL_A's scene, or where both axes meet)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for compare.html and compare.json")
    add_overwrite(parser, "comparison there")
    add_quiet(parser)
