"""Pixels at which motion is measured, and the shifts of coordinates that small rotations of a device cause there.

The pixels are well lit and on smooth surfaces, with rough coordinates.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from math import sqrt

import numpy as np

from calib.numerics import Bools, Floats, Floats32, Ints, evenly_spread, fit_huber
from scanner.decoding.codes import interval_of
from scanner.decoding.coordinates import Signals
from scanner.decoding.light import TILE_PX, NoiseModel, TileSample
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.decoding.significance import FEWEST_COUNTED, HUBER_ROUNDS, HUBER_SIGMAS, REFITS, SIGNIFICANT_SIGMAS

# Parameters of each device: shifts to the right and down, a roll and a change of scale.
PER_DEVICE = 4
COLUMNS = 2 * PER_DEVICE
# Focal length of an ordinary lens, in widths of the image. It matters in the corners only.
_FOCAL_OF_WIDTH = 1.2
# Prior standard deviation, which keeps unobservable parameters small.
PRIOR_PX = 1.0


@dataclass(frozen=True)
class RigidFit:
    """A motion of projector and camera. For each device: shifts, roll and change of scale, in its px (roll and scale:
    at half the width from the centre).
    """

    motion: Floats
    """(8,): of the projector, then of the camera."""
    covariance: Floats
    """(8, 8)"""
    gained: float
    """Decrease of χ²."""

    @property
    def significance(self) -> float:
        """Distance of the motion from zero, in standard deviations."""
        return sqrt(max(float(self.motion @ np.linalg.solve(self.covariance, self.motion)), 0.0))


def shifts_by_motion(
    camera_px: Floats, projector_px: Floats, gradient: Floats, camera_size: tuple[int, int], size: tuple[int, int]
) -> Floats:
    """Return the derivative (P, 2, 8) of the coordinates of pixels (P, 2) by each part of the motion.

    `gradient` (P, 2, 2): derivative of the projector coordinates (rows) by camera x and y. Sizes are (width, height).
    """
    by_motion = np.zeros((len(camera_px), 2, COLUMNS))
    # A picture that moves to the right takes its coordinates along: a fixed point sees those from further left.
    by_motion[:, :, :PER_DEVICE] = -_of_picture(projector_px, size)
    by_motion[:, :, PER_DEVICE:] = -gradient @ _of_picture(camera_px, camera_size)
    return by_motion


def _of_picture(px: Floats, size: tuple[int, int]) -> Floats:
    """Return the shifts (P, 2, 4) of a picture at pixels (P, 2) when its device pans, tilts, rolls or zooms."""
    half, focal = size[0] / 2, _FOCAL_OF_WIDTH * size[0]
    x, y = ((px - (np.array(size) - 1) / 2) / focal).T
    roll = focal / half
    ones = np.ones_like(x)
    horizontal = np.stack([ones + x * x, x * y, -y * roll, x * roll], axis=1)
    vertical = np.stack([x * y, ones + y * y, x * roll, y * roll], axis=1)
    return np.stack([horizontal, vertical], axis=1)


def fit_motion(design: Floats, seen_px: Floats, precision: Floats, group: Ints) -> RigidFit:
    """Fit the motion to `seen_px` (R,) = `design` (R, 8) · motion, with `precision` (R,), robustly (Huber).

    Correlated errors within a `group` (R,) of rows are included in the covariance.
    """
    root = np.sqrt(precision)
    expected, at_rest = np.eye(COLUMNS) / PRIOR_PX, np.zeros(COLUMNS)
    terms = np.concatenate([(design * root[:, None]).T, expected], axis=1)
    fit = fit_huber(terms, np.append(seen_px * root, at_rest), HUBER_SIGMAS, HUBER_ROUNDS)
    return RigidFit(
        fit.parameters, fit.covariance(np.append(group, np.max(group, initial=-1) + 1 + np.arange(COLUMNS))), fit.gained
    )


# Largest rms distance from a plane, in projector px: tiles on edges or curved surfaces are rejected.
MOST_ROUGH_PX = 0.7


@dataclass(frozen=True)
class ObservedFringes:
    """The fringes of a capture as motion is measured in them; sizes are (width, height)."""

    plan: SequencePlan
    """Of the sequence."""
    tiles: TileSample
    """P pixels of the frames."""
    signals: tuple[Signals, Signals]
    """There, along x and y."""
    noise: NoiseModel
    """Of a pixel."""
    saturation: float
    """The lowest clipped grey level."""
    projector_size: tuple[int, int]
    """Of the projector's picture."""

    @property
    def axes(self) -> Iterator[tuple[AxisPlan, Signals]]:
        """Both axes with their signals."""
        return zip(self.plan.axes, self.signals, strict=True)


