"""One fringe in a few pixels while something moves: where its frames put each pixel, and how far that moves meanwhile.

A pixel whose projector coordinate moves by u g(t) has the intensities I_n = o + A cos(θ + 2π s_n + 2π u g_n / λ) in the
frames n. That is linear in o, A cos θ, A sin θ and, for a small change of u, in that too: least squares gives what a
motion of the course g does to the position (the part that the fringe cannot tell from another position), and from four
frames on also u itself, from what no position explains.
"""

from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from calib.numerics import Floats, compiled

_LEAST_POWER = 1e-6
# The part of a motion that no position explains, as a share of what it does to the frames, in squares.
_LEAST_SEEN = 1e-4


@dataclass(frozen=True)
class MotionResponse:
    """Of P pixels, for a motion of some course: `response`, by how much the position follows a motion of 1 px;
    `motion_px`, the motion that the frames show beside it, and the `precision` of this, the inverse of its variance.
    """

    response: Floats
    motion_px: Floats
    precision: Floats


@dataclass(frozen=True)
class FringeFit:
    """Least squares of `levels` (N, P) of the `shifts` (N,) of a period; grey levels have the variance `noise` (P,).

    `moved_px` (N, P): how far each pixel's coordinate is known to have moved in each frame; None: not at all.
    """

    levels: Floats
    shifts: Floats
    period: float
    noise: Floats
    moved_px: Floats | None = None

    @property
    def mean_moved_px(self) -> Floats | float:
        """(P,): about as far as a fit that is told of no motion puts each pixel from where it was before."""
        return 0.0 if self.moved_px is None else self.moved_px.mean(axis=0)

    @cached_property
    def _angles(self) -> Floats:
        """(N, P), or (N, 1) where it is the same for all pixels."""
        shifts = self.shifts[:, None]
        return 2 * pi * (shifts if self.moved_px is None else shifts + self.moved_px / self.period)

    @cached_property
    def _design(self) -> tuple[Floats, Floats]:
        """Of offset, A cos θ and A sin θ, (3, N, P), and the inverse of its normal matrix, (3, 3, P)."""
        angles = self._angles
        design = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)])
        normal = np.einsum("anp,bnp->pab", design, design)
        return design, np.linalg.inv(normal).transpose(1, 2, 0)

    def _explained(self, values: Floats) -> tuple[Floats, Floats]:
        """The least-squares fit to values (N, P): its three parameters (3, P), and what is left of the values."""
        design, inverse = self._design
        parameters = np.sum(inverse * np.sum(design * values, axis=1), axis=1)
        return parameters, values - np.sum(design * parameters[:, None], axis=0)

    @cached_property
    def _found(self) -> tuple[Floats, Floats, Floats]:
        """A cos θ and A sin θ, (P,), and the residuals (N, P)."""
        (_, cosine, sine), residual = self._explained(self.levels)
        return cosine, sine, residual

    @cached_property
    def position(self) -> Floats:
        """(P,): within the period, in px."""
        cosine, sine, _ = self._found
        return np.arctan2(sine, cosine) * self.period / (2 * pi)

    @cached_property
    def variance(self) -> Floats:
        """(P,): that of the position by noise, in px²."""
        cosine, sine, _ = self._found
        along = np.stack([-sine, cosine]) / self._power
        gain = np.einsum("ap,abp,bp->p", along, np.broadcast_to(self._design[1][1:, 1:], (2, 2, len(sine))), along)
        variance: Floats = (self.period / (2 * pi)) ** 2 * gain * self.noise
        return variance

    @cached_property
    def _power(self) -> Floats:
        cosine, sine, _ = self._found
        return np.maximum(cosine**2 + sine**2, _LEAST_POWER)

    @cached_property
    def _unexplained(self) -> Floats:
        """The residuals (N, P) without the second harmonic, which a bent brightness curve leaves in four frames.

        It is in proportion to the amplitude and has one phase for all pixels, so two numbers are fitted to all.
        """
        cosine, sine, residual = self._found
        doubled = 2 * (np.arctan2(sine, cosine) + self._angles)
        amplitude = np.sqrt(self._power)
        waves = [self._explained(amplitude * wave)[1] for wave in (np.cos(doubled), np.sin(doubled))]
        design = np.stack([wave.reshape(-1) for wave in waves], axis=1)
        normal = design.T @ design + _LEAST_POWER * np.eye(2)
        shares = np.linalg.solve(normal, design.T @ residual.reshape(-1))
        rest: Floats = residual - shares[0] * waves[0] - shares[1] * waves[1]
        return rest

    def response_to(self, trajectory: Floats) -> MotionResponse:
        """What a motion that has come so far (N,) in the frames does to the fit, and what is seen of it.

        The grey levels' slope along the coordinate is A cos θ times one wave plus A sin θ times another, and so is
        everything that is linear in it: only the waves are fitted, which are the same for all pixels at rest.
        """
        cosine, sine, _ = self._found
        waves = [-2 * pi / self.period * wave for wave in (np.sin(self._angles), np.cos(self._angles))]
        fits = [self._explained(wave * trajectory[:, None]) for wave in waves]
        response, motion_px, precision = np.empty((3, len(cosine)))
        _fit_response(
            np.stack([cosine, sine]),
            self._unexplained,
            np.stack(waves),
            np.stack([parameters for parameters, _ in fits]),
            np.stack([beside for _, beside in fits]),
            self.period / (2 * pi),
            response,
            motion_px,
            precision,
        )
        return MotionResponse(response, motion_px, precision / self.noise)


@compiled
def _fit_response(
    components: Floats,
    unexplained: Floats,
    waves: Floats,
    parameters: Floats,
    beside: Floats,
    px_per_radian: float,
    response: Floats,
    motion_px: Floats,
    seen: Floats,
) -> None:
    """Response and motion (P,), and Σ of the squares of what is seen of it, from the `components` C, S (2, P).

    Of both waves, (2, N, P) or (2, N, 1): the `parameters` of the fit, and what is left `beside` it.
    """
    for p in range(len(response)):
        cosine, sine, at = components[0, p], components[1, p], p if waves.shape[2] > 1 else 0
        by_cosine = cosine * parameters[0, 1, at] + sine * parameters[1, 1, at]
        by_sine = cosine * parameters[0, 2, at] + sine * parameters[1, 2, at]
        power = max(cosine * cosine + sine * sine, _LEAST_POWER)
        response[p] = px_per_radian * (cosine * by_sine - sine * by_cosine) / power
        all_of_it = left = along = 0.0
        for n in range(waves.shape[1]):
            slope = cosine * waves[0, n, at] + sine * waves[1, n, at]
            rest = cosine * beside[0, n, at] + sine * beside[1, n, at]
            all_of_it += slope * slope
            left += rest * rest
            along += rest * unexplained[n, p]
        is_observable = left > _LEAST_SEEN * all_of_it
        motion_px[p] = along / left if is_observable else 0.0
        seen[p] = left if is_observable else 0.0
