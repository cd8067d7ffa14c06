"""The shortest unambiguous sequence: two fringes of three steps along one axis.

The longer fringe is longer than the possible part of an epipolar line, and so unambiguous. The shorter one is as short
as the errors of the longer one allow. A first round with a quarter of the longer period measures these errors: noise,
and interreflection, which shifts long fringes by up to a sixteenth of their period in the corner of a room.
"""

from dataclasses import dataclass, replace
from math import pi, sqrt

import numpy as np

from calib.finding import FindingKind
from calib.geometry import Calibration
from calib.numerics import Floats, Image
from calib.refusal import RefusalError
from scanner.live.first_look import FirstLook
from scanner.live.unwrapping import BEYOND_SIGMAS, LEAST_SIGNAL, UNSTRAIGHT
from scanner.patterns import Axis, Phase

STEPS = 3
FRAMES = 2 * STEPS
# A pixel slips a period where the longer fringe errs by a period minus the tolerance, beyond the largest error of 999
# of 1,000 pixels. If the faintest tenth is too faint for this, it is left out.
_BRIGHTER, _MOST, _MARGIN_OF_ORDER = 0.9, 0.999, 1.1
_MARGIN = 1.05
_LEAST_PERIOD_PX, _CAMERA_PIXELS = 6.0, 4.0
_LARGEST = 0.25  # share of the longer period
_LEAST_USABLE = 100  # pixels
_GRID = 24
_FARTHEST = 1e4  # in baselines
_LEAST_SHIFT = 0.05  # share of the length of an epipolar line

NO_DEPTH = FindingKind(
    "no-depth",
    "With the given calibration, depth hardly changes the projector's coordinates.",
    "Camera and projector have to stand apart.",
)


@dataclass(frozen=True)
class LiveSequence:
    """Periods in projector pixels, `long_px` > `short_px`. `patterns`: FRAMES of them, alternating between the fringes.

    So both are taken at the same mean time. `middle` (H, W): the coordinate around which the longer fringe is
    unambiguous at each camera pixel.
    """

    axis: Axis
    long_px: float
    short_px: float
    middle: np.ndarray

    @property
    def patterns(self) -> tuple[Phase, ...]:
        """In the order in which they are shown."""
        return tuple(
            Phase(self.axis, period, step / STEPS) for step in range(STEPS) for period in (self.long_px, self.short_px)
        )

    @property
    def number(self) -> int:
        """Of the axis."""
        return 0 if self.axis == "x" else 1


def widest_sequence(calibration: Calibration, depths: tuple[float, float] | None = None) -> LiveSequence:
    """For points between two `depths`, in the calibration's unit; left out, anywhere before both devices. Its shorter
    fringe is a quarter of the longer one, which nothing takes for its neighbour.

    Raises RefusalError where depth moves nothing along either axis, as where the projector is in the camera's place.
    """
    camera = calibration.camera
    columns, rows = (np.linspace(0, size - 1, _GRID) for size in camera.size)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    spans = [np.ptp(_ends(grid, axis, calibration, depths), axis=0) for axis in (0, 1)]
    longest = [float(np.nanmax(span, initial=0.0)) for span in spans]
    # Along an epipolar line down the picture, x is constant and gives no depth.
    shifts = [np.nanmedian(_slope(grid, axis, calibration, depths)) for axis in (0, 1)]
    axis = int(np.argmax(shifts))
    if not shifts[axis] > _LEAST_SHIFT:
        raise RefusalError(
            NO_DEPTH,
            "With this calibration, depth hardly changes the projector's coordinates.",
            NO_DEPTH.remedy,
        )
    long_px = max(_MARGIN * longest[axis] + 2, 4 * _LEAST_PERIOD_PX)
    ends = _ends(camera.size.pixels.reshape(-1, 2), axis, calibration, depths)
    middle = np.mean(ends, axis=0).reshape(camera.height, camera.width).astype(np.float32)
    return LiveSequence("x" if axis == 0 else "y", long_px, _uneven(_LARGEST * long_px), middle)


