"""The report's sections as values that the template only has to lay out."""

from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np

from calib.numerics import Floats
from scanner.capture import CaptureFacts
from scanner.decoding import Decoding, MaskReason
from scanner.patterns import Gray, Pattern, Phase, Xor
from scanner.quantities import FACE_NAMES, Quantity, corner_quantities, device_quantities, percent, pose_quantities
from scanner.rendering import (
    BLUE,
    FACE_COLOURS,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    YELLOW,
    IndexedPicture,
    Pixels,
    css_colour,
    data_uri,
    photograph,
    render,
    rig_frusta,
    standard_views,
)
from scanner.reporting import maps
from scanner.reporting.contents import ReportInput

_VIEW_SIZES = {"oblique": (960, 640), "top": (560, 400), "front": (560, 400)}
_STEP = 8  # of rows and columns, which tell as well as all how bright an image is
FRUSTUM_LENGTH = 0.15  # of the scene's depth
_VIEW_CAPTIONS = {
    "oblique": "From the side and above, with the camera (blue) and the projector (red).",
    "top": "From straight above.",
    "front": "Level, from the front.",
}
_CORNER_CAPTIONS = {
    "oblique": " Walls should be flat.",
    "top": " Walls should be thin, straight lines that meet at a right angle.",
    "front": "",
}
_REASONS = {
    MaskReason.KEPT: ("matched", GREEN),
    MaskReason.DARK: ("no light from the projector", GREY),
    MaskReason.SATURATED: ("saturated: lower the exposure", VERMILION),
    MaskReason.UNDECIDED: ("too little contrast to decide a bit", YELLOW),
    MaskReason.INCONSISTENT: ("codes and fringes contradict each other", PURPLE),
    MaskReason.OUTSIDE: ("a code that no projector pixel has", SKY_BLUE),
    MaskReason.ISOLATED: ("at an occlusion edge, or alone", ORANGE),
    MaskReason.INDIRECT: ("lit more by other surfaces than by the projector", BLUE),
}


@dataclass(frozen=True)
class Picture:
    """An image for the page: a data URI, its size in pixels, and what a person sees in it, for those who cannot."""

    uri: str
    width: int
    height: int
    alt: str
    caption: str = ""


@dataclass(frozen=True)
class LegendEntry:
    """One colour of a legend, as CSS."""

    colour: str
    label: str
    share: str = ""


@dataclass(frozen=True)
class Table:
    """Quantities under a heading."""

    heading: str
    rows: tuple[Quantity, ...]


@dataclass(frozen=True)
class Faces:
    """The three faces over the white frame, with edges and letters drawn on top."""

    picture: Picture
    overlay: maps.Overlay
    legend: tuple[LegendEntry, ...]


@dataclass(frozen=True)
class ScaledMap:
    """A map with a continuous legend."""

    picture: Picture
    scale: maps.ColourScale


@dataclass(frozen=True)
class Mask:
    """Which pixels were matched, and why the others were not."""

    picture: Picture
    legend: tuple[LegendEntry, ...]


def tables(report: ReportInput) -> tuple[Table, ...]:
    """The calibration's numbers; none for a refusal."""
    calibration, truth = report.calibration, report.truth
    if calibration is None:
        return ()
    found = [Table("Camera", tuple(device_quantities("camera", calibration, truth)))]
    if not calibration.one_camera:
        found.append(Table("Projector", tuple(device_quantities("projector", calibration, truth))))
    between = "Between the photos" if calibration.one_camera else "Between them"
    found.append(Table(between, tuple(pose_quantities(calibration, truth))))
    if report.solution is not None:
        found.append(Table("Corner", tuple(corner_quantities(report.solution.corner, calibration))))
    return tuple(found)


def faces(report: ReportInput) -> Faces | None:
    """The faces over the white frame; None if none were found."""
    if not len(report.on_faces):
        return None
    width, height = report.capture.camera_size
    labels = maps.face_labels(report.matches, (width, height))
    texture = np.full((height, width), 128, dtype=np.uint8) if report.texture is None else report.texture
    painted = maps.faces_over(photograph(texture), labels)
    overlay = maps.face_overlay(
        labels,
        (width, height),
        report.solution.corner if report.solution else None,
        report.calibration.camera if report.calibration else None,
    )
    counts = [np.count_nonzero(report.matches.face == face) for face in range(3)]
    return Faces(
        picture(painted, "the camera's image with the faces of the corner in colour", jpeg=True),
        overlay,
        tuple(
            LegendEntry(css_colour(colour), f"face {name}", f"{count:,} matches")
            for name, colour, count in zip(FACE_NAMES, FACE_COLOURS, counts, strict=True)
        ),
    )


def scene(report: ReportInput) -> Picture | None:
    """The camera's image of the lit scene, where no faces were found to show in it."""
    if report.texture is None or len(report.on_faces):
        return None
    return picture(photograph(report.texture), "the camera's image under white light", jpeg=True)


def cloud_views(report: ReportInput) -> tuple[Picture, ...]:
    """Pictures of the cloud from the side, above and the front."""
    cloud, calibration = report.cloud, report.calibration
    if cloud is None or calibration is None or not report.in_cloud[0]:
        return ()
    forward = np.array([0.0, 0.0, 1.0])
    views = standard_views(forward, upright(report))
    frusta = rig_frusta(calibration, FRUSTUM_LENGTH * typical_depth(report), BLUE, VERMILION)

    def show(name: str) -> Picture:
        return picture(
            render(cloud, views[name], _VIEW_SIZES[name], [] if name == "front" else frusta),
            f"the point cloud, {name} view",
            caption=_caption(name, report.capture) + (_CORNER_CAPTIONS[name] if report.solution else ""),
        )

    return tuple(map(show, views))


