"""The report's sections as values that the template only has to lay out."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats
from calib.pointcloud import Cloud
from scanner.capture import CaptureMetadata
from scanner.decoding import Decoding, MaskReason
from scanner.io import block_yaml
from scanner.patterns import Gray, Pattern, Phase, Xor
from scanner.quantities import FACE_NAMES, Quantity, device_quantities, percent, pose_quantities, shown_unit
from scanner.rendering import (
    BLACK,
    BLUE,
    BROWN,
    FACE_COLOURS,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    YELLOW,
    ColourScale,
    IndexedPicture,
    Pixels,
    css_colour,
    jpeg_uri,
    photograph,
    png_uri,
    render,
    rig_frusta,
    standard_views,
)
from scanner.reporting import maps
from scanner.reporting.contents import ReportInput
from scanner.results import Provenance, ResultKind

_SIDE = 640


def on_paper(pixels: Pixels) -> Pixels:
    """RGB (H, W, 3), or RGBA on white, reduced, as it is on the page a second time: RGB (h, w, 3)."""
    if pixels.shape[2] == 4:
        share = pixels[..., 3:].astype(np.float32) / 255
        pixels = np.rint(share * pixels[..., :3] + 255 * (1 - share)).astype(np.uint8)
    factor = min(1.0, _SIDE / max(pixels.shape[:2]))
    return np.asarray(cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8)


_VIEW_SIZES = {"oblique": (960, 640), "top": (560, 400), "front": (560, 400)}
_STEP = 8  # subsampling of rows and columns for mean brightness
_STRAYS = 0.001  # at each end of a cloud's extent
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
    MaskReason.MOVED: ("something moved there", BROWN),
    MaskReason.ALONG_EPIPOLAR_LINE: ("stripes along the epipolar line, which carry no depth", BLACK),
}


@dataclass(frozen=True)
class PageImage:
    """An image for the page: a data URI, its size in pixels, and a description for screen readers.

    `on_paper`: that of the first printed page, if it may be there.
    """

    uri: str
    width: int
    height: int
    alt: str
    caption: str = ""
    on_paper: "PageImage | None" = None


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
class FacesPicture:
    """The three faces over the white frame, with edges and letters drawn on top."""

    picture: PageImage
    overlay: maps.Overlay
    legend: tuple[LegendEntry, ...]


@dataclass(frozen=True)
class ScaledMap:
    """A map with a continuous legend."""

    picture: PageImage
    scale: ColourScale


@dataclass(frozen=True)
class Mask:
    """Which pixels were matched, and why the others were not."""

    picture: PageImage
    legend: tuple[LegendEntry, ...]


def tables(report: ReportInput) -> tuple[Table, ...]:
    """The calibration's numbers; none for a refusal."""
    if report.reconstructed is None:
        return ()
    calibration, truth = report.reconstructed.calibration, report.truth
    tables = [Table("Camera", tuple(device_quantities("camera", calibration, truth)))]
    if not calibration.one_camera:
        tables.append(Table("Projector", tuple(device_quantities("projector", calibration, truth))))
    between = "Between the photos" if calibration.one_camera else "Between them"
    tables.append(Table(between, tuple(pose_quantities(calibration, truth))))
    if report.solution is not None:
        tables.append(Table("Corner", tuple(_angles(report))))
    return tuple(tables)


def _angles(report: ReportInput) -> Iterator[Quantity]:
    scene = report.scene
    for angle in scene.angles if scene else ():
        yield Quantity(f"angle {'–'.join(angle.faces)}", angle.angle_deg, "°", angle.budget.sigma)


def faces(report: ReportInput) -> FacesPicture | None:
    """The faces over the white frame; None if none were found."""
    face, reconstructed = report.matches.face, report.reconstructed
    if face is None or not len(report.on_faces):
        return None
    size, texture = report.metadata.camera_size, report.outcome.decoded.texture
    labels = maps.face_labels(report.matches.camera_px, face, size)
    background = np.full((size.height, size.width), 128, dtype=np.uint8) if texture is None else texture
    painted = maps.faces_over(photograph(background), labels)
    overlay = maps.face_overlay(
        labels,
        size,
        report.solution.corner if report.solution else None,
        reconstructed.calibration.camera if reconstructed else None,
    )
    return FacesPicture(
        photo(painted, "the camera's image with the faces of the corner in colour"),
        overlay,
        tuple(
            LegendEntry(css_colour(colour), f"face {name}", f"{count:,} matches")
            for name, colour, count in zip(FACE_NAMES, FACE_COLOURS, report.matches.on_each_face, strict=True)
        ),
    )


def scene(report: ReportInput) -> PageImage | None:
    """The camera's image of the lit scene, where no faces were found to show in it."""
    texture = report.outcome.decoded.texture
    if texture is None or len(report.on_faces):
        return None
    return photo(photograph(texture), "the camera's image under white light")


