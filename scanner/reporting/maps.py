"""Maps over the camera's image, as pictures for a web page: faces, depth, residuals, mask reasons."""

import base64
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import Bools, Floats, Image
from calib.camera import Intrinsics
from calib.corner import Corner
from calib.matches import NO_FACE, Matches

# Okabe & Ito (2008): told apart by every kind of colour vision, and in print.
ORANGE, SKY_BLUE, GREEN, YELLOW = (230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66)
BLUE, VERMILION, PURPLE, GREY = (0, 114, 178), (213, 94, 0), (204, 121, 167), (140, 140, 140)
FACE_COLOURS = (ORANGE, SKY_BLUE, GREEN)
FACE_NAMES = ("A", "B", "C")
CATEGORY_COLOURS = (VERMILION, SKY_BLUE, YELLOW, PURPLE, GREEN, ORANGE, BLUE, GREY)

LONGEST_SIDE = 1000
_FACE_OPACITY = 0.5
# Noise compresses badly; this many steps are as many as an eye tells apart in a map of it.
_RESIDUAL_STEPS = 25
_EDGE_SAMPLES = 400
# Higher levels take several times as long for a few per cent.
_PNG_LEVEL = 3
_LETTER_SAMPLE = 20_000

Pixels = NDArray[np.uint8]
Colour = tuple[int, int, int]


def _part_of(colour_map: int, first: int, last: int) -> Pixels:
    """A part of one of OpenCV's colour maps, RGB (n, 3)."""
    shades = cv2.applyColorMap(np.arange(first, last + 1, dtype=np.uint8)[:, None], colour_map)
    return np.ascontiguousarray(shades[:, 0, ::-1])


def _between(low: Colour, middle: Colour, high: Colour) -> Pixels:
    """Shades from one colour to another through a third, RGB (n, 3)."""
    places = np.linspace(0, 2, 255)
    return _as_pixels(np.stack([np.interp(places, (0, 1, 2), ends) for ends in zip(low, middle, high, strict=True)], 1))


def _as_pixels(values: Floats) -> Pixels:
    return np.ascontiguousarray(np.rint(values), dtype=np.uint8)


# All of them can be told from a white and from a black page, and by every kind of colour vision.
# Whole tables, dark to bright; both have the same order of shades to every kind of colour vision.
VIRIDIS, CIVIDIS = _part_of(cv2.COLORMAP_VIRIDIS, 0, 255), _part_of(cv2.COLORMAP_CIVIDIS, 0, 255)
_DEPTHS = _part_of(cv2.COLORMAP_VIRIDIS, 30, 247)
_SIGMAS = _part_of(cv2.COLORMAP_CIVIDIS, 25, 255)
_SIGNED = _between((0, 84, 166), (226, 226, 226), (186, 62, 0))


@dataclass(frozen=True)
class ColourScale:
    """A continuous legend: CSS colours from the low to the high end, and what the ends mean."""

    colours: tuple[str, ...]
    low: str
    high: str


@dataclass(frozen=True)
class Overlay:
    """Vector marks over a picture, in the camera's pixels: edge polylines as SVG point lists, and letters."""

    width: int
    height: int
    edges: tuple[str, ...]
    letters: tuple[tuple[str, float, float], ...]


def data_uri(picture: Pixels, *, jpeg: bool = False) -> str:
    """RGB or RGBA (H, W, 3 or 4) as a data URI; `jpeg` for photographs, which must be RGB."""
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA if picture.shape[2] == 4 else cv2.COLOR_RGB2BGR)
    kind, options = (
        ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, 85]) if jpeg else ("png", [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])
    )
    written, encoded = cv2.imencode(f".{kind}", bgr, options)
    assert written, "OpenCV encodes PNG and JPEG in every build"
    return f"data:image/{kind};base64,{base64.b64encode(encoded.tobytes()).decode('ascii')}"


