"""Phase errors of a nonlinear response, from the phases themselves or, for a single fringe, from its amplitude.

With few shifts the harmonics of a distorted cosine alias onto the phase: an error that repeats N times per cycle. Over
many pixels the true phase is uniformly distributed, so the non-uniformity of the measured phase, folded N times, is the
derivative of that error. (Yu et al., Optics Express 27, 32047, 2019, also estimate gamma from the distribution of
phases; here no form of the curve is assumed.)

A single fringe of few cycles shows no such distribution, and no shorter fringe disagrees with it. It hides two errors.
A nonlinear response ripples the phase of N steps N times per cycle, by the harmonic of order N − 1: up to a twentieth
of a cycle with three steps. Interreflection shifts the phase. The same harmonic ripples the fringe's amplitude, which
the scene has no reason to do: with I_n = Σ b_k cos k(θ + 2πn/N), the measured phasor is b₁ e^{iθ} (1 + (b_{N−1}/b₁)
e^{−iNθ} + …), so the real part of its logarithm determines the imaginary part. Response curves are modelled as powers,
from the residual of a camera's tone curve up to a projector's gamma; the amplitudes give the likelihood of each
exponent, within the scene's own variation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import hypot, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.estimation import Shift
from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats, Floats32, biweight, fit_reweighted
from scanner.decoding.sequence_plan import AxisPlan, Fringe
from scanner.decoding.significance import FEWEST_PIXELS, MEDIAN_ROUNDS, SIGNIFICANT_SIGMAS

# Phases of correction tables, which are not interpolated: steps of a quarter of a thousandth of a cycle.
CYCLE = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
TABLE_LENGTH = len(CYCLE)
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


UNCHECKED = FindingKind(
    "unchecked-fringe",
    "Nothing checks the single fringe of an axis, so that a brightness curve or light from other surfaces may bend it.",
    "Project a shorter fringe along each axis as well, or the patterns of scan patterns.",
    ("period_px", "exponent", "exponent_sigma"),
)
# Exponents of projector and camera together, with a uniform prior.
_EXPONENTS = np.linspace(0.4, 3.2, 57)
# Least uncertainty of the amplitude ripple: harmonics that no power curve has, clipping.
_LEAST_RIPPLE = 0.01
# Interreflection shifts a fringe that spans an axis by this share of its period, and shorter ones by a share that falls
# with the root of the period. In four simulated corners 0.0083 by the median, 0.0127 by the root mean square.
_INDIRECT_CYCLES = 0.0105


@dataclass(frozen=True)
class FringeSample:
    """A fringe at P pixels: measured `phases` in radians, and the logarithms of its amplitude and of its mean level."""

    fringe: Fringe
    phases: Floats
    log_amplitude: Floats
    log_mean: Floats


@dataclass(frozen=True)
class Response:
    """Posterior of the response exponent: the `probability` of each of `_EXPONENTS`."""

    probability: Floats

    @property
    def exponent(self) -> float:
        """The posterior mean."""
        return float(self.probability @ _EXPONENTS)

    @property
    def sigma(self) -> float:
        """The posterior standard deviation."""
        return sqrt(float(self.probability @ (_EXPONENTS - self.exponent) ** 2))

    def straightening(self, fringe: Fringe) -> Floats32:
        """Return the phase correction as a table over one cycle, both in radians."""
        return (self.probability @ _bent(fringe).ripples).astype(np.float32)

    def residual(self, fringe: Fringe) -> Floats:
        """Return the phase error left after correction if the exponent is one standard deviation larger, as such a
        table.
        """
        relative = (_EXPONENTS - self.exponent) / self.sigma
        return -(self.probability * relative) @ _bent(fringe).ripples


def response_of(samples: Sequence[FringeSample]) -> Response:
    """Estimate the response from the amplitude ripple of the fringes of one or both axes at the same pixels.

    With both axes their amplitudes are compared with each other, which cancels albedo and light; with one axis, with
    the mean of the frames.
    """
    first = samples[0].fringe
    steps = len(first.shifts)
    likelihood = np.ones(len(_EXPONENTS))
    if all(sample.fringe.equal_steps for sample in samples) and len(samples[0].phases) >= FEWEST_PIXELS:
        pair = samples if len({len(sample.fringe.shifts) for sample in samples}) < len(samples) else samples[:1]
        ripple, sigma = _ripple(
            [sample.phases + 2 * pi * sample.fringe.shifts[0] for sample in pair], _relative(pair), steps
        )
        bent = _bent(first)
        curves = bent.log_amplitudes - (bent.log_means if len(pair) == 1 else 0)
        expected = 2 * np.mean(curves * np.cos(steps * (CYCLE + 2 * pi * first.shifts[0])), axis=1)
        likelihood = np.exp(-(((expected - ripple) / sigma) ** 2) / 2) + np.finfo(float).tiny
    return Response(likelihood / likelihood.sum())


@dataclass(frozen=True)
class Unchecked:
    """An axis whose single fringe is too long to check itself, and its estimated response."""

    axis: AxisPlan
    response: Response

    @property
    def fringe(self) -> Fringe:
        """The single fringe."""
        return self.axis.fringes[0]

    @cached_property
    def stretch(self) -> Floats32:
        """The derivative of the true phase by the measured phase, as a table over one cycle."""
        slope: Floats = np.gradient(self.response.straightening(self.fringe).astype(np.float64), CYCLE[1])
        return self._by_true_phase(1 + slope)

    @cached_property
    def residual_px(self) -> Floats32:
        """The coordinate error for one standard deviation of the response, as a table over one cycle, in projector
        pixels.
        """
        return self._by_true_phase(self.fringe.period / (2 * pi) * self.response.residual(self.fringe))

    def add_to(self, variance: Floats32, coordinate: Floats32) -> None:
        """Add the systematic errors to the variance (P,) of the coordinates, which holds their noise; in place."""
        place = _place(coordinate, self.fringe.period)
        indirect_px = _INDIRECT_CYCLES * self.fringe.period * sqrt(self.fringe.period / self.axis.length)
        variance += np.float32(indirect_px**2)
        variance *= self.stretch[place] ** 2
        variance += self.residual_px[place] ** 2

    def _by_true_phase(self, of_measured: Floats) -> Floats32:
        true = CYCLE + self.response.straightening(self.fringe)
        return np.interp(CYCLE, true, of_measured, period=2 * pi).astype(np.float32)


def shift_of(unchecked: Sequence[Unchecked]) -> Shift:
    """Return the shift of all matches if the response is off by one standard deviation, common to both axes."""

    def shift(camera_px: Floats, projector_px: Floats, gradient: Floats) -> Floats:
        del camera_px, gradient
        shifts = np.zeros_like(projector_px)
        for axis_error in unchecked:
            axis = 0 if axis_error.axis.axis == "x" else 1
            shifts[:, axis] = axis_error.residual_px[_place(projector_px[:, axis], axis_error.fringe.period)]
        return shifts

    return shift


def _place(coordinate: NDArray[np.floating[Any]], period: float) -> NDArray[np.int64]:
    """Return the table index over one cycle of coordinates (P,)."""
    place: NDArray[np.int64] = np.floor(coordinate * (TABLE_LENGTH / period)).astype(np.int64) % TABLE_LENGTH
    return place


def unchecked_finding(unchecked: Sequence[Unchecked]) -> Finding:
    """Return the warning about axes that nothing checks."""
    axes = " and ".join(error.axis.axis for error in unchecked)
    fringe, response = max((error.fringe for error in unchecked), key=lambda error: error.period), unchecked[0].response
    return Finding(
        UNCHECKED,
        Severity.WARNING,
        f"Nothing as fine checks the single fringe of {fringe.period:g} px in {len(fringe.shifts)} steps along {axes}. "
        f"Its amplitude tells of a brightness curve of exponent {response.exponent:.2g} ± {response.sigma:.1g}, which "
        "was taken out. What is not known of it, and what light from other surfaces may do, is part of each match's "
        "sigma.",
        "Better: add a shorter fringe.",
        {"period_px": fringe.period, "exponent": response.exponent, "exponent_sigma": response.sigma},
    )


@dataclass(frozen=True)
class _Bent:
    """The effect of each exponent on a fringe, by measured phase, (exponents, TABLE_LENGTH).

    `ripples`: the phase corrections, as in `straightening`; and the logarithms of amplitude and mean.
    """

    ripples: Floats
    log_amplitudes: Floats
    log_means: Floats


@lru_cache(maxsize=4)
def _bent(fringe: Fringe) -> _Bent:
    pattern = (1 + np.cos(CYCLE + 2 * pi * np.array(fringe.shifts)[:, None])) / 2
    parts = []
    for exponent in _EXPONENTS:
        levels = pattern**exponent
        cosine, sine = fringe.weights[1:] @ levels
        off = np.angle((cosine + 1j * sine) * np.exp(-1j * CYCLE))
        # Resample from evenly spaced true phases to evenly spaced measured phases.
        measured = CYCLE + off
        curves = (-off, np.log(np.hypot(cosine, sine)), np.log(levels.mean(axis=0)))
        parts.append([np.interp(CYCLE, measured, curve, period=2 * pi) for curve in curves])
    return _Bent(*np.moveaxis(np.array(parts), 1, 0))


def _relative(samples: Sequence[FringeSample]) -> Floats:
    """Return the logarithm (P,) of the amplitude relative to that of the other axis, or else to the mean level."""
    return samples[0].log_amplitude - (samples[1].log_amplitude if len(samples) > 1 else samples[0].log_mean)


def _ripple(angles: Sequence[Floats], relative: Floats, steps: int) -> tuple[float, float]:
    """Fit the coefficient of the cosine of `steps` cycles per fringe cycle; return it and its standard deviation.

    The standard deviation comes from the sine and from neighbouring frequencies, which no response explains. `angles`
    (P,) for each axis; the second axis enters with the opposite sign.
    """

    def of_both(wave: Callable[[Floats], Floats], cycles: int) -> Floats:
        first, *second = (wave(cycles * angle) for angle in angles)
        return first - second[0] if second else first

    telling = [of_both(wave, k) for k in (steps, steps - 1, steps + 1) for wave in (np.cos, np.sin)]
    nuisance = [of_both(np.cos, 2 * steps), np.ones_like(relative)]
    nuisance += [wave(k * angle) for angle in angles for k in range(1, steps - 1) for wave in (np.cos, np.sin)]
    terms = np.stack([*telling, *nuisance])
    ripple, *chance = fit_reweighted(terms, relative, biweight, np.ones_like(relative), MEDIAN_ROUNDS)[: len(telling)]
    return float(ripple), hypot(_LEAST_RIPPLE, float(np.sqrt(np.mean(np.square(chance)))))
