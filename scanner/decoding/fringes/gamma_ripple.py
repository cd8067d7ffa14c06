"""Correct the phase ripple of a nonlinear response (gamma) from the distribution of the phases themselves.

With few shifts the harmonics of a distorted cosine alias onto the phase: an error that repeats N times per cycle. Over
many pixels the true phase is uniformly distributed, so the non-uniformity of the measured phase, folded N times, is the
derivative of that error. (Yu et al., Optics Express 27, 32047, 2019, also estimate gamma from the distribution of
phases; here no form of the curve is assumed.)
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Floats32
from scanner.decoding.sequence_plan import Fringe
from scanner.decoding.significance import FEWEST_PIXELS, SIGNIFICANT_SIGMAS

# Phases of correction tables, which are not interpolated: steps of a quarter of a thousandth of a cycle.
CYCLE = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
TABLE_LENGTH = len(CYCLE)
# Over fewer cycles the phases of a scene need not be uniformly distributed.
ENOUGH_CYCLES = 8.0
# From five equal shifts on, a gamma of 2.2 ripples the phase by less than 0.0003 cycle; with three it is 0.05.
_MANY_SHIFTS = 5
_HARMONICS = 8  # of the density of phases, which a smooth response leaves


def can_ripple(fringe: Fringe) -> bool:
    """Whether harmonics distort this fringe's phase noticeably, in a way that the phases show."""
    return fringe.equal_steps and len(fringe.shifts) < _MANY_SHIFTS


def straightening(fringe: Fringe, phases: Sequence[Floats32]) -> Floats32 | None:
    """Return the phase correction as a table over one cycle, both in radians; None if none is significant.

    `phases`: samples of fringes with the same shifts as `fringe`, shown on the same projector.
    """
    steps, first = len(fringe.shifts), 2 * np.pi * fringe.shifts[0]
    angle = np.concatenate(phases).astype(np.float64) + first
    if len(angle) < FEWEST_PIXELS:
        return None
    harmonics = np.arange(1, _HARMONICS + 1)
    spectrum = _spectrum(angle)
    moments = spectrum[steps * harmonics]
    if abs(moments[0].real) < SIGNIFICANT_SIGMAS * max(_unevenness(spectrum, steps), abs(moments[0].imag)):
        return None
    # Density of ψ = N θ: (1 + Σ 2 c_j cos jψ) / 2π, even because the shifted cosine is; its integral is the true phase.
    psi = steps * (CYCLE + first)
    ripple = np.sum(2 * moments.real[:, None] / harmonics[:, None] * np.sin(np.outer(harmonics, psi)), axis=0)
    table: Floats32 = (ripple / steps).astype(np.float32)
    return table


def _spectrum(angle: Floats) -> NDArray[np.complex128]:
    """Return the means of exp(i k angle) for k = 0, 1, 2 …, from a histogram."""
    bins = (angle * (TABLE_LENGTH / (2 * np.pi))).astype(np.int64) % TABLE_LENGTH
    counts = np.bincount(bins, minlength=TABLE_LENGTH)
    to_middles = np.exp(1j * CYCLE[: TABLE_LENGTH // 2 + 1] / 2)
    spectrum: NDArray[np.complex128] = np.conj(np.fft.rfft(counts)) / len(angle) * to_middles
    return spectrum


def _unevenness(spectrum: NDArray[np.complex128], steps: int) -> float:
    """Return the RMS non-uniformity at frequencies that harmonics cannot cause: scene and chance."""
    frequencies = [k for k in range(1, 3 * steps) if k % steps]
    return float(np.sqrt(np.mean(np.abs(spectrum[frequencies]) ** 2)))
