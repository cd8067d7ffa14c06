"""Pixels at which motion is measured, and the shifts of coordinates that small rotations of a device cause there.

The pixels are well lit and on smooth surfaces, with rough coordinates.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from math import sqrt

import numpy as np

from calib.numerics import Bools, Floats, Floats32, Ints, evenly_spread
from scanner.decoding.codes import interval_of
from scanner.decoding.coordinates import Signals
from scanner.decoding.light import TILE_PX, NoiseModel, TileSample
from scanner.decoding.motion.registration import MOST_ROUGH_PX
from scanner.decoding.motion.rigid_motion import COLUMNS, shifts_by_motion
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.decoding.significance import FEWEST_COUNTED, REFITS, SIGNIFICANT_SIGMAS


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