def css_colour(colour: Colour) -> str:
    """#rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def photograph(texture: Image) -> Pixels:
    """The camera's image of the lit scene for the eye: RGB (H, W, 3), reduced, stretched and brightened."""
    small = _reduced_photograph(texture)
    white = max(1.0, float(np.percentile(small, 99.5)))
    shown = 255 * np.clip(small / white, 0, 1) ** (1 / 1.8)
    rgb = shown[..., ::-1] if shown.ndim == 3 else np.repeat(shown[..., None], 3, axis=2)
    return _as_pixels(rgb)


def _reduced_photograph(texture: Image) -> Floats:
    small = cv2.resize(texture, _reduced_size(texture.shape[1], texture.shape[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float64)


def _reduced_size(width: int, height: int, longest_side: int = LONGEST_SIDE) -> tuple[int, int]:
    factor = min(1.0, longest_side / max(width, height))
    return max(1, round(width * factor)), max(1, round(height * factor))


def faces_over(background: Pixels, matches: Matches, camera: tuple[int, int]) -> Pixels:
    """Faces in colour over a grey `background` (H, W, 3); `camera` is the (width, height) of the matches' image."""
    height, width = background.shape[:2]
    assert matches.face is not None
    labels = np.full((height, width), NO_FACE, dtype=np.int32)
    column, row = (
        np.floor((matches.camera_px[:, axis] + 0.5) * (small / full)).astype(np.int32)
        for axis, (small, full) in enumerate(zip((width, height), camera, strict=True))
    )
    shown = np.flatnonzero((matches.face >= 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height))
    labels[row[shown], column[shown]] = matches.face[shown]
    picture = np.asarray(cv2.cvtColor(cv2.cvtColor(background, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB), np.uint8)
    for face, colour in enumerate(FACE_COLOURS):
        covered = np.nonzero(_closed(labels == face))
        picture[covered] = _as_pixels((1 - _FACE_OPACITY) * picture[covered] + _FACE_OPACITY * np.array(colour))
    return picture


def _closed(mask: Bools) -> Bools:
    """A mask without the gaps that sparse matches leave."""
    kernel = np.ones((5, 5), np.uint8)
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0, np.bool_)


def face_overlay(
    matches: Matches, camera_size: tuple[int, int], corner: Corner | None, camera: Intrinsics | None
) -> Overlay:
    """The faces' letters, and where the corner's edges should be if the calibration is right."""
    assert matches.face is not None
    letters = []
    for face, name in enumerate(FACE_NAMES):
        members = np.flatnonzero(matches.face == face)
        if len(members):
            x, y = np.median(matches.camera_px[members[:: max(1, len(members) // _LETTER_SAMPLE)]], axis=0)
            letters.append((name, float(x), float(y)))
    edges = []
    if corner is not None and camera is not None:
        edges = [_edge(corner.vertex, leg, camera) for leg in corner.legs]
    return Overlay(*camera_size, tuple(edge for edge in edges if edge), tuple(letters))


def _edge(vertex: Floats, leg: Floats, camera: Intrinsics) -> str:
    """One edge from the vertex to the image's border, or as far as the lens model reaches, as SVG points."""
    reach = float(np.linalg.norm(vertex)) * np.geomspace(1e-3, 1e2, _EDGE_SAMPLES)
    along = vertex + np.concatenate([[0.0], reach])[:, None] * leg
    pixels = camera.project(along)
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels >= -0.5) & (pixels <= (camera.width - 0.5, camera.height - 0.5)), axis=1)
    if not inside.any():
        return ""
    # Beyond the first way out the distortion's polynomial may bend the line back into the image.
    first = int(np.argmax(inside))
    leaves = np.flatnonzero(~inside[first:])
    visible = pixels[first : first + int(leaves[0]) if len(leaves) else None]
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in visible)


def _cropped(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The part of a map (H, W), NaN for nothing, in which there is something, and a margin."""
    there = np.isfinite(values)
    if not there.any():
        return values
    rows, columns = (np.flatnonzero(there.any(axis=axis)) for axis in (1, 0))
    margin = max(2, max(values.shape) // 50)
    top, left = max(0, int(rows[0]) - margin), max(0, int(columns[0]) - margin)
    return values[top : int(rows[-1]) + margin + 1, left : int(columns[-1]) + margin + 1]


def shaded(share: NDArray[np.floating], shades: Pixels) -> Pixels:
    """RGB (..., 3) of shares from 0 to 1 (...), by a table of shades."""
    count = len(shades)
    return np.asarray(shades[np.minimum(share * count, count - 1).astype(np.intp)], np.uint8)


def _reduced(values: NDArray[np.float32], longest_side: int = LONGEST_SIDE) -> NDArray[np.float32]:
    """A map (H, W) with NaN for nothing, reduced by averaging what is there."""
    size = _reduced_size(values.shape[1], values.shape[0], longest_side)
    there = np.isfinite(values)
    weight = cv2.resize(there.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(there, values, np.float32(0)), size, interpolation=cv2.INTER_AREA)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weight > 0, total / weight, np.nan).astype(np.float32)


def _painted(values: NDArray[np.float32], low: float, high: float, shades: Pixels, steps: int = 256) -> Pixels:
    """RGBA, transparent for NaN, of values clipped to low … high in a number of steps."""
    there = np.isfinite(values)
    position = np.clip((np.where(there, values, low) - low) / max(high - low, 1e-30), 0, 1)
    chosen = shades[np.rint(np.linspace(0, len(shades) - 1, steps)).astype(np.intp)]
    table = np.concatenate([chosen, np.full((steps, 1), 255, np.uint8)], axis=1)
    painted: Pixels = table[np.rint(position * (steps - 1)).astype(np.intp)]
    painted[~there] = 0
    return painted


def _legend(shades: Pixels, low: str, high: str) -> ColourScale:
    chosen = shades[np.rint(np.linspace(0, len(shades) - 1, 12)).astype(np.intp)]
    return ColourScale(tuple(css_colour((int(r), int(g), int(b))) for r, g, b in chosen), low, high)


def depth_map(points: NDArray[np.float32], unit: str) -> tuple[Pixels, ColourScale]:
    """Depth z of a cloud (H, W, 3) in colour, near to far."""
    depth = _reduced(_cropped(points[..., 2]))
    low, high = np.nanpercentile(depth, (0.5, 99.5)) if np.isfinite(depth).any() else (0.0, 1.0)
    name = "baselines" if unit == "baseline" else unit
    legend = _legend(_DEPTHS, f"{low:.3g} {name}", f"{high:.3g} {name}")
    return _painted(depth, float(low), float(high), _DEPTHS), legend


def sigma_map(percent: NDArray[np.float32]) -> tuple[Pixels, ColourScale]:
    """Relative standard deviations (h, w) on a coarse grid in colour, enlarged, low to high."""
    low, high = (float(value) for value in np.nanpercentile(percent, (1, 99)))
    factor = max(1, LONGEST_SIDE // max(percent.shape))
    painted = _painted(_cropped(percent), low, high, _SIGMAS)
    enlarged: Pixels = painted.repeat(factor, axis=0).repeat(factor, axis=1)
    return enlarged, _legend(_SIGMAS, f"{low:.2g} %", f"{high:.2g} %")


def signed_map(
    values: NDArray[np.float32], limit: float, unit: str, longest_side: int = LONGEST_SIDE
) -> tuple[Pixels, ColourScale]:
    """Values (H, W) of either sign, NaN for none, in two colours around light grey, ± `limit`."""
    legend = _legend(_SIGNED, f"−{limit:.2g} {unit}", f"+{limit:.2g} {unit}")
    return _painted(_reduced(_cropped(values), longest_side), -limit, limit, _SIGNED, _RESIDUAL_STEPS), legend


def category_map(categories: NDArray[np.uint8], colours: dict[int, Colour]) -> Pixels:
    """RGBA of an image of numbers (H, W); numbers without a colour are transparent."""
    table = np.zeros((256, 4), dtype=np.uint8)
    for number, colour in colours.items():
        table[number] = (*colour, 255)
    size = _reduced_size(categories.shape[1], categories.shape[0])
    painted: Pixels = table[cv2.resize(categories, size, interpolation=cv2.INTER_NEAREST)]
    return painted