def cloud_views(report: ReportInput) -> tuple[PageImage, ...]:
    """Pictures of the cloud from the side, above and the front."""
    if report.reconstructed is None or not len(report.in_cloud):
        return ()
    cloud, calibration = report.reconstructed.cloud, report.reconstructed.calibration
    forward = np.array([0.0, 0.0, 1.0])
    views = standard_views(forward, upright(report))
    frusta = rig_frusta(calibration, FRUSTUM_LENGTH * typical_depth(report, cloud), BLUE, VERMILION)

    def show(name: str) -> PageImage:
        drawn = render(cloud, views[name], _VIEW_SIZES[name], [] if name == "front" else frusta)
        caption = _caption(name, report.metadata) + (_CORNER_CAPTIONS[name] if report.solution else "")
        return view(drawn, name, "the point cloud", caption)

    return tuple(map(show, views))


def _caption(view: str, capture: CaptureMetadata) -> str:
    if capture.photos and view == "oblique":
        return "From the side and above, with the places of the first photo (blue) and the second (red)."
    return _VIEW_CAPTIONS[view]


def upright(report: ReportInput) -> Floats:
    """The vertical (3,) in the camera's frame: the corner's steepest edge in the image, or the camera's own up."""
    return np.array([0.0, -1.0, 0.0]) if report.solution is None else report.solution.corner.up


def typical_depth(report: ReportInput, cloud: Cloud) -> float:
    """Median depth of the points of the report's cloud, in its unit."""
    return float(np.median(cloud.points.reshape(-1, 3)[report.in_cloud, 2]))


def depth(report: ReportInput) -> ScaledMap | None:
    """Depth over the camera's image."""
    if report.reconstructed is None or not len(report.in_cloud):
        return None
    cloud = report.reconstructed.cloud
    painted, scale = maps.depth_map(cloud.points, cloud.unit)
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


def configuration(provenance: Provenance | None) -> str:
    """The settings as YAML; '' where none are known."""
    if provenance is None or not provenance.configuration:
        return ""
    return block_yaml(provenance.configuration)


def subtitle(capture: CaptureMetadata) -> str:
    """The capture in one line."""
    frames = f", {len(capture.patterns)} frames" if capture.patterns else ""
    if capture.photos:
        return f"Photos of {capture.camera_size}."
    return f"Camera {capture.camera_size}, projector {capture.projector_size}{frames}."


def capture_rows(report: ReportInput) -> tuple[tuple[str, str], ...]:
    """Facts of the capture, as name and value."""
    metadata = report.metadata
    if metadata.photos:
        rows = [("photos", f"{metadata.camera_size} px"), ("matches", f"{len(report.matches):,}")]
        return (*rows, *metadata.identity.items())
    rows = [
        ("camera", f"{metadata.camera_size} px"),
        ("projector", f"{metadata.projector_size} px"),
        ("matches", f"{len(report.matches):,} ({percent(report.decoded_share)} of the camera's pixels)"),
    ]
    if metadata.patterns:
        rows.append(("frames", f"{len(metadata.patterns)}: {describe_patterns(metadata.patterns)}"))
    if metadata.exposure_us:
        rows.append(("exposure", _exposures(metadata)))
    decoding = report.outcome.decoded.decoding
    if decoding is not None:
        rows += _about_frames(decoding)
    if decoding is not None and decoding.modulation is not None:
        share = 100 * decoding.modulation
        rows.append(("focus", f"the finest fringe keeps {share:.0f} % of the light's contrast"))
    return (*rows, *metadata.identity.items())


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


def _exposures(metadata: CaptureMetadata) -> str:
    low, high = min(metadata.exposure_us) / 1000, max(metadata.exposure_us) / 1000
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


def picture(pixels: Pixels | IndexedPicture, alt: str, *, caption: str = "") -> PageImage:
    """Pixels as an image for the page."""
    return PageImage(png_uri(pixels), pixels.shape[1], pixels.shape[0], alt, caption)


def view(pixels: Pixels, name: str, of: str, caption: str) -> PageImage:
    """A view of a cloud, RGBA, as an image for the page; the oblique one is for paper, too."""
    alt = f"{of}, {name} view"
    drawn = picture(pixels, alt, caption=caption)
    return replace(drawn, on_paper=_printed(pixels, alt, caption)) if name == "oblique" else drawn


def photo(pixels: Pixels, alt: str) -> PageImage:
    """A photograph as an image for the page, and for paper."""
    return PageImage(jpeg_uri(pixels), pixels.shape[1], pixels.shape[0], alt, on_paper=_printed(pixels, alt))


def _printed(pixels: Pixels, alt: str, caption: str = "") -> PageImage:
    small = on_paper(pixels)
    return PageImage(jpeg_uri(small), small.shape[1], small.shape[0], alt, caption)


def files_beside(page: Path, kind: ResultKind) -> list[tuple[str, str]]:
    """The files beside a page of that kind with what they are, by name."""
    names = sorted({path.name for path in page.parent.iterdir()} - {page.name})
    return [(name, kind.files[name]) for name in names if name in kind.files]


def extent_row(points: NDArray[np.floating], unit: str, axes: str) -> tuple[str, str, str]:
    """The size of a cloud (N, 3) as a row of measures, without its strays."""
    low, high = np.quantile(points, (_STRAYS, 1 - _STRAYS), axis=0)
    length_unit = shown_unit(unit)
    size = " × ".join(length_unit.number(float(length)) for length in high - low)
    return "extent", f"{size} {length_unit.name}", f"of the cloud along {axes}, without 0.1 % of strays at each end"
