"""What the points' colours say."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats
from scanner.quantities import FACE_NAMES, shown_unit
from scanner.rendering import CIVIDIS, FACE_COLOURS, GREY, shaded
from scanner.viewing.result import ViewedCloud

_NAMED_SHADES = ("dark blue", "grey", "yellow")
_FACE_WORDS = ("orange", "sky blue", "green")
_SHOWN_SHARE = (0.01, 0.99)
_NOISE_ALONE = (
    "It is that of the single point, from the decoder's noise; errors of the calibration move neighbouring points "
    "alike and are stated below."
)
_BOTH = (
    "It comes from the decoder's noise, which moves each point by itself, and from the calibration's covariance, which "
    "moves neighbouring points alike. The unit of length is not part of it."
)


class Colouring(StrEnum):
    """What can be shown in colour."""

    CAMERA = "Camera's colours"
    FACES = "Faces"
    SIGMA = "Uncertainty of depth"


@dataclass(frozen=True)
class Coloured:
    """`colours` (n, 3) RGB of points, and a `legend` in words (Markdown)."""

    colours: NDArray[np.uint8]
    legend: str


def possible_colourings(cloud: ViewedCloud) -> tuple[Colouring, ...]:
    """What is known of every point of a cloud."""
    known = [Colouring.CAMERA]
    if cloud.has_faces:
        known.append(Colouring.FACES)
    if cloud.has_sigma:
        known.append(Colouring.SIGMA)
    return tuple(known)


def coloured(cloud: ViewedCloud, chosen: NDArray[np.int64], colouring: Colouring) -> Coloured:
    """The colours of the points at `chosen` (n,). Raises ValueError for what is not known of this cloud."""
    if colouring not in possible_colourings(cloud):
        raise ValueError(f"this cloud cannot be coloured by {colouring}")
    match colouring:
        case Colouring.CAMERA:
            return Coloured(_brightened(cloud.colours[chosen]), "The colours are what the camera saw, brightened.")
        case Colouring.FACES:
            return _by_face(cloud, chosen)
        case Colouring.SIGMA:
            source = _NOISE_ALONE if cloud.uncertainty is None else _BOTH
            return _by_sigma(cloud.depth_sigma(chosen), cloud.unit, source)


def _brightened(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Stretched and brightened for the eye, as the report's photographs are."""
    if not len(colours):
        return colours
    white = max(1.0, float(np.percentile(colours, 99.5)))
    return np.asarray(np.rint(255 * np.clip(colours / white, 0, 1) ** (1 / 1.8)), np.uint8)


def _by_face(cloud: ViewedCloud, chosen: NDArray[np.int64]) -> Coloured:
    assert cloud.scan.matches.face is not None
    face = cloud.scan.matches.face[chosen]
    table = np.array([*FACE_COLOURS, GREY], np.uint8)
    named = ", ".join(f"{name} {word}" for name, word in zip(FACE_NAMES, _FACE_WORDS, strict=True))
    index = np.where((face >= 0) & (face < len(FACE_COLOURS)), face, len(FACE_COLOURS))
    return Coloured(table[index], f"Faces: {named}; grey: on none of them.")


def _by_sigma(sigma: Floats, unit: str, source: str) -> Coloured:
    low, high = (float(value) for value in np.quantile(sigma, _SHOWN_SHARE)) if len(sigma) else (0.0, 1.0)
    share = np.clip((sigma - low) / max(high - low, np.finfo(np.float64).tiny), 0, 1)
    colours = shaded(share, CIVIDIS)
    shown = shown_unit(unit)
    values = (low, (low + high) / 2, high)
    named = ", ".join(f"{shade} {shown.error(value)}" for shade, value in zip(_NAMED_SHADES, values, strict=True))
    return Coloured(
        colours,
        f"Standard deviation of the depth: {named}. {source}",
    )
