"""How bright each frame is next to the others, from the light that several frames must show together.

A pattern and its inverse add up to the same light as every other such pair; so do opposite steps of a fringe, or all of
its steps if their number is odd. Where lamp, colour wheel, mains or exposure made frames brighter or darker, there are
weights w with Σ w I = N · M at all pixels, M being the light that the groups have in common: a linear least-squares
problem of as many unknowns as the group has frames, whatever the frames show. A rolling shutter makes them depend on
the row. Stripes so fine that they lose light make all weights of a group larger, not their ratios, and ratios are all
that is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Image
from scanner.decoding.arrays import Floats32
from scanner.decoding.sequence_plan import Fringe

# Smaller differences change hardly a bit, and a phase less than its noise.
LEAST_DIFFERENCE = 0.015
_SIGNIFICANT = 5.0
_BANDS = 32
_FEWEST_PER_BAND = 64
_FEWEST_BANDS = 4
# Bands are there if they leave so much less of the squared residuals than one weight for all rows does.
_BANDED = 0.7
# How far the weights of a band may well be from those of the whole frame.
_BAND_SIGMA = 0.2
# Where the pixels of a band show but one combination of its frames, weights cannot be told apart: ratio of eigenvalues.
_LEAST_SPREAD = 1e-3
# Darker pixels than this share of the median count less: theirs is noise.
_FAINT = 0.25
_OUTLYING = 4.0


@dataclass(frozen=True)
class Places:
    """The `rows` (P,) of some pixels of an image of `height`."""

    rows: NDArray[np.int64]
    height: int


@dataclass(frozen=True)
class Gains:
    """Brightness of the frames of a group, their geometric mean being 1: (frames, rows of the image), or (frames, 1)
    where rows do not differ.
    """

    of_rows: Floats

    @property
    def spread(self) -> float:
        """Standard deviation of the frames' brightness about that of the group."""
        logs = np.log(self.of_rows)
        return float(np.sqrt(np.sum(np.mean(logs**2, axis=1)) / (len(logs) - 1)))

    @property
    def matter(self) -> bool:
        """Whether the frames differ enough to do harm."""
        return bool(np.ptp(np.log(self.of_rows), axis=0).max() > LEAST_DIFFERENCE)

    @property
    def are_banded(self) -> bool:
        """Whether rows differ."""
        return self.of_rows.shape[1] > 1

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
    return _gains([_weights(levels, common, places)])


def gains_of_fringe(fringe: Fringe, levels: Floats32, common: Floats32, places: Places) -> Gains | None:
    """Those of the steps (N, P) of a fringe around the `common` light (P,); None of uneven steps."""
    if not fringe.equal_steps:
        return None
    order = np.argsort(np.mod(np.array(fringe.shifts) + 1e-9, 1))
    count = len(order)
    groups = [order] if count % 2 else [order[[k, k + count // 2]] for k in range(count // 2)]
    found = _gains([_weights(levels[group], common, places) for group in groups])
    return Gains(found.of_rows[np.argsort(np.concatenate(groups))])


def _gains(found: Sequence[tuple[Floats, float]]) -> Gains:
    """From weights (frames, rows or 1) of groups that share their light, and the standard deviation of each."""
    rows = max(weights.shape[1] for weights, _ in found)
    weights = np.concatenate([np.broadcast_to(of_group, (len(of_group), rows)) for of_group, _ in found])
    sigma = max(sigma for _, sigma in found)
    if np.any(weights <= 0) or (rows == 1 and np.ptp(np.log(weights)) <= _SIGNIFICANT * sigma):
        return Gains(np.ones((len(weights), 1)))
    logs = -np.log(weights)
    return Gains(np.exp(logs - logs.mean(axis=0)))


def _weights(levels: Floats32, common: Floats32, places: Places) -> tuple[Floats, float]:
    """(frames, rows of the image or 1), and the standard deviation of those that do not depend on the row."""
    scale = 1 / np.maximum(common, np.float32(_FAINT * float(np.median(common)) + 1e-3))
    design, target = (levels * scale).T.astype(np.float64), len(levels) * (common * scale).astype(np.float64)
    chosen = np.ones(len(target), np.bool_)
    for _ in range(2):
        weights, *_ = np.linalg.lstsq(design[chosen], target[chosen], rcond=1e-3)
        away = np.abs(target - design @ weights)
        chosen = away <= _OUTLYING * np.median(away) / 0.6745 + 1e-6
    design, target, rows = design[chosen], target[chosen], places.rows[chosen]
    left = target - design @ weights
    noise = float(np.mean(left**2)) + 1e-12
    sigma = float(np.sqrt(np.linalg.pinv(design.T @ design, rcond=1e-6).trace() * noise))
    bands = _bands(design, left, rows * _BANDS // places.height, noise)
    if bands is None:
        return weights[:, None], sigma
    centres = (np.arange(_BANDS) + 0.5) * places.height / _BANDS - 0.5
    return np.stack([np.interp(np.arange(places.height), centres, of_frame) for of_frame in (weights + bands).T]), sigma


def _bands(design: Floats, left: Floats, band: NDArray[np.int64], noise: float) -> Floats | None:
    """How far the weights of each band of rows are from those of all (bands, frames); None if they are not."""
    prior = np.eye(design.shape[1]) * noise / _BAND_SIGMA**2
    found, remaining, spread = np.zeros((_BANDS, design.shape[1])), 0.0, np.zeros(_BANDS)
    for number in range(_BANDS):
        own, rest = design[band == number], left[band == number]
        if len(rest) < _FEWEST_PER_BAND:
            return None
        eigenvalues = np.linalg.eigvalsh(own.T @ own)
        spread[number] = eigenvalues[0] / eigenvalues[-1]
        found[number] = np.linalg.solve(own.T @ own + prior, own.T @ rest)
        remaining += float(np.sum((rest - own @ found[number]) ** 2))
    is_told = np.median(spread) > _LEAST_SPREAD
    return found if is_told and remaining < _BANDED * noise * len(left) else None
