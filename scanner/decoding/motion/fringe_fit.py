"""The least-squares fit of one fringe in some pixels, and its response to motion between the frames.

A pixel whose projector coordinate moves by u g(t) has the intensities I_n = o + A cos(θ + 2π s_n + 2π u g_n / λ) in the
frames n. This is linear in o, A cos θ and A sin θ and, to first order, in a small u. Least squares gives the shift of
the position by a motion along the trajectory g, which the fringe cannot tell from another position. With four or more
frames, the residuals also give u.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import pi

import numpy as np

from calib.numerics import Floats, Ints, compiled
from scanner.decoding.arrays import NEGLIGIBLE


@dataclass(frozen=True)
class MotionResponse:
    """The effect of motion along a trajectory on P pixels.

    `response`: shift of the fitted position per px of motion. `motion_px`: the motion measured from the residuals, and
    its `precision`, the inverse variance.
    """

    response: Floats
    motion_px: Floats
    precision: Floats


@dataclass(frozen=True)
class FringeFit:
    """The least-squares fit of `levels` (N, P) at phase `shifts` (N,); grey levels have the variance `noise` (P,).

    `times` (N,): places of the frames, including repeats, in the sequence. `moved_px` (N, P): known motion of each
    pixel's coordinate in each frame; None if there is none.
    """

    levels: Floats
    shifts: Floats
    period: float
    noise: Floats
    times: Ints
    moved_px: Floats | None = None

    def with_known_motion(self, share: Floats, motion_px: Floats) -> "FringeFit":
        """Return a fit that takes a known motion (P,) of its pixels into account, of which each frame has seen a share
        (N,).
        """
        return replace(self, moved_px=share[:, None] * motion_px)

    @property
    def mean_moved_px(self) -> Floats | float:
        """(P,): the approximate shift of the position in a fit that ignores the known motion."""
        return 0.0 if self.moved_px is None else self.moved_px.mean(axis=0)

    @cached_property
    def _angles(self) -> Floats:
        """(N, P), or (N, 1) if all pixels share them."""
        shifts = self.shifts[:, None]
        return 2 * pi * (shifts if self.moved_px is None else shifts + self.moved_px / self.period)

    @cached_property
    def _design(self) -> tuple[Floats, Floats]:
        """The design matrix of offset, A cos θ and A sin θ, (3, N, P), and the inverse normal matrix, (3, 3, P)."""
        angles = self._angles
        design = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)])
        normal = np.einsum("anp,bnp->pab", design, design)
        return design, np.linalg.inv(normal).transpose(1, 2, 0)

    def _explained(self, values: Floats) -> tuple[Floats, Floats]:
        """Return the least-squares parameters (3, P) of values (N, P), and the residuals."""
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
        """(P,): position within the period, in px."""
        cosine, sine, _ = self._found
        return np.arctan2(sine, cosine) * self.period / (2 * pi)

    @cached_property
    def variance(self) -> Floats:
        """(P,): variance of the position due to noise, in px²."""
        cosine, sine, _ = self._found
        along = np.stack([-sine, cosine]) / self._power
        gain = np.einsum("ap,abp,bp->p", along, np.broadcast_to(self._design[1][1:, 1:], (2, 2, len(sine))), along)
        variance: Floats = (self.period / (2 * pi)) ** 2 * gain * self.noise
        return variance

    @cached_property
    def _power(self) -> Floats:
        cosine, sine, _ = self._found
        return np.maximum(cosine**2 + sine**2, NEGLIGIBLE)

    @cached_property
    def _unexplained(self) -> Floats:
        """The residuals (N, P) without the second harmonic that a nonlinear brightness curve leaves in four frames.

        The harmonic is proportional to the amplitude and has the same phase in all pixels, so that two numbers fit them
        all.
        """
        cosine, sine, residual = self._found
        doubled = 2 * (np.arctan2(sine, cosine) + self._angles)
        amplitude = np.sqrt(self._power)
        waves = [self._explained(amplitude * wave)[1] for wave in (np.cos(doubled), np.sin(doubled))]
        design = np.stack([wave.reshape(-1) for wave in waves], axis=1)
        normal = design.T @ design + NEGLIGIBLE * np.eye(2)
        shares = np.linalg.solve(normal, design.T @ residual.reshape(-1))
        rest: Floats = residual - shares[0] * waves[0] - shares[1] * waves[1]
        return rest

    def response_to(self, trajectory: Floats) -> MotionResponse:
        """Return the response of the fit to a motion, of which each frame has seen the share `trajectory` (N,).

        The slope of the grey levels along the coordinate is A cos θ times one wave plus A sin θ times another. The fit
        is linear, so that only these two waves are fitted, which all resting pixels share.
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
            NEGLIGIBLE,
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
    negligible: float,
    response: Floats,
    motion_px: Floats,
    seen: Floats,
) -> None:
    """Fill response and motion (P,), and the sum of squares observed, from the `components` A cos θ, A sin θ (2, P).

    For both waves, (2, N, P) or (2, N, 1): the fitted `parameters`, and the residuals `beside` them.
    """
    for p in range(len(response)):
        cosine, sine, at = components[0, p], components[1, p], p if waves.shape[2] > 1 else 0
        by_cosine = cosine * parameters[0, 1, at] + sine * parameters[1, 1, at]
        by_sine = cosine * parameters[0, 2, at] + sine * parameters[1, 2, at]
        power = max(cosine * cosine + sine * sine, negligible)
        response[p] = px_per_radian * (cosine * by_sine - sine * by_cosine) / power
        all_of_it = left = along = 0.0
        for n in range(waves.shape[1]):
            slope = cosine * waves[0, n, at] + sine * waves[1, n, at]
            rest = cosine * beside[0, n, at] + sine * beside[1, n, at]
            all_of_it += slope * slope
            left += rest * rest
            along += rest * unexplained[n, p]
        is_observable = left > negligible * all_of_it
        motion_px[p] = along / left if is_observable else 0.0
        seen[p] = left if is_observable else 0.0