def _caption(view: str, capture: CaptureFacts) -> str:
    if capture.photos and view == "oblique":
        return "From the side and above, with the places of the first photo (blue) and the second (red)."
    return _VIEW_CAPTIONS[view]


def upright(report: ReportInput) -> Floats:
    """The vertical (3,) in the camera's frame: the corner's steepest edge in the image, or the camera's own up."""
    camera_up = np.array([0.0, -1.0, 0.0])
    if report.solution is None:
        return camera_up
    legs = report.solution.corner.legs
    steepest = legs[np.argmax(np.abs(legs @ camera_up))]
    upright: Floats = steepest * np.sign(steepest @ camera_up)
    return upright


def typical_depth(report: ReportInput) -> float:
    """Median depth of the points of the cloud, in its unit."""
    assert report.cloud is not None
    return float(np.median(report.cloud.points.reshape(-1, 3)[report.in_cloud[1], 2]))


def depth(report: ReportInput) -> ScaledMap | None:
    """Depth over the camera's image."""
    if report.cloud is None or not report.in_cloud[0]:
        return None
    painted, scale = maps.depth_map(report.cloud.points, report.cloud.unit)
    return ScaledMap(picture(painted, "depth over the camera's image"), scale)


def mask(decoding: Decoding | None) -> Mask | None:
    """Why pixels have no match, as a map with shares."""
    if decoding is None:
        return None
    counts = cv2.calcHist([decoding.reasons], [0], None, [256], [0, 256]).ravel()
    present = [reason for reason in MaskReason if counts[reason]]
    return Mask(
        picture(
            maps.category_map(decoding.reasons, {int(reason): _REASONS[reason][1] for reason in present}),
            "the camera's image, coloured by why a pixel has a match or none",
        ),
        tuple(
            LegendEntry(
                css_colour(_REASONS[reason][1]),
                _REASONS[reason][0],
                percent(counts[reason] / decoding.reasons.size),
            )
            for reason in present
        ),
    )


def subtitle(capture: CaptureFacts) -> str:
    """The capture in one line."""
    frames = f", {len(capture.patterns)} frames" if capture.patterns else ""
    (width, height), (columns, rows) = capture.camera_size, capture.projector_size
    if capture.photos:
        return f"Photos of {width} × {height}."
    return f"Camera {width} × {height}, projector {columns} × {rows}{frames}."


def capture_rows(report: ReportInput) -> tuple[tuple[str, str], ...]:
    """Facts of the capture, as name and value."""
    facts = report.capture
    if facts.photos:
        rows = [("photos", "{} × {} px".format(*facts.camera_size)), ("matches", f"{len(report.matches):,}")]
        return (*rows, *facts.identity.items())
    rows = [
        ("camera", "{} × {} px".format(*facts.camera_size)),
        ("projector", "{} × {} px".format(*facts.projector_size)),
        ("matches", f"{len(report.matches):,} ({percent(report.decoded_share)} of the camera's pixels)"),
    ]
    if facts.patterns:
        rows.append(("frames", f"{len(facts.patterns)}: {describe_patterns(facts.patterns)}"))
    if facts.exposure_us:
        rows.append(("exposure", _exposures(facts)))
    if report.decoding is not None:
        rows += _about_frames(report.decoding)
    if report.decoding is not None and report.decoding.modulation is not None:
        share = 100 * report.decoding.modulation
        rows.append(("focus", f"the finest fringe keeps {share:.0f} % of the light's contrast"))
    return (*rows, *facts.identity.items())


def _about_frames(decoding: Decoding) -> list[tuple[str, str]]:
    """Saturation, noise and flicker of the frames."""
    saturated = np.count_nonzero(decoding.reasons == MaskReason.SATURATED) / decoding.reasons.size
    dark, bright = decoding.noise.sigma(np.array([0.0, float(np.percentile(decoding.texture[::_STEP, ::_STEP], 95))]))
    rows = [
        ("saturated", f"{percent(saturated)} of the pixels"),
        (
            "noise",
            f"{dark:.2g} grey levels in the dark, {bright:.2g} in the light, of {np.iinfo(decoding.texture.dtype).max}",
        ),
    ]
    if decoding.flicker is not None:
        rows.append(("flicker", f"{percent(decoding.flicker)} from frame to frame"))
    return rows


def _exposures(facts: CaptureFacts) -> str:
    low, high = min(facts.exposure_us) / 1000, max(facts.exposure_us) / 1000
    return f"{low:.4g} ms" if low == high else f"{low:.4g} to {high:.4g} ms"


def describe_patterns(patterns: tuple[Pattern, ...]) -> str:
    """A sequence in words: what kinds of patterns, and how many of each."""
    kinds = Counter(_kind(pattern) for pattern in patterns)
    return ", ".join(f"{count} × {kind}" if count > 1 else kind for kind, count in kinds.items())


def _kind(pattern: Pattern) -> str:
    if isinstance(pattern, Xor):
        return f"XOR code along {pattern.axis} (cell {pattern.cell} px)"
    if isinstance(pattern, Gray):
        return f"Gray code along {pattern.axis} (cell {pattern.cell} px)"
    if isinstance(pattern, Phase):
        return f"fringe along {pattern.axis} (period {pattern.period:g} px)"
    return type(pattern).__name__.lower()


def picture(pixels: Pixels | IndexedPicture, alt: str, *, caption: str = "", jpeg: bool = False) -> Picture:
    """Pixels as an image for the page; `jpeg` for photographs."""
    return Picture(data_uri(pixels, jpeg=jpeg), pixels.shape[1], pixels.shape[0], alt, caption)
