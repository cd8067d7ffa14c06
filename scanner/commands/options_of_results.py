"""Commands that work on results: their options."""

from argparse import Action, ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from scanner.commands.command import NO_FILE, Address, Command, argument, count, declared, option, switch
from scanner.exporting import DEFAULT_GAMMA, DEFAULT_POINTS, FORMATS

_RESULT = "folder of a scan's result"
_NO_RESULT = "expected a result folder, found nothing"
_QUIET = "print nothing but errors"
_CAPTURE = "one capture or station of several, by its number (default: all of them)"

_USUAL_DEVIATIONS = 3.0  # of scan clean --outliers


class _Step(Action):
    """Of an option that is a step: the steps are in the order of the command line."""

    def __call__(self, _: ArgumentParser, namespace: Namespace, values: object, __: object = None) -> None:
        name = str(self.option_strings[0]).removeprefix("--")
        namespace.steps = [*(namespace.steps or ()), (name, True if values == [] else values)]


def _declare_steps(parser: ArgumentParser) -> None:
    def add(flag: str, text: str, **more: Any) -> None:
        parser.add_argument(flag, action=_Step, dest="steps", help=text, **more)

    add("--box", "keep what is between two corners, along the cloud's axes", metavar="X0,Y0,Z0,X1,Y1,Z1")
    what = "drop points whose distance from their neighbours is N standard deviations above the mean (default: 3)"
    add("--outliers", what, nargs="?", type=float, const=_USUAL_DEVIATIONS, metavar="N")
    add("--pieces", "drop pieces of the cloud that are smaller, as in 5cm", metavar="SIZE")
    what = "move each point along its normal, as far as its standard deviation allows: of one capture"
    add("--smooth", what, nargs=0)
    add("--fill", "close holes of the mesh up to a size, as in 2cm", metavar="SIZE")
    add("--triangles", "reduce the mesh to N triangles", type=int, metavar="N")
    add("--floor", "origin on the floor below the newest camera, z up, x to the camera's right", nargs=0)
    what = "origin, a point on the x axis, and one beside it on the side of y: nine lengths"
    add("--axes", what, metavar="X,Y,Z,…")


@dataclass(frozen=True, kw_only=True)
class CleanCommand(Command):
    """Do named steps to a result's cloud: a region of interest, cleaning, fewer triangles, other axes."""

    more: ClassVar[str] = """
The steps are done in the order given, after those that the result has, and are written into it as steps.yaml. Exports
and views show what they leave; the cloud in the result stays as it was measured, and --undo takes the last one back.
Without a step, those of the result are listed. Lengths may have a unit, as in 5cm; without one, they are in the
result's. A value that begins with a minus sign is given as --box=-0.5m,…
"""
    result: Path = argument("RESULT", _RESULT, existing=_NO_RESULT)
    steps: list[tuple[str, object]] | None = declared(_declare_steps)
    """By name, each with its parameter, in the order of the command line."""
    undo: bool = switch("take the last step back")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class ExportCommand(Command):
    """Write a result in another program's format and conventions."""

    result: Path = argument("RESULT", _RESULT, existing=_NO_RESULT)
    to: str = option(
        "; ".join(f"{name}: {target.about}" for name, target in FORMATS.items()),
        "FORMAT",
        required=True,
        choices=list(FORMATS),
    )
    out: Path | None = option("file to write, a folder for colmap and mapping (default: beside the result)", "PATH")
    capture: int | None = count(_CAPTURE)
    points: int | None = count(f"colmap: at most this many points (default: {DEFAULT_POINTS:,})")
    eye: str | None = option(
        "mapping: the viewer's eye, in metres in the axes of mapping.glb, as in --eye=0.5,0.2,-1 (default: straight on "
        "to the largest wall)",
        "X,Y,Z",
    )
    gamma: float | None = option(f"mapping: blend maps are stored as weight^(1/G) (default: {DEFAULT_GAMMA})", "G")
    overwrite: bool = switch("replace an earlier file of that name")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class MeasureCommand(Command):
    """Measure in a result: the form of a ball, the flatness of the faces, and distances between points."""

    more: ClassVar[str] = """
The faces are always measured. --sphere finds a ball of known diameter anywhere in the cloud; given twice, it finds two,
and measures the distance of their centres, too.
"""
    result: Path = argument("RESULT", _RESULT, existing=_NO_RESULT)
    sphere: list[str] = option(
        "find and fit a ball, as in 50.8mm; without a unit, in the result's", "DIAMETER", default=[], action="append"
    )
    distance: list[list[str]] = option(
        "distance between the points at two camera pixels; 2:X1 is a pixel of the second capture or station",
        default=[],
        action="append",
        nargs=4,
        metavar=("X1", "Y1", "X2", "Y2"),
    )
    capture: int | None = count(_CAPTURE)
    out: Path | None = option("folder for measure.json and measure.png (default: beside the result)", "DIR")
    shares: bool = switch("show where each sigma comes from")
    overwrite: bool = switch("replace an earlier measurement there")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class SectionCommand(Command):
    """Cut the surface of a result by planes: contours with their lengths."""

    more: ClassVar[str] = """
A plane is across an axis of the cloud, as in z=1.2m, or a normal and an offset, as in 0,0.6,0.8,1.2m. --every repeats
it through the whole surface. A contour is drawn through the points within two of their sigmas.
"""
    result: Path = argument("RESULT", _RESULT, existing=_NO_RESULT)
    plane: list[str] = option("plane to cut at, as in z=1.2m; may be given again", "PLANE", default=[], action="append")
    every: str | None = option("repeat each plane at this interval, as in 10cm", "INTERVAL")
    capture: int | None = count(_CAPTURE)
    out: Path | None = option("folder for section.csv, section.svg and section.dxf (default: beside the result)", "DIR")
    overwrite: bool = switch("replace an earlier section there")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class AcceptCommand(Command):
    """Test the scanner with a calibrated ball bar, after VDI/VDE 2634 part 2."""

    more: ClassVar[str] = """
Probing, sphere-spacing and flatness errors. Scan the ball bar in several places, with the rig unchanged, and give all
the results: the largest errors count.
"""
    results: list[Path] = argument("RESULT", "folders of scans' results", nargs="+", existing=_NO_RESULT)
    ball_bar: str = option(
        "calibrated diameters and distance of the centres, as in 50.02mm,50.01mm,200.13mm",
        "D1,D2,LENGTH",
        required=True,
    )
    out: Path | None = option(
        "folder for acceptance.html and acceptance.json (default: beside the first result)", "DIR"
    )
    overwrite: bool = switch("replace an earlier acceptance there")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class ViewCommand(Command):
    """Look at a result in 3-D, in the browser."""

    result: Path = argument("RESULT", f"{_RESULT}, or of a comparison of surfaces", existing=_NO_RESULT)
    address: Address = Address.part()


