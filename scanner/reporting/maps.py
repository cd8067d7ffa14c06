"""Maps over the camera's image, as pictures for a web page: faces, depth, residuals, mask reasons."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Corner, Intrinsics, Size
from calib.numerics import Bools, Floats, Ints
from scanner.quantities import FACE_NAMES
from scanner.rendering import (
    FACE_COLOURS,
    LONGEST_SIDE,
    SIGNED,
    Colour,
    ColourScale,
    IndexedPicture,
    Map,
    Pixels,
    as_pixels,
    averaged,
    css_colour,
    extent,
    labels_on_grid,
    part_of,
    reduced_size,
)

_FACE_OPACITY = 0.5
# Noise compresses badly; the eye distinguishes about this many steps in a map.
_RESIDUAL_STEPS = 25
_EDGE_SAMPLES = 400
_SAMPLE = 100_000


_DEPTHS = part_of(cv2.COLORMAP_VIRIDIS, 30, 247)
_SIGMAS = part_of(cv2.COLORMAP_CIVIDIS, 25, 255)


@dataclass(frozen=True)
class Overlay:
    """Vector marks over a picture, in the camera's pixels: edge polylines as SVG point lists, and letters."""

    width: int
    height: int
    edges: tuple[str, ...]
    letters: tuple[tuple[str, float, float], ...]


def face_labels(camera_px: Floats, face: Ints, camera: Size) -> Pixels:
    """Which face is where, 1, 2, 3, or 0 for none: the image of the `camera` (width, height), reduced.

    From matches with a `face` (N,) at pixels (N, 2).
    """
    return labels_on_grid(camera_px, face, camera, reduced_size(*camera))


def faces_over(background: Pixels, labels: Pixels) -> Pixels:
    """Faces in colour over a grey `background` (h, w, 3), as `labels` (h, w) says."""
    grey = np.asarray(cv2.cvtColor(background, cv2.COLOR_RGB2GRAY), np.uint8)
    covered = np.zeros_like(labels)
    for face in range(1, len(FACE_COLOURS) + 1):
        np.maximum(covered, _closed(labels == face) * np.uint8(face), out=covered)
    greys = np.repeat(np.arange(256.0)[:, None], 3, axis=1)
    shades = [greys, *((1 - _FACE_OPACITY) * greys + _FACE_OPACITY * np.array(colour) for colour in FACE_COLOURS)]
    painted: Pixels = as_pixels(np.concatenate(shades))[covered * np.uint16(256) + grey]
    return painted


def _closed(mask: Bools) -> Pixels:
    """A mask, 0 or 1, without the gaps that sparse matches leave."""
    kernel = np.ones((5, 5), np.uint8)
    return np.asarray(cv2.morphologyEx(mask.view(np.uint8), cv2.MORPH_CLOSE, kernel), np.uint8)


def face_overlay(labels: Pixels, camera_size: Size, corner: Corner | None, camera: Intrinsics | None) -> Overlay:
    """The faces' letters, and where the corner's edges should be if the calibration is right."""
    letters = []
    for face, name in enumerate(FACE_NAMES, start=1):
        on_face = labels == face
        if on_face.any():
            x, y = (
                (_median_place(on_face.sum(axis=axis)) + 0.5) * full / small - 0.5
                for axis, (full, small) in enumerate(zip(camera_size, labels.shape[::-1], strict=True))
            )
            letters.append((name, x, y))
    edges = []
    if corner is not None and camera is not None:
        edges = [_edge(corner.vertex, leg, camera) for leg in corner.legs]
    return Overlay(*camera_size, tuple(edge for edge in edges if edge), tuple(letters))


def _median_place(counts: Ints) -> float:
    """The median of the numbers 0, 1, …, which occur this often."""
    cumulated = np.cumsum(counts)
    return float(np.searchsorted(cumulated, cumulated[-1] / 2))


def _edge(vertex: Floats, leg: Floats, camera: Intrinsics) -> str:
    """One edge from the vertex to the image's border, or as far as the lens model reaches, as SVG points."""
    reach = float(np.linalg.norm(vertex)) * np.geomspace(1e-3, 1e2, _EDGE_SAMPLES)
    along = vertex + np.concatenate([[0.0], reach])[:, None] * leg
    pixels = camera.project(along)
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels >= -0.5) & (pixels <= (camera.width - 0.5, camera.height - 0.5)), axis=1)
    if not inside.any():
        return ""
    # Beyond the first exit, the distortion polynomial may bend the line back into the image.
    first = int(np.argmax(inside))
    leaves = np.flatnonzero(~inside[first:])
    visible = pixels[first : first + int(leaves[0]) if len(leaves) else None]
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in visible)