def shortened(widest: LiveSequence, taken: Image, look: FirstLook, calibration: Calibration) -> LiveSequence:
    """With the shortest fringe that is not mistaken for its neighbour, from a round (6, H, W) of the widest one."""
    long_px, short_px = widest.long_px, widest.short_px
    turns = np.exp(-2j * pi * np.arange(STEPS) / STEPS).astype(np.complex64)
    # With I_n = m + a cos(θ + 2πn/3), Σ I_n exp(−2πin/3) = 3/2 a exp(iθ).
    long, short = (2 / STEPS * np.tensordot(turns, taken[first::2].astype(np.float32), 1) for first in (0, 1))
    variance = 2 / STEPS * (look.noise[0] + look.noise[1] * taken.mean(axis=0, dtype=np.float32))
    usable = look.lit & (taken.max(axis=0) < look.saturated) & (np.abs(short) > LEAST_SIGNAL * np.sqrt(variance))
    sigma = long_px / (2 * pi) * np.sqrt(variance[usable]) / np.maximum(np.abs(long[usable]), 1e-3)
    if len(sigma) < _LEAST_USABLE:
        return widest
    coarse = long_px / (2 * pi) * np.angle(long[usable])
    coarse += long_px * np.rint((widest.middle[usable] - coarse) / long_px)
    off = coarse - short_px / (2 * pi) * np.angle(short[usable])
    off = np.abs(off - short_px * np.rint(off / short_px))[sigma <= np.quantile(sigma, _BRIGHTER)]
    passes = BEYOND_SIGMAS * float(np.quantile(sigma, _BRIGHTER)) + UNSTRAIGHT * long_px
    # Projector pixels per camera pixel, if both devices are equally far from the scene.
    span = calibration.projector.focal_px[0] / calibration.camera.focal_px[0]
    least_px = max(_LEAST_PERIOD_PX, _CAMERA_PIXELS * span)
    needed_px = max(_MARGIN_OF_ORDER * (float(np.quantile(off, _MOST)) + passes), least_px)
    return replace(widest, short_px=_uneven(min(needed_px, _LARGEST * long_px)))


def _uneven(period_px: float) -> float:
    """Steps of whole pixels would round to 256 levels at the same places of every cycle."""
    return round(period_px * STEPS) / STEPS + 0.11


def _inverse_depths(calibration: Calibration, depths: tuple[float, float] | None) -> tuple[float, float]:
    """Of the far end and of the near one; the nearest that both devices could see is at half the baseline or so."""
    if depths is None:
        return 1 / (_FARTHEST * calibration.baseline), 2 / calibration.baseline
    return 1 / depths[1], 1 / depths[0]


def _ends(pixels: Floats, axis: int, calibration: Calibration, depths: tuple[float, float] | None) -> Floats:
    """The coordinate (2, N) of camera pixels (N, 2) at the far end and at the near one, within the picture."""
    length = calibration.projector.size[axis]
    far, near = _inverse_depths(calibration, depths)
    begin, towards, end = (_seen_at(pixels, depth, calibration)[:, axis] for depth in (far, 1.01 * far, near))
    # Close points leave the picture there, or are behind the projector.
    edge = np.where(towards > begin, length - 0.5, -0.5)
    ends = np.stack([begin, edge if depths is None else np.where(np.isnan(end), edge, end)])
    clipped_ends: Floats = np.clip(ends, -0.5, length - 0.5)
    return clipped_ends


def _seen_at(pixels: Floats, inverse_depth: float, calibration: Calibration) -> Floats:
    """Projector pixels (N, 2) of the points at a depth."""
    points = (
        calibration.pose.rotate(calibration.camera.unproject(pixels)) / inverse_depth + calibration.pose.translation
    )
    return calibration.projector.project(points)


def _slope(pixels: Floats, axis: int, calibration: Calibration, depths: tuple[float, float] | None) -> Floats:
    """By how much a coordinate moves, of all that the point moves in the picture, (N,)."""
    far, near = _inverse_depths(calibration, depths)
    middle = sqrt(far * near)
    moved = _seen_at(pixels, 1.001 * middle, calibration) - _seen_at(pixels, middle, calibration)
    return np.abs(moved[:, axis]) / np.maximum(np.hypot(moved[:, 0], moved[:, 1]), 1e-12)