@dataclass(frozen=True, kw_only=True)
class RegisterCommand(Command):
    """Register clouds of any scanner with each other: poses with sigmas, and one cloud."""

    more: ClassVar[str] = """
Clouds, meshes or results, in any order and anywhere, without a first guess. All pairs are registered; poses are
estimated from those that fit in one way only, and pairs that contradict the others are left out. The frame and the unit
are those of the first cloud. Exit code 4 if no two fit together in one way, or if pairs contradict each other.
"""
    clouds: list[Path] = argument("CLOUD", "clouds, meshes, or folders of results", nargs="+", existing=NO_FILE)
    out: Path = option("folder for register.json and registered.ply", "DIR", required=True)
    overwrite: bool = switch("replace an earlier registration there")
    quiet: bool = switch(_QUIET)


@dataclass(frozen=True, kw_only=True)
class CompareCommand(Command):
    """Compare two calibrations of one rig, or a surface with its reference: where they differ, and by how many
    sigmas."""

    more: ClassVar[str] = """
Two calibrations: differences are in projector pixels and as lengths, over the camera's picture and by depth, after the
best rigid alignment. Exit codes: 0 if they agree, or neither states a covariance; 1 if they differ by more than their
standard deviations allow.

Surfaces are compared if one of the two is a cloud or a mesh (PLY, PCD, XYZ, E57, LAS, LAZ; STL, OBJ, GLB, 3MF, STEP)
or a network, or with --surfaces: the first is aligned with the second without a first guess, and the signed deviation
of every point is told with its sigma. Exit codes: 0, or 1 if a part is surely beyond the --tolerance; 4 if the
alignment is ambiguous or there is none, or if the tolerance is not decidable with this scan.
"""
    first: Path = argument("RESULT", "folder of a result, calibration.yaml, or a cloud or mesh", existing=NO_FILE)
    second: Path = argument("REFERENCE", "the same, to compare with", existing=NO_FILE)
    surfaces: bool = switch("compare the surfaces of two results, not their calibrations")
    tolerance: str | None = option(
        "largest deviation of the surface, as in 0.1mm: pass, fail, or not decidable", "LENGTH"
    )
    unit: str | None = option("unit of the reference, if its file does not say (default: found)", "UNIT")
    scale_free: bool = switch("estimate the scale of the first surface as well")
    depths: str | None = option(
        "of calibrations: depths to compare at, as in 1m,2m,3m (default: of RESULT's scene, or where both axes meet)",
        "D1,D2,…",
    )
    out: Path | None = option(
        "folder for compare.html, compare.json, and of surfaces both as coloured clouds and meshes", "DIR"
    )
    allow: bool = switch("exit code 0 even if they differ")
    overwrite: bool = switch("replace an earlier comparison there")
    quiet: bool = switch(_QUIET)
