"""Relative brightness of frames, from groups of frames that must add up to the same light.

A pattern and its inverse add up to the same light as every other such pair; so do opposite steps of a fringe, or every
three, or all evenly spaced steps, which must then be constrained to a cosine. Where lamp, colour wheel, mains or
exposure change the brightness of frames, weights w satisfy Σ w I = N · M at all pixels, with M the common light: a
linear least-squares problem with one unknown per frame of the group. With a rolling shutter the weights depend on the
row. Fine stripes that lose light scale all weights of a group, so only ratios of weights are used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Floats32, Image, Ints, fit_reweighted, median, robust_sigma
from scanner.decoding.light.exposures import LIT
from scanner.decoding.sequence_plan import Fringe
from scanner.decoding.significance import AS_GOOD, FEWEST_PIXELS, NEGLIGIBLE, OUTLYING_SIGMAS, SIGNIFICANT_SIGMAS

# Smaller differences invert hardly any bit, and change a phase less than its noise.
LEAST_DIFFERENCE = 0.015
# Harmonic of order equal to the group's steps, which remains in its sum: relative to the fringe, at a gamma of 3.
_HARMONICS = {2: 0.4, 3: 0.07}
# Gains are rejected if their error may exceed this share of their difference, but never below the smaller limit, and
# always above the larger. With few cycles in view, gains are confused with the fringe.
_MOST_MISTAKEN_OF, _MOST_MISTAKEN = 0.25, (0.03, 0.1)
# Iterations of the initial guess, each on the equalised frames; two suffice for a much darker frame.
_GUESSES = 2
# Iterations that estimate the residual gains of the equalised frames.
PASSES = 4
# Bands of rows with equally many lit pixels, and fewest of these in each: with 100, bands of 15 % would stay in the
# small pictures of `bench_conditions.py`.
BANDS = 32
_FEWEST_PER_BAND = 64
# Largest share of the squared residuals of a single weight for which bands are accepted: chance leaves 0.99, uneven
# phases 0.95. With 0.80 the bands of a real capture (phase-shifting-object2) would not be corrected.
_BANDED = 0.85
# Share of the largest level, above which the camera may saturate.
_SATURATED = 0.98
# Prior standard deviation of a band's weights from those of the whole frame.
_BAND_SIGMA = 0.2
# Variety of a bit that changes at one pixel in twelve.
_LEAST_VARIETY = 0.3


@dataclass(frozen=True)
class LitRows:
    """The ascending `rows` (P,) of lit pixels in an image of `height`."""

    rows: NDArray[np.int64]
    height: int


@dataclass(frozen=True)
class Gains:
    """Relative brightness of the frames of a group, with geometric mean 1: (frames, image rows), or (frames, 1) if
    uniform.
    """

    of_rows: Floats

    @property
    def are_harmful(self) -> bool:
        """Whether the frames differ enough to do harm."""
        logs = np.log(self.of_rows)
        return any(difference > LEAST_DIFFERENCE for difference in np.ptp(logs, axis=0).tolist())

    @property
    def are_banded(self) -> bool:
        """Whether the gains depend on the row."""
        return len(self.of_rows[0]) > 1

    def at(self, rows: Ints) -> Floats:
        """Return the gains at given rows (...), (frames, ...), or (frames, 1) if uniform."""
        return self.of_rows[:, rows] if self.are_banded else self.of_rows

    def to_darkest(self, frame: int, levels: Image, rows: Ints) -> Image:
        """Return levels (...) of one of the frames, in some rows, as bright as the darkest frame; whole ones."""
        gains = self.at(rows)
        scaled: Image = np.rint(levels * (gains.min(axis=0) / gains[frame]).astype(np.float32)).astype(levels.dtype)
        return scaled

    def divided(self, frame: int, levels: Image, rows: Ints) -> Floats32:
        """Return levels (...) of one of the frames, in some rows, without its gain."""
        divided: Floats32 = levels.astype(np.float32) / self.at(rows)[frame].astype(np.float32)
        return divided

    def within(self, places: LitRows) -> "Gains":
        """Return the gains; if banded, such as leave nothing of frames in the rows beyond those of lit pixels."""
        beyond = np.full_like(self.of_rows, inf)
        lit = slice(places.rows[0], places.rows[-1] + 1)
        beyond[:, lit] = self.of_rows[:, lit]
        return Gains(beyond) if self.are_banded else self


def residual_of_gains(levels: Floats32, common: Floats32) -> Floats:
    """Return what is left of the `common` light (P,) without frames (N, P), each of the brightness that leaves least.

    By least squares relative to the light.
    """
    frames = (levels / np.maximum(common, NEGLIGIBLE)).astype(np.float64)
    return common * _without(frames, np.ones(len(common)))


def gains_of_pair(levels: Floats32, common: Floats32, places: LitRows) -> Gains:
    """Return the gains of a pattern and its inverse (2, P), which add up to twice the `common` light (P,)."""
    nothing = np.zeros((1, len(common)), np.float32)
    return _gains([_weights(levels, common, places, nothing, _ties(len(levels)), is_pair=True)])


def gains_of_fringe(fringe: Fringe, levels: Floats32, common: Floats32, places: LitRows) -> Gains:
    """Return the gains of the steps (N, P) of an evenly stepped fringe around the `common` light (P,).

    All 1 if few cycles are in view, where harmonics of a nonlinear response could be mistaken for gains.
    """
    order = np.argsort(np.mod(np.array(fringe.shifts) + 1e-9, 1))
    count = len(order)
    size = next((steps for steps in (3, 2) if count % steps == 0), count)
    groups = [order[first :: count // size] for first in range(count // size)]
    back = np.argsort(np.concatenate(groups))
    ties = _ties(size)
    nothing = np.zeros((1, len(common)), np.float32)
    # Phases and variety can only be judged on equalised frames.
    gains, equalised = Gains(np.ones((count, 1))), levels
    for _ in range(_GUESSES):
        guesses = [
            (_weights(equalised[group], common, places, nothing, ties, is_guess=True)[0], 0.0) for group in groups
        ]
        gains = _gains(guesses, before=gains)
        if not gains.are_harmful:
            gains = Gains(np.ones((count, 1)))
            break
        equalised = (levels / gains.of_rows[back]).astype(np.float32)
    # Rows of different gain differ in phase as well, so that part of the harmonic goes with their differences.
    for _ in range(PASSES):
        cosine, sine = np.tensordot(fringe.weights[1:].astype(np.float32), equalised, axes=1)
        phase = np.arctan2(sine, cosine)
        staying = 2 if len(ties) else size
        mistaken = 2 * _HARMONICS[staying] * _unevenness(phase, staying)
        harmonic = np.stack([np.cos(size * phase), np.sin(size * phase)])
        before = gains
        gains = _gains(
            [_weights(equalised[group], common, places, harmonic, ties) for group in groups], mistaken, before
        )
        differ = float(np.mean(np.ptp(np.log(gains.of_rows), axis=0)))
        if mistaken > np.clip(_MOST_MISTAKEN_OF * differ, *_MOST_MISTAKEN):
            return Gains(np.ones((count, 1)))
        if np.array_equal(gains.of_rows, before.of_rows):
            break  # mostly without gains: further passes repeat this one
        equalised = (levels / Gains(gains.of_rows[back]).at(places.rows)).astype(np.float32)
    return Gains(gains.of_rows[back])


def _ties(steps: int) -> Floats:
    """Return linear constraints (ties, steps): combinations of the even steps of a cosine that vanish for any
    parameters.

    Three steps, or two opposite ones, need none: they have as many weights as the fringe has unknowns. More steps must
    be constrained to a cosine, except for harmonics.
    """
    turns = 2 * np.pi * np.outer(np.arange(2, (steps - 1) // 2 + 1), np.arange(steps)) / steps
    return np.concatenate([np.cos(turns), np.sin(turns)])


def _unevenness(phase: Floats32, size: int) -> float:
    """Return the non-uniformity of the phases (P,), where a harmonic of order `size` is confused with the fringe
    itself.
    """
    return max(abs(complex(np.mean(np.exp(1j * cycles * phase)))) for cycles in (size - 1, size + 1))


def flicker_of(groups: Sequence[Gains]) -> float | None:
    """Return the relative standard deviation of frame brightness within groups; None without groups."""
    freedom = sum(len(gains.of_rows) - 1 for gains in groups)
    squares = sum(float(np.sum(np.mean(np.log(gains.of_rows) ** 2, axis=1))) for gains in groups)
    return sqrt(squares / freedom) if freedom else None


def _gains(weighted: Sequence[tuple[Floats, float]], mistaken: float = 0.0, before: Gains | None = None) -> Gains:
    """Return the gains from the weights (frames, rows or 1) of groups of common light, each with its error; 1 if
    insignificant.

    `mistaken`: an error common to all groups. `before`: gains that were already divided out of the frames.
    """
    rows = max(weights.shape[1] for weights, _ in weighted)
    weights = np.concatenate([np.broadcast_to(of_group, (len(of_group), rows)) for of_group, _ in weighted])
    weights = weights if before is None else weights / before.of_rows
    if np.any(weights <= 0) or np.ptp(np.log(weights)) <= max(error for _, error in weighted) + mistaken:
        return Gains(np.ones((len(weights), 1)))
    logs = -np.log(weights)
    return Gains(np.exp(logs - logs.mean(axis=0)))


def _weights(
    levels: Floats32,
    common: Floats32,
    places: LitRows,
    harmonic: Floats32,
    ties: Floats,
    *,
    is_pair: bool = False,
    is_guess: bool = False,
) -> tuple[Floats, float]:
    """Fit the weights (frames, image rows or 1); return them with their error, infinite if not determined.

    The mean of the frames is explained by the common light and the frames' deviations from the mean. Other terms in the
    mean, such as the `harmonic` (terms, P) of a nonlinear response or lost light, stay in the residual without bias.
    `ties` (ties, frames): further combinations of the frames that vanish. A guess is uniform over rows, and is returned
    even if poorly determined.
    """
    count = len(levels)
    # Darker pixels are mostly noise and get less weight.
    scale = 1 / np.maximum(common, np.float32(LIT * median(common) + 1e-3))
    mean = levels.mean(axis=0)
    design: Floats = (np.concatenate([common[None], levels - mean]) * scale).astype(np.float64)
    target: Floats = (mean * scale).astype(np.float64)
    tied, nothing = _tied((levels * scale).astype(np.float64), ties)
    largest = levels.max(axis=0)
    kept = largest < _SATURATED * largest.max()
    undetermined = np.ones((count, 1)), inf
    if np.count_nonzero(kept) < FEWEST_PIXELS:
        return undetermined
    usable = design[:, kept]
    if not is_guess and _variety(np.mean(usable**2, axis=1), np.mean(usable, axis=1)) < _LEAST_VARIETY:
        return undetermined
    for _ in range(2):
        terms = _least_squares(
            np.concatenate([design[:, kept], *tied[..., kept]], axis=1),
            np.concatenate([target[kept], *nothing[:, kept]]),
        )
        away = np.abs(target - terms @ design)
        kept &= away <= OUTLYING_SIGMAS * robust_sigma(away[kept]) + 1e-6
    if is_guess:  # without light there is nothing to divide by
        return (_weights_from(terms[:, None]), inf) if terms[0] else undetermined
    design, target, rows = design[:, kept], target[kept], places.rows[kept]
    residual = _without(harmonic[:, kept].astype(np.float64), target - terms @ design)
    noise = float(np.mean(residual**2)) + 1e-12
    # A nonlinear camera makes the sum deviate as well.
    if is_pair and noise > AS_GOOD * np.mean(_without(design[:1], target) ** 2):
        return undetermined
    # Noise in the regressors biases the weights towards each other, by its share of their variance.
    regressors = np.concatenate([design, *tied[..., kept]], axis=1)
    spread = float(np.linalg.eigvalsh(regressors @ regressors.T / len(residual))[1])
    if spread <= 0:  # identical frames without light
        return undetermined
    error = count * SIGNIFICANT_SIGMAS * sqrt(noise / (spread * len(residual))) + 2 * noise / spread
    bands = _bands(design, residual, noise)
    if bands is None:
        return _weights_from(terms[:, None]), error
    starts = starts_of_bands(len(rows))
    centres = np.add.reduceat(rows, starts) / np.diff(starts, append=len(rows))
    every_row = np.arange(places.height)
    return _weights_from(np.array([np.interp(every_row, centres, term) for term in (terms + bands).T])), error


def _tied(levels: Floats, ties: Floats) -> tuple[Floats, Floats]:
    """Return the designs (ties, 1 + frames, P) and targets (ties, P) of the linear constraints."""
    products = ties[:, :, None] * levels
    nothing: Floats = products.mean(axis=1)
    of_frames = products - nothing[:, None]
    return np.concatenate([np.zeros_like(nothing)[:, None], of_frames], axis=1), nothing


def _without(terms: Floats, values: Floats) -> Floats:
    """Return the residual of the values (P,) after regression on the terms (terms, P)."""
    rest: Floats = values - _least_squares(terms, values) @ terms
    return rest


def _weights_from(terms: Floats) -> Floats:
    """Return the weights with which the frames add up to the common light, from a M + Σ b (I − mean) = mean; (1 +
    frames, rows).
    """
    of_common, of_frames = terms[0], terms[1:]
    weights: Floats = (1 / len(of_frames) - of_frames + of_frames.mean(axis=0)) / of_common
    return weights


def starts_of_bands(count: int) -> NDArray[np.int64]:
    """Return the first index of each band, of equally many pixels row by row; the projector may light part of the
    image.
    """
    return np.arange(BANDS) * count // BANDS


def _bands(design: Floats, residual: Floats, noise: float) -> Floats | None:
    """Return the deviation of each band's terms from the common ones (bands, terms); None if insignificant or
    undetermined.
    """
    starts = starts_of_bands(len(residual))
    counts = np.diff(starts, append=len(residual))
    if counts.min() < _FEWEST_PER_BAND:
        return None
    squares = np.moveaxis(np.add.reduceat(design[:, None] * design, starts, axis=2), 2, 0)
    products = np.add.reduceat(design * residual, starts, axis=1).T
    prior = np.eye(len(design)) * noise / _BAND_SIGMA**2
    deviations = np.linalg.solve(squares + prior, products[..., None])[..., 0].astype(np.float64)
    explained = 2 * np.sum(deviations * products) - np.einsum("bi,bij,bj", deviations, squares, deviations)
    means = np.add.reduceat(design, starts, axis=1).T / counts[:, None]
    is_told = np.median(_variety(np.diagonal(squares, axis1=1, axis2=2) / counts[:, None], means)) > _LEAST_VARIETY
    return deviations if is_told and explained > (1 - _BANDED) * noise * len(residual) else None


def _variety(squares: Floats, means: Floats) -> Floats:
    """Return how much the frames' deviations from their mean vary over pixels, from mean squares and means (…, terms).

    0 if a frame is uniform, as inside one stripe, and so confused with the common light; 1 if it is above and below the
    mean equally often.
    """
    variety: Floats = np.min(1 - means[..., 1:] ** 2 / np.maximum(squares[..., 1:], 1e-12), axis=-1)
    return variety


def _least_squares(terms: Floats, target: Floats) -> Floats:
    """Return the minimum-norm coefficients (N,) of a few terms (N, P), which may be dependent."""
    return fit_reweighted(terms, target, np.ones_like, np.ones(1), 1)
