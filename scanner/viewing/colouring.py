"""Colourings of the points."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Matches
from calib.numerics import Floats, Ints
from scanner.quantities import FACE_NAMES, ShownUnit, plain, shown_unit
from scanner.rendering import CIVIDIS, FACE_COLOURS, GREY, SIGNED, VIRIDIS, Pixels, shaded
from scanner.viewing.result import CaptureCloud, CloudWithSigma, DeviationCloud, ViewedCloud

_FACE_WORDS = ("orange", "sky blue", "green")
_SHOWN_SHARE = (0.01, 0.99)
_NOISE_ALONE = (
    "It contains the decoder's noise, which is independent at each point. Errors of the calibration, which move "
    "neighbouring points together, are stated below."
)
_BOTH = (
    "It contains the decoder's noise, which is independent at each point, and the calibration's covariance, which "
    "moves neighbouring points together. The uncertainty of the scale is not part of it."
)
_DEVIATION = (
    "Distance of each point from the plane through its face, + towards the camera; grey: on no face. The "
    "flatness below summarises it."
)
_FROM_REFERENCE = (
    "Distance of each point from the reference, + outside of it; grey: the reference has no surface there. The report, "
    "compare.html, has sigmas and regions."
)


class Colouring(StrEnum):
    """What the colours of the points can show."""

    CAMERA = "Camera's colours"
    FACES = "Faces"
    DEPTH = "Depth"
    DEVIATION = "Distance from the faces"
    SIGMA = "Uncertainty of depth"
    REFERENCE = "Distance from the reference"


@dataclass(frozen=True)
class ColourBar:
    """`shades` (n, 3) RGB from the low to the high end, and the labels at both ends and in the middle."""

    shades: Pixels
    low: str
    middle: str
    high: str


@dataclass(frozen=True)
class Coloured:
    """`colours` (n, 3) RGB of points, a `legend` in words (Markdown), and the `bar` where colours are numbers."""

    colours: NDArray[np.uint8]
    legend: str
    bar: ColourBar | None = None


def possible_colourings(cloud: ViewedCloud) -> tuple[Colouring, ...]:
    """Return the colourings for which every point of a cloud has a value."""
    if isinstance(cloud, DeviationCloud):
        return (Colouring.REFERENCE,)
    known = [Colouring.CAMERA]
    if isinstance(cloud, CaptureCloud):
        known += [Colouring.FACES] if cloud.matches.face is not None else []
        known += [Colouring.DEPTH]
        known += [Colouring.DEVIATION] if cloud.scene.faces and cloud.matches.face is not None else []
        known += [Colouring.SIGMA] if cloud.has_sigma else []
    return tuple(known)


def coloured(cloud: ViewedCloud, chosen: NDArray[np.int64], colouring: Colouring) -> Coloured:
    """The colours of the points at `chosen` (n,). Raises ValueError if the cloud lacks the quantity."""
    match cloud, colouring:
        case _, Colouring.CAMERA:
            return Coloured(_brightened(cloud.colours[chosen]), "The colours are what the camera saw, brightened.")
        case CaptureCloud(matches=Matches(face=face)), Colouring.FACES if face is not None:
            return _by_face(face[chosen])
        case CaptureCloud(), Colouring.DEPTH:
            return _by_size(cloud.points[chosen, 2], VIRIDIS, shown_unit(cloud.unit), "Distance before the camera.")
        case CaptureCloud(matches=Matches(face=face)), Colouring.DEVIATION if face is not None:
            return _by_deviation(cloud.from_faces(chosen), shown_unit(cloud.unit), _DEVIATION)
        case DeviationCloud(deviation=deviation), Colouring.REFERENCE:
            return _by_deviation(deviation[chosen], shown_unit(cloud.unit), _FROM_REFERENCE, cloud.tolerance)
        case CloudWithSigma(sigma=sigma), Colouring.SIGMA:
            return _by_size(sigma[chosen], CIVIDIS, shown_unit(cloud.unit), f"Standard deviation. {_NOISE_ALONE}")
        case CaptureCloud(has_sigma=True), Colouring.SIGMA:
            source = _NOISE_ALONE if cloud.uncertainty is None else _BOTH
            legend = f"Standard deviation of the depth. {source}"
            return _by_size(cloud.depth_sigma(chosen), CIVIDIS, shown_unit(cloud.unit), legend)
        case _:
            raise ValueError(f"this cloud cannot be coloured by {colouring}")


def _brightened(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Stretched and brightened for the eye, as the report's photographs are."""
    if not len(colours):
        return colours
    white = max(1.0, float(np.percentile(colours, 99.5)))
    return np.asarray(np.rint(255 * np.clip(colours / white, 0, 1) ** (1 / 1.8)), np.uint8)


def _by_face(face: Ints) -> Coloured:
    table = np.array([*FACE_COLOURS, GREY], np.uint8)
    named = ", ".join(f"{name} {word}" for name, word in zip(FACE_NAMES, _FACE_WORDS, strict=True))
    index = np.where((face >= 0) & (face < len(FACE_COLOURS)), face, len(FACE_COLOURS))
    return Coloured(table[index], f"Faces: {named}; grey: on none of them.")


def _by_size(values: Floats, shades: Pixels, unit: ShownUnit, legend: str) -> Coloured:
    low, high = (float(value) for value in np.quantile(values, _SHOWN_SHARE)) if len(values) else (0.0, 1.0)
    share = np.clip((values - low) / max(high - low, np.finfo(np.float64).tiny), 0, 1)
    bar = ColourBar(shades, unit.error(low), unit.error((low + high) / 2), unit.error(high))
    return Coloured(shaded(share, shades), legend, bar)


def _by_deviation(off: Floats, unit: ShownUnit, legend: str, limit: float | None = None) -> Coloured:
    known = np.isfinite(off)
    if limit is None:
        limit = float(np.quantile(np.abs(off[known]), _SHOWN_SHARE[1])) if known.any() else 1.0
    share = np.clip((np.where(known, off, 0.0) / max(limit, np.finfo(np.float64).tiny) + 1) / 2, 0, 1)
    colours = shaded(share, SIGNED)
    colours[~known] = GREY
    ends = (unit.error(end, signed=True) for end in (-limit, limit))
    bar = ColourBar(SIGNED, next(ends), f"{plain(0.0, 0)} {unit.name}", next(ends))
    return Coloured(colours, legend, bar)