@dataclass(frozen=True)
class MotionPixels:
    """P pixels at which motion is measured."""

    number: Ints
    """(P,): in a `TileSample`."""
    tile: Ints
    """(P,): the tile of each."""
    camera_px: Floats
    """(P, 2)"""
    projector_px: Floats
    """(P, 2): rough coordinates from the longest fringes."""
    gradient: Floats
    """(P, 2, 2): their derivative by camera x and y."""
    by_motion: Floats
    """(P, 2, 8): that by the motion of the devices."""
    noise: Floats
    """(P,): variance of the grey level."""

    @cached_property
    def by_motion32(self) -> Floats32:
        """(8, 2, P): the same in single precision, parts first."""
        return np.ascontiguousarray(self.by_motion.transpose(2, 1, 0), np.float32)

    @property
    def every_other(self) -> "MotionPixels":
        """Half of the pixels."""
        return MotionPixels(*(getattr(self, field.name)[::2] for field in fields(self)))


def choose_pixels(fringes: ObservedFringes) -> MotionPixels | None:
    """Return some usable pixels of the tiles; None if they are too few or their coordinates are unknown."""
    tiles, white = fringes.tiles, fringes.signals[0].peak
    if not tiles.count or not all(axis.fringes for axis in fringes.plan.axes):
        return None
    usable = np.asarray(white < fringes.saturation) & tiles.static
    coordinates = []
    for axis, of_axis in fringes.axes:
        coordinate, visible = _rough_coordinate(axis, of_axis, fringes.noise)
        if coordinate is None:
            return None
        coordinates.append(coordinate)
        usable &= visible
    projector_px = np.stack(coordinates, axis=1)
    planes, usable = _planes(tiles, projector_px, usable)
    number = evenly_spread(np.flatnonzero(usable))
    # Errors are alike within a tile: fewer tiles than unknowns would fit any motion.
    if len(np.unique(tiles.tile[number])) <= COLUMNS:
        return None
    camera_px, projector_px = tiles.camera_px[number], projector_px[number]
    gradient, camera_size = planes[tiles.tile[number]][:, 1:].transpose(0, 2, 1), tiles.shape[::-1]
    return MotionPixels(
        number,
        tiles.tile[number],
        camera_px,
        projector_px,
        gradient,
        shifts_by_motion(camera_px, projector_px, gradient, camera_size, fringes.projector_size),
        fringes.noise.variance(fringes.signals[0].threshold[number]).astype(np.float64),
    )


def _rough_coordinate(axis: AxisPlan, signals: Signals, noise: NoiseModel) -> tuple[Floats | None, Bools]:
    """Return the coordinate (P,) from longest fringe and Gray code, and whether all fringes are visible."""
    variance = noise.variance(signals.threshold)
    visible = np.ones(len(variance), np.bool_)
    for number, fringe in enumerate(axis.fringes):
        cosine, sine = signals.fringe(number)
        visible &= cosine**2 + sine**2 > SIGNIFICANT_SIGMAS**2 * fringe.noise_gain**2 * variance
    period = axis.fringes[0].period
    if not axis.codes:
        if period < axis.length:
            return None, visible
        centre = np.full(len(variance), period / 2)
    else:
        interval = interval_of(axis, signals.words, len(variance))
        visible &= interval.possible
        centre = interval.centre.astype(np.float64)
    cosine, sine = signals.fringe(0)
    position = np.arctan2(sine, cosine).astype(np.float64) * period / (2 * np.pi)
    return position + period * np.rint((centre - position) / period), visible


def _planes(tiles: TileSample, projector_px: Floats, usable: Bools) -> tuple[Floats, Bools]:
    """Fit planes (tiles, 3, 2), offset and slopes by camera x and y, to the coordinates; also return the inliers."""
    offset = tiles.camera_px[: TILE_PX**2] - tiles.camera_px[: TILE_PX**2].mean(axis=0)
    terms = np.concatenate([np.ones((TILE_PX**2, 1)), offset], axis=1)  # of every tile alike
    products = (terms[:, :, None] * terms[:, None]).reshape(len(terms), -1)
    on = usable.reshape(tiles.count, TILE_PX**2)
    coordinates, fit = np.where(on, projector_px.T.reshape(2, *on.shape), 0.0), on
    for _ in range(REFITS):
        normal = (fit @ products).reshape(-1, 3, 3) + 1e-9 * np.eye(3)
        planes: Floats = np.linalg.solve(normal, np.moveaxis((fit * coordinates) @ terms, 0, 2))
        off = np.sum((coordinates - np.moveaxis(planes, 2, 0) @ terms.T) ** 2, axis=0)
        count = np.count_nonzero(fit, axis=1)
        rough = np.sqrt(np.sum(fit * off, axis=1) / np.maximum(count, 1))
        fit = on & (off <= np.maximum(SIGNIFICANT_SIGMAS / sqrt(2) * rough, 1e-3)[:, None] ** 2)
    smooth = (rough < MOST_ROUGH_PX) & (count >= FEWEST_COUNTED)
    return planes, (fit & smooth[:, None]).reshape(-1)
