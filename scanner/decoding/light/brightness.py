"""How bright each frame is next to the others, from the light that several frames must show together.

A pattern and its inverse add up to the same light as every other such pair; so do opposite steps of a fringe, or every
three, or all steps that divide its cycle evenly, which must be tied to a cosine then. Where lamp, colour wheel, mains
or exposure made frames brighter or darker, there are weights w with Σ w I = N · M at all pixels, M being the light that
the groups have in common: a linear least-squares problem of as many unknowns as the group has frames, whatever the
frames show. A rolling shutter makes them depend on the row. Stripes so fine that they lose light make all weights of a
group larger, not their ratios, and ratios are all that is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from calib.numerics import SIGMA_PER_MEDIAN, Floats, Image, median
from scanner.decoding.arrays import Floats32
from scanner.decoding.sequence_plan import Fringe
from scanner.decoding.significance import SIGNIFICANT_SIGMAS

# Smaller differences change hardly a bit, and a phase less than its noise.
LEAST_DIFFERENCE = 0.015
# The harmonic of as many cycles as a group has steps stays in its sum: relative to the fringe, at a gamma of 3.
_HARMONICS = {2: 0.4, 3: 0.07}
# Gains that are unknown by more than this part of what they differ are not known; nor are any that are unknown by more
# than the larger limit; the smaller one does no harm. Where few cycles are in view, gains explain what is fringe.
_MOST_MISTAKEN_OF, _MOST_MISTAKEN = 0.25, (0.03, 0.1)
# Each starts from frames that the one before made alike; a much darker frame is well known after the second.
_GUESSES = 2
# Each finds what the frames that the one before made alike still differ by.
_PASSES = 4
BANDS = 32
_FEWEST_PER_BAND = 64
_FEWEST_PIXELS = 200
# What bands may leave of the squared residuals of one weight for all rows: chance leaves 0.99, uneven phases 0.95.
_BANDED = 0.85
# How far the weights of a band may well be from those of the whole frame.
_BAND_SIGMA = 0.2
# Of a bit that one pixel in twelve sees change.
_LEAST_VARIETY = 0.3
# Darker pixels than this share of the median count less: theirs is noise.
_FAINT = 0.25
_OUTLYING = 4.0
# Close to the largest level of the frames, which may be where the camera saturates.
_SATURATED = 0.98
# Gains explain part of what the frames' sum is off, or they are none: a camera that is not linear is off as well.
_UNEXPLAINED = 0.8


@dataclass(frozen=True)
class Places:
    """The `rows` (P,), which rise, of some lit pixels of an image of `height`."""

    rows: NDArray[np.int64]
    height: int


@dataclass(frozen=True)
class Gains:
    """Brightness of the frames of a group, their geometric mean being 1: (frames, rows of the image), or (frames, 1)
    where rows do not differ.
    """

    of_rows: Floats

    @property
    def matter(self) -> bool:
        """Whether the frames differ enough to do harm."""
        logs = np.log(self.of_rows)
        return any(difference > LEAST_DIFFERENCE for difference in np.ptp(logs, axis=0).tolist())

    @property
    def are_banded(self) -> bool:
        """Whether rows differ."""
        return len(self.of_rows[0]) > 1

    def at(self, rows: NDArray[np.int64]) -> Floats:
        """(frames, P), or (frames, 1) where rows do not differ."""
        return self.of_rows[:, rows] if self.are_banded else self.of_rows

    def equalised(self, frame: int, image: Image) -> Image:
        """One of the frames (H, W) as bright as the darkest of the group, of the same type."""
        factors = self.of_rows.min(axis=0) / self.of_rows[frame]
        result: Image = np.rint(image * factors.astype(np.float32)[:, None]).astype(image.dtype)
        return result


def gains_of_pair(levels: Floats32, common: Floats32, places: Places) -> Gains:
    """Those of a pattern and its inverse (2, P), which together show twice the `common` light (P,)."""
    nothing = np.zeros((1, len(common)), np.float32)
    return _gains([_weights(levels, common, places, nothing, _ties(len(levels)), is_pair=True)])


def gains_of_fringe(fringe: Fringe, levels: Floats32, common: Floats32, places: Places) -> Gains:
    """Those of the steps (N, P) of a fringe in even steps around the `common` light (P,).

    1 where few cycles are in view, so that the harmonics of a bent brightness curve could be taken for them.
    """
    order = np.argsort(np.mod(np.array(fringe.shifts) + 1e-9, 1))
    count = len(order)
    size = next((steps for steps in (3, 2) if count % steps == 0), count)
    groups = [order[first :: count // size] for first in range(count // size)]
    back = np.argsort(np.concatenate(groups))
    ties = _ties(size)
    nothing = np.zeros((1, len(common)), np.float32)
    # Neither phases nor variety of frames that differ are those of the fringe.
    found, alike = Gains(np.ones((count, 1))), levels
    for _ in range(_GUESSES):
        guesses = [(_weights(alike[group], common, places, nothing, ties, is_guess=True)[0], 0.0) for group in groups]
        found = _gains(guesses, before=found)
        alike = (levels / found.of_rows[back]).astype(np.float32)
    # Of rows that differ the phases differ, too, so that the harmonic has a part of what they differ by.
    for _ in range(_PASSES):
        cosine, sine = np.tensordot(fringe.weights[1:].astype(np.float32), alike, axes=1)
        phase = np.arctan2(sine, cosine)
        staying = 2 if len(ties) else size
        mistaken = 2 * _HARMONICS[staying] * _unevenness(phase, staying)
        harmonic = np.stack([np.cos(size * phase), np.sin(size * phase)])
        found = _gains([_weights(alike[group], common, places, harmonic, ties) for group in groups], mistaken, found)
        differ = float(np.mean(np.ptp(np.log(found.of_rows), axis=0)))
        if mistaken > np.clip(_MOST_MISTAKEN_OF * differ, *_MOST_MISTAKEN):
            return Gains(np.ones((count, 1)))
        alike = (levels / Gains(found.of_rows[back]).at(places.rows)).astype(np.float32)
    return Gains(found.of_rows[back])


def _ties(steps: int) -> Floats:
    """(ties, steps): of so many even steps of a cycle, in what they add up to nothing, whatever offset and amplitudes.

    Three steps, and two that are opposite, have as many weights as the fringe has unknowns. More need it be said that
    what they show is a cosine, but for harmonics.
    """
    turns = 2 * np.pi * np.outer(np.arange(2, (steps - 1) // 2 + 1), np.arange(steps)) / steps
    return np.concatenate([np.cos(turns), np.sin(turns)])


def _unevenness(phase: Floats32, size: int) -> float:
    """How far phases (P,) are from evenly spread, where a harmonic of `size` cycles looks like the fringe itself."""
    return max(abs(complex(np.mean(np.exp(1j * cycles * phase)))) for cycles in (size - 1, size + 1))


def flicker_of(groups: Sequence[Gains]) -> float | None:
    """Standard deviation of the brightness of frames, relative, about that of their groups; None without any."""
    freedom = sum(len(gains.of_rows) - 1 for gains in groups)
    squares = sum(float(np.sum(np.mean(np.log(gains.of_rows) ** 2, axis=1))) for gains in groups)
    return sqrt(squares / freedom) if freedom else None


def _gains(found: Sequence[tuple[Floats, float]], mistaken: float = 0.0, before: Gains | None = None) -> Gains:
    """From weights (frames, rows or 1) of groups that share their light, and how wrong each and all of them may be.

    `before`: gains that were taken out of the frames already.
    """
    rows = max(weights.shape[1] for weights, _ in found)
    weights = np.concatenate([np.broadcast_to(of_group, (len(of_group), rows)) for of_group, _ in found])
    weights = weights if before is None else weights / before.of_rows
    if np.any(weights <= 0) or np.ptp(np.log(weights)) <= max(error for _, error in found) + mistaken:
        return Gains(np.ones((len(weights), 1)))
    logs = -np.log(weights)
    return Gains(np.exp(logs - logs.mean(axis=0)))


def _weights(
    levels: Floats32,
    common: Floats32,
    places: Places,
    harmonic: Floats32,
    ties: Floats,
    *,
    is_pair: bool = False,
    is_guess: bool = False,
) -> tuple[Floats, float]:
    """(frames, rows of the image or 1), and how far they may be from the truth: infinitely if the pixels do not tell.

    The mean of the frames is explained by the common light and the frames' distances from it. So what else is in the
    mean, as `harmonic` (terms, P) of a bent brightness curve or lost light, is left over and pulls at nothing. `ties`
    (ties, frames): what the frames also add up to nothing in. A guess is the same for all rows, and is given even if
    the pixels do not tell.
    """
    count = len(levels)
    scale = 1 / np.maximum(common, np.float32(_FAINT * median(common) + 1e-3))
    mean = levels.mean(axis=0)
    design: Floats = (np.concatenate([common[None], levels - mean]) * scale).T.astype(np.float64)
    target: Floats = (mean * scale).astype(np.float64)
    tied, nothing = _tied((levels * scale).astype(np.float64), ties)
    largest = levels.max(axis=0)
    chosen = largest < _SATURATED * largest.max()
    seen = design[chosen]
    if len(seen) < _FEWEST_PIXELS:
        return np.ones((count, 1)), inf
    if not is_guess and _variety(np.mean(seen**2, axis=0), np.mean(seen, axis=0)) < _LEAST_VARIETY:
        return np.ones((count, 1)), inf
    for _ in range(2):
        terms = _least_squares(
            np.concatenate([design[chosen], *tied[:, chosen]]), np.concatenate([target[chosen], *nothing[:, chosen]])
        )
        away = np.abs(target - design @ terms)
        chosen &= away <= _OUTLYING * SIGMA_PER_MEDIAN * median(away[chosen]) + 1e-6
    design, target, rows = design[chosen], target[chosen], places.rows[chosen]
    left = _without(harmonic.T[chosen], target - design @ terms)
    noise = float(np.mean(left**2)) + 1e-12
    of_common = design[:, 0] * (design[:, 0] @ target / (design[:, 0] @ design[:, 0]))
    if is_pair and noise > _UNEXPLAINED * np.mean((target - of_common) ** 2):
        return np.ones((count, 1)), inf
    # Noise in what explains draws its weights together: a share of them as large as it is next to what it explains.
    told = np.concatenate([design, *tied[:, chosen]])
    spread = float(np.linalg.eigvalsh(told.T @ told / len(left))[1])
    if spread <= 0:  # frames without light, all alike
        return np.ones((count, 1)), inf
    error = count * SIGNIFICANT_SIGMAS * sqrt(noise / (spread * len(left))) + 2 * noise / spread
    bands = None if is_guess else _bands(design, left, noise)
    if bands is None:
        return _weights_from(terms[:, None]), error
    starts = _starts(len(rows))
    centres = np.add.reduceat(rows, starts) / np.diff(starts, append=len(rows))
    every_row = np.arange(places.height)
    return _weights_from(np.array([np.interp(every_row, centres, term) for term in (terms + bands).T])), error


def _tied(levels: Floats, ties: Floats) -> tuple[Floats, Floats]:
    """Rows of a design (ties, P, 1 + frames), and their targets (ties, P), that say what the frames are tied by."""
    products = ties[:, :, None] * levels
    nothing: Floats = products.mean(axis=1)
    of_frames = np.moveaxis(products - nothing[:, None], 1, 2)
    return np.concatenate([np.zeros((*nothing.shape, 1)), of_frames], axis=2), nothing


def _without(terms: Floats32, values: Floats) -> Floats:
    """What the terms (P, terms) do not explain of the values (P,)."""
    rest: Floats = values - terms @ _least_squares(terms.astype(np.float64), values)
    return rest


def _weights_from(terms: Floats) -> Floats:
    """Those with which the frames add up to the common light, from a M + Σ b (I − mean) = mean; (1 + frames, rows)."""
    of_common, of_frames = terms[0], terms[1:]
    weights: Floats = (1 / len(of_frames) - of_frames + of_frames.mean(axis=0)) / of_common
    return weights


def _starts(count: int) -> NDArray[np.int64]:
    """Where bands of as many pixels each begin, of pixels row by row; the projector may light up a part of them."""
    return np.arange(BANDS) * count // BANDS


def _bands(design: Floats, left: Floats, noise: float) -> Floats | None:
    """How far the terms of each band of rows are from those of all (bands, terms); None if they are not, or unknown."""
    starts = _starts(len(left))
    counts = np.diff(starts, append=len(left))
    if counts.min() < _FEWEST_PER_BAND:
        return None
    squares = np.add.reduceat(design[:, :, None] * design[:, None, :], starts)
    products = np.add.reduceat(design * left[:, None], starts)
    prior = np.eye(design.shape[1]) * noise / _BAND_SIGMA**2
    found = np.linalg.solve(squares + prior, products[..., None])[..., 0].astype(np.float64)
    explained = 2 * np.sum(found * products) - np.einsum("bi,bij,bj", found, squares, found)
    means = np.add.reduceat(design, starts) / counts[:, None]
    is_told = np.median(_variety(np.diagonal(squares, axis1=1, axis2=2) / counts[:, None], means)) > _LEAST_VARIETY
    return found if is_told and explained > (1 - _BANDED) * noise * len(left) else None


def _variety(squares: Floats, means: Floats) -> Floats:
    """How much the frames' distances from their mean vary over pixels, given their mean squares and means (…, terms).

    0 if each is alike everywhere, as inside one stripe, where it cannot be told from the common light; 1 if each is as
    often above as below.
    """
    variety: Floats = np.min(1 - means[..., 1:] ** 2 / np.maximum(squares[..., 1:], 1e-12), axis=-1)
    return variety


def _least_squares(design: Floats, target: Floats) -> Floats:
    """The terms (N,) of a design (P, N) of few columns, which need not be independent: their smallest."""
    terms: Floats = np.linalg.pinv(design.T @ design, rcond=1e-9, hermitian=True) @ (design.T @ target)
    return terms
