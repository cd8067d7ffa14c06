"""Make docs/images/views.png: what the camera sees of a corner from good and from bad places, and what comes of it.

    python docs/make_view_pictures.py

Each view is calibrated from synthetic matches; what stands below its picture is what the program answers.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.geometry import Intrinsics, Matches
from calib.numerics import Floats
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, self_calibrate
from calib.synthetic import look_at
from scanner.rendering import FACE_COLOURS

TARGET = Path(__file__).parent / "images" / "views.png"
CAMERA = Intrinsics(1224, 1024, (895.0, 895.0), (628.0, 527.0))
PROJECTOR = Intrinsics(854, 480, (1247.0, 1247.0), (377.0, 234.0))
_UP = np.array([0.0, 0.0, 1.0])
_NOISE_PX = 0.05
_DARK, _COLUMNS = 0.28, 3


@dataclass(frozen=True)
class Place:
    """Where camera and projector are in metres, the corner being at the origin of a room with x, y, z > 0, z up."""

    title: str
    camera: tuple[float, float, float]
    projector: tuple[float, float, float]
    target: tuple[float, float, float] = (0.25, 0.25, 0.3)


_GOOD = (0.9, 0.5, 2.2)
PLACES = (
    Place("Good: off the diagonal, baseline across", _GOOD, (1.3, 0.2, 2.0)),
    Place("Good: low, faces at different slants", (2.3, 1.5, 0.45), (2.7, 1.2, 0.25)),
    Place("Weak: along the diagonal", (1.7, 1.4, 1.4), (2.1, 1.1, 1.1)),
    Place("Bad: camera and projector too close", _GOOD, (0.93, 0.48, 2.19)),
    Place("Bad: one behind the other", _GOOD, (1.15, 0.63, 2.72)),
    Place("Bad: too far away", (2.7, 1.5, 6.6), (3.1, 1.2, 6.4)),
    Place("Bad: a face through the camera's centre", (2.3, 1.5, 0.03), (2.7, 1.2, 0.25)),
    Place("Bad: baseline parallel to two faces", _GOOD, (1.4, 0.5, 2.2)),
    Place("Bad: two faces", _GOOD, (1.3, 0.2, 2.0), (0.2, 0.9, 0.0)),
)


@dataclass(frozen=True)
class Seen:
    """Of pixels (N, 2) of the camera: `face` (N,), and whether the projector lights them, at `projector_px` (N, 2)."""

    face: Floats
    projector_px: Floats
    lit: Floats


def see(place: Place, pixels: Floats) -> Seen:
    """Cast the camera's rays onto the three walls, and from there to the projector."""
    eye, other, target = (np.array(point) for point in (place.camera, place.projector, place.target))
    to_camera, to_projector = look_at(eye, target, _UP), look_at(other, target, _UP)
    rays = CAMERA.unproject(pixels) @ to_camera
    with np.errstate(divide="ignore"):
        lengths = -eye / rays
    lengths[~(lengths > 0)] = np.inf
    face = np.argmin(lengths, axis=1)
    points = eye + lengths[np.arange(len(rays)), face, None] * rays
    projector_px = PROJECTOR.project((points - other) @ to_projector.T)
    with np.errstate(invalid="ignore"):
        lit = np.all((projector_px >= 0) & (projector_px <= (PROJECTOR.width - 1, PROJECTOR.height - 1)), axis=1)
    return Seen(face, projector_px, lit)


def answer(place: Place, squareness_deg: float) -> str:
    """What the program says of matches of this view."""
    grid = np.stack(np.meshgrid(np.arange(0, CAMERA.width, 8.0), np.arange(0, CAMERA.height, 8.0)), -1).reshape(-1, 2)
    seen = see(place, grid)
    noise = np.random.default_rng(0).normal(0, _NOISE_PX, (int(seen.lit.sum()), 2))
    matches = Matches(grid[seen.lit], seen.projector_px[seen.lit] + noise, seen.face[seen.lit].astype(np.int32))
    sizes = (CAMERA.width, CAMERA.height), (PROJECTOR.width, PROJECTOR.height)
    known = PrincipalPoint(CAMERA.principal_point_px, 0.0)
    try:
        found = self_calibrate(matches, *sizes, principal_point=known, squareness_deg=squareness_deg).calibration
    except RefusalError as refusal:
        return f"refused: {refusal.reason}"
    sigma = found.sigma["camera_focal_px"]
    assert isinstance(sigma, float)
    return f"± {100 * sigma / found.camera.focal_px[0]:.2g} %"


def draw(axes: Axes, place: Place) -> None:
    """The camera's picture: faces in colour where the projector lights them, dark elsewhere."""
    step = 3
    x, y = np.meshgrid(np.arange(0, CAMERA.width, step, dtype=float), np.arange(0, CAMERA.height, step, dtype=float))
    seen = see(place, np.stack([x.ravel(), y.ravel()], axis=1))
    colours = np.array(FACE_COLOURS)[seen.face] * np.where(seen.lit, 1.0, _DARK)[:, None]
    axes.imshow(colours.reshape(*x.shape, 3).astype(np.uint8), interpolation="bilinear")
    axes.set_xticks([])
    axes.set_yticks([])
    square, real = answer(place, 0.0), answer(place, 0.3)
    below = square if square.startswith("refused") else f"focal length {square} if the walls are square"
    if not square.startswith("refused"):
        below += f"\n{real} if they may be off by 0.3°" if not real.startswith("refused") else f"\nreal walls: {real}"
    print(f"{place.title}: {square} | {real}")
    axes.set_title(place.title, fontsize=12, fontweight="bold", loc="left")
    axes.set_xlabel(_wrapped(below), fontsize=10, loc="left")


def _wrapped(text: str, width: int = 52) -> str:
    lines = []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split():
            if line and len(line) + len(word) >= width:
                lines.append(line)
                line = ""
            line = f"{line} {word}".strip()
        lines.append(line)
    return "\n".join(lines[:4]) + (" …" if len(lines) > 4 else "")


def main() -> None:
    """Write the picture."""
    rows = -(-len(PLACES) // _COLUMNS)
    figure = Figure(figsize=(12.6, 4.9 * rows), dpi=80, layout="constrained")
    every = figure.subplots(rows, _COLUMNS).ravel()
    for place, axes in zip(PLACES, every, strict=True):
        draw(axes, place)
    figure.savefig(TARGET, metadata={"Software": None})
    print(TARGET)


if __name__ == "__main__":
    main()