def _cropped(values: Map) -> Map:
    """The part of a map (H, W), NaN for nothing, in which there is something, and a margin."""
    top, bottom, left, right = extent(values)
    if bottom < top:
        return values
    margin = max(2, max(values.shape) // 50)
    return values[max(0, top - margin) : bottom + margin + 1, max(0, left - margin) : right + margin + 1]


def _reduced(values: Map, longest_side: int = LONGEST_SIDE) -> Map:
    """A map (H, W), NaN for none, reduced by averaging valid values."""
    return averaged(values, reduced_size(values.shape[1], values.shape[0], longest_side))


def _painted(values: Map, low: float, high: float, shades: Pixels, steps: int = 255) -> IndexedPicture:
    """Transparent for NaN, of values clipped to low … high in a number of steps."""
    there = np.isfinite(values)
    position = np.clip((np.where(there, values, np.float32(low)) - low) / max(high - low, 1e-30), 0, 1)
    chosen = shades[np.rint(np.linspace(0, len(shades) - 1, steps)).astype(np.intp)]
    palette = np.zeros((steps + 1, 4), np.uint8)
    palette[1:, :3], palette[1:, 3] = chosen, 255
    return IndexedPicture((np.rint(position * (steps - 1)).astype(np.uint8) + np.uint8(1)) * there, palette)


def _legend(shades: Pixels, low: str, high: str) -> ColourScale:
    chosen = shades[np.rint(np.linspace(0, len(shades) - 1, 12)).astype(np.intp)]
    return ColourScale(tuple(css_colour((int(r), int(g), int(b))) for r, g, b in chosen), low, high)


def on_grid(pixel: Floats, values: Floats, size: Size, step: int) -> Map:
    """Values (N,) at pixels (N, 2) of an image of (width, height), on a grid `step` times as coarse, NaN for none."""
    grid: Map = np.full(((size.height - 1) // step + 1, (size.width - 1) // step + 1), np.nan, np.float32)
    cell = np.floor((pixel + 0.5) / step).astype(np.int64)
    column, row = (np.clip(cell[:, axis], 0, grid.shape[1 - axis] - 1) for axis in (0, 1))
    grid[row, column] = values
    return grid


def depth_map(points: NDArray[np.float32], unit: str) -> tuple[IndexedPicture, ColourScale]:
    """Depth z of a cloud (H, W, 3) in colour, near to far."""
    depth = _reduced(_cropped(points[..., 2]))
    there = depth[np.isfinite(depth)]
    low, high = np.percentile(there[:: max(1, len(there) // _SAMPLE)], (0.5, 99.5)) if len(there) else (0.0, 1.0)
    name = "baselines" if unit == "baseline" else unit
    legend = _legend(_DEPTHS, f"{low:.3g} {name}", f"{high:.3g} {name}")
    return _painted(depth, float(low), float(high), _DEPTHS), legend


def sigma_map(percent: Map) -> tuple[IndexedPicture, ColourScale]:
    """Relative standard deviations (h, w) on a coarse grid in colour, enlarged, low to high."""
    low, high = (float(value) for value in np.nanpercentile(percent, (1, 99)))
    factor = max(1, LONGEST_SIDE // max(percent.shape))
    painted = _painted(_cropped(percent), low, high, _SIGMAS)
    enlarged = IndexedPicture(painted.index.repeat(factor, axis=0).repeat(factor, axis=1), painted.palette)
    return enlarged, _legend(_SIGMAS, f"{low:.2g} %", f"{high:.2g} %")


def signed_map(
    values: Map, limit: float, unit: str, longest_side: int = LONGEST_SIDE
) -> tuple[IndexedPicture, ColourScale]:
    """Values (H, W) of either sign, NaN for none, in two colours around light grey, ± `limit`."""
    legend = _legend(SIGNED, f"−{limit:.2g} {unit}", f"+{limit:.2g} {unit}")
    return _painted(_reduced(_cropped(values), longest_side), -limit, limit, SIGNED, _RESIDUAL_STEPS), legend


def category_map(categories: Pixels, colours: dict[int, Colour]) -> IndexedPicture:
    """An image of numbers (H, W) in colours; numbers without one are transparent."""
    palette = np.zeros((256, 4), dtype=np.uint8)
    for number, colour in colours.items():
        palette[number] = (*colour, 255)
    size = reduced_size(categories.shape[1], categories.shape[0])
    small = cv2.resize(categories, size, interpolation=cv2.INTER_NEAREST)
    return IndexedPicture(np.asarray(small, np.uint8), palette)
