"""Fringes of several periods, or with codes, at sampled pixels: the position where they agree, and how well."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats

# Least cosine of the phase residuals: chance reaches 0.9 with three fringes of 60 or 70 periods.
_AGREE = 0.955
# Largest mean deviation of a fringe, in cycles; an origin a quarter of a cycle off gives 0.012.
_OFF = 0.007
# The same relative to a code, whose edges noise and blur may shift.
_OFF_CODE = 0.1
PLACES_OF_CYCLE, _WHOLE = 16, 0.02
_MOST_CYCLES = 400
_CHUNK = 2048
_SOME = 512  # pixels whose median tells whether fringes contradict each other


def repeats_after(periods: Sequence[float]) -> float:
    """After how many pixels all fringes are as at the beginning, as nearly as matters; infinity if beyond reach."""
    longest = max(periods)
    cycles = np.arange(1, _MOST_CYCLES)[:, None] * longest / np.array(periods)
    whole = np.flatnonzero(np.all(np.abs(cycles - np.rint(cycles)) < _WHOLE, axis=1))
    return float((whole[0] + 1) * longest) if len(whole) else float("inf")


@dataclass(frozen=True)
class FringeAgreement:
    """`coordinate` (N,), accurate to a `step`, in pixels; `misfit`: one minus the cosine of the phase residuals."""

    coordinate: Floats
    step: float
    misfit: float


def agreed(phases: Floats, periods: Sequence[float], whole: float) -> FringeAgreement | str:
    """The positions below `whole` where fringes have the phases (K, N), in cycles.

    Or the error: phases that fit no position, or a fringe with another origin.
    """
    step = min(periods) / PLACES_OF_CYCLE
    places = np.arange(0, whole, step)
    waves = np.array(periods)[:, None]
    there = _unit(places / waves) / np.float32(len(periods))
    # Most orders are wrong, and some pixels show it.
    if np.median(_best(phases[:, :: max(1, phases.shape[1] // _SOME)], there)[1]) < _AGREE:
        return "contradict each other: are there other --periods to a picture?"
    best, fit = _best(phases, there)
    positions = places[best]
    fitting = fit > _AGREE
    residual = np.exp(2j * np.pi * (phases - positions / waves))[:, fitting]
    # The common residual is the position between two samples.
    residual *= np.exp(-1j * np.angle(residual.sum(axis=0)))
    if np.abs(np.angle(residual.mean(axis=1))).max() / (2 * np.pi) > _OFF:
        return "do not begin at the picture's edge"
    return FringeAgreement(positions, step, float(1 - np.median(fit)))


def _best(phases: Floats, there: NDArray[np.float32]) -> tuple[NDArray[np.int64], Floats]:
    """The number of the place `there` (2 K, places) that fits phases (K, N) best, and the mean cosine there, (N,)."""
    best, fit = np.empty(phases.shape[1], np.int64), np.empty(phases.shape[1])
    for start in range(0, phases.shape[1], _CHUNK):
        of_chunk = slice(start, start + _CHUNK)
        likeness = _unit(phases[:, of_chunk]).T @ there
        best[of_chunk] = likeness.argmax(axis=1)
        fit[of_chunk] = likeness.max(axis=1)
    return best, fit


def deviates_from_code(phase: Floats, period: float, coordinate: Floats) -> bool:
    """Whether the phases (N,) of a fringe deviate, on average, from those at the middle of the cells (N,) of a code."""
    mean = np.exp(2j * np.pi * (phase - coordinate / period)).mean()
    return bool(abs(np.angle(mean)) / (2 * np.pi) > _OFF_CODE or abs(mean) < 2 / np.pi - _OFF_CODE)


def _unit(cycles: Floats) -> NDArray[np.float32]:
    angles = 2 * np.pi * cycles
    return np.concatenate([np.cos(angles), np.sin(angles)], dtype=np.float32)
