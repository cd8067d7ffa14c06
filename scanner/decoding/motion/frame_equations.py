"""Linear equations for the motion of each frame, at the pixels of small tiles.

To first order, a shift by d changes a frame I by −∇I · d. All fringes show the same scene under the same mean light, so
that 1 + 2 F numbers per pixel explain N frames of F fringes. The remainder is linear in all shifts d.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Ints
from scanner.decoding.arrays import Floats32
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.samples import TILE_PX, TileSample
from scanner.decoding.sequence_plan import Fringe, SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS, SIGNIFICANT_SIGMAS
from scanner.decoding.slopes import LEVEL, SLOPE
from scanner.decoding.subsampling import evenly_spread

# Noise reduction by the taps along both axes, as a factor of the variance.
_LESS_NOISE = float(np.sum(LEVEL**2)) ** 2


@dataclass(frozen=True)
class FrameEquations:
    """Residuals of N frames at P pixels, in K directions that no fringe explains, and their derivatives.

    `times` (N,): positions of the frames in the sequence. `axis` (N,): 0 for x, 1 for y. `tile` (P,): tile of each
    pixel. `seen` (K, P): residuals in standard deviations. Their derivatives (., K, P): `by_camera` (2 N, ...), by the
    shift of each frame to the right, then down; `by_projector` (N, ...), by the shift of its pattern along its axis;
    `by_light`, by gains, offsets and the brightness curve.
    """

    times: Ints
    axis: Ints
    tile: Ints
    seen: Floats
    by_camera: Floats
    by_projector: Floats
    by_light: Floats


def frame_equations(
    plan: SequencePlan, tiles: TileSample, noise: NoiseModel, saturation: float
) -> FrameEquations | None:
    """Return the equations for the frames of all fringes; None if there are too few usable pixels or frames."""
    shown = sorted(
        (time, number, fringe.frames.index(frame))
        for time, frame in enumerate(plan.shown)
        for number, fringe in enumerate(plan.fringes)
        if frame in fringe.frames
    )
    times, of_fringe = np.array([time for time, *_ in shown]), np.array([number for _, number, _ in shown])
    fringes = [plan.fringes[number] for number in of_fringe]
    angles = 2 * np.pi * np.array([fringe.shifts[k] for fringe, (*_, k) in zip(fringes, shown, strict=True)])
    design = _design(of_fringe, angles, len(plan.fringes))
    if len(times) <= design.shape[1]:
        return None
    images = tiles.of_frames(times.tolist(), np.arange(len(tiles.tile))).reshape(len(times), -1, TILE_PX, TILE_PX)
    blurred, by_right, by_down = (_filtered(images, *taps) for taps in ((LEVEL, LEVEL), (LEVEL, SLOPE), (SLOPE, LEVEL)))
    pixels = _pixels(plan.fringes, blurred, design, noise, _resting(tiles, images, saturation))
    if len(pixels) < FEWEST_PIXELS:
        return None
    levels, right, down = (part[:, pixels].astype(np.float64) for part in (blurred, by_right, by_down))
    parameters = np.linalg.pinv(design) @ levels
    cosine, sine = parameters[1:].reshape(len(plan.fringes), 2, -1)[of_fringe].transpose(1, 0, 2)
    phase, amplitude = np.arctan2(sine, cosine) + angles[:, None], np.hypot(cosine, sine)
    steepness = 2 * np.pi / np.array([fringe.period for fringe in fringes])[:, None]
    fitted = design @ parameters
    # An orthonormal basis of the residuals of the fringe model.
    beside = np.linalg.svd(design)[0][:, design.shape[1] :]
    sigma = np.sqrt(_LESS_NOISE * noise.variance(levels.mean(axis=0)).astype(np.float64))

    def of_each(column: Floats) -> Floats:
        """Return the derivatives (N, K, P) by each frame's own parameter, from the change (N, P) that it makes."""
        changes: Floats = beside[:, :, None] * (column / sigma)[:, None, :]
        return changes

    # A nonlinear brightness curve leaves a second harmonic in each fringe, the same in all pixels.
    harmonics = [of_each(amplitude * wave(2 * phase)) for wave in (np.cos, np.sin)]
    curve = [part[of_fringe == number].sum(axis=0) for part in harmonics for number in range(len(plan.fringes))]
    mean = np.broadcast_to(fitted.mean(axis=0), fitted.shape)
    return FrameEquations(
        times,
        np.array([fringe.axis == "y" for fringe in fringes], np.int64),
        np.repeat(np.arange(tiles.count), blurred.shape[1] // tiles.count)[pixels],
        beside.T @ levels / sigma,
        np.concatenate([of_each(-right), of_each(-down)]),
        of_each(steepness * amplitude * np.sin(phase)),
        np.concatenate([of_each(fitted), of_each(mean), np.stack(curve)]),
    )


def _design(of_fringe: Ints, angles: Floats, fringes: int) -> Floats:
    """Return the design matrix (N, 1 + 2 F) of the mean light, and of A cos θ and A sin θ of each fringe."""
    design = np.zeros((len(angles), 1 + 2 * fringes))
    design[:, 0] = 1
    every = np.arange(len(angles))
    design[every, 1 + 2 * of_fringe], design[every, 2 + 2 * of_fringe] = np.cos(angles), -np.sin(angles)
    return design


def _filtered(images: Floats32, down: Floats, across: Floats) -> Floats32:
    """Filter tiles (N, T, tile, tile) by taps along columns and rows, where the taps lie inside the tile; (N, P)."""
    size = images.shape[-1] - len(down) + 1
    # A matrix product of a few taps made OpenBLAS warn of invalid values that do not exist.
    rows = np.zeros((*images.shape[:2], size, images.shape[3]), np.float32)
    for k, tap in enumerate(down.astype(np.float32)):
        rows += tap * images[:, :, k : k + size]
    both = np.zeros((*rows.shape[:3], size), np.float32)
    for k, tap in enumerate(across.astype(np.float32)):
        both += tap * rows[..., k : k + size]
    return both.reshape(len(images), -1)


def _pixels(fringes: tuple[Fringe, ...], levels: Floats32, design: Floats, noise: NoiseModel, resting: Bools) -> Ints:
    """Choose some of the resting pixels, by number, at which all fringes are visible."""
    components = (np.linalg.pinv(design) @ levels)[1:].reshape(len(fringes), 2, -1)
    variance = np.float32(_LESS_NOISE) * noise.variance(levels.mean(axis=0))
    usable = resting.copy()
    for fringe, of_fringe in zip(fringes, components, strict=True):
        usable &= np.sum(of_fringe**2, axis=0) > (SIGNIFICANT_SIGMAS * fringe.noise_gain) ** 2 * variance
    return evenly_spread(np.flatnonzero(usable))


def _resting(tiles: TileSample, images: Floats32, saturation: float) -> Bools:
    """(P,): whether nothing moves or is saturated within the taps."""
    fit = (images.max(axis=0) < saturation) & tiles.resting.reshape(images.shape[1:])
    whole = _filtered(fit[None].astype(np.float32), np.ones_like(LEVEL), np.ones_like(LEVEL))
    resting: Bools = whole[0] > len(LEVEL) ** 2 - 1 / 2
    return resting
